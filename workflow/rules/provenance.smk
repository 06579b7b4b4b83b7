# What the config says that files are made with, against what the files themselves say.


def scene_made_with(wildcards):
    """What the config and the data say that a scene store is made with."""
    source, name, options = scene_of(wildcards)
    data = scene_data(wildcards)
    return scene_stamp(source, name, (HEIGHT, WIDTH), options, data)


def targets_made_with(wildcards):
    """What the config says that a target list is made with, besides a scene."""
    return {"settings": target_settings(config["protocol"], config["seed"])}


def stability_targets_made_with(wildcards):
    """The same for target lists of the stability suite."""
    settings = clean_settings(config["stability"], wildcards.scene)
    return {"settings": target_settings(settings, 0)}


def detection_targets_made_with(wildcards):
    """The same for target lists of detection."""
    settings = json.loads(detection_section("views", "offsets"))
    return {"settings": target_settings(settings, 0)}


def fit_made_with(wildcards):
    """What the config says that an entrant is fitted with, besides a scene."""
    options = json.loads(method_options(ENTRIES, wildcards))
    return {
        "settings": fit_settings(replace(ENTRIES[wildcards.label], options=options))
    }


def recorded(pattern, expected, file=""):
    """An input function that refuses what the config would make otherwise, and nobody remakes.

    Snakemake makes a file again when its settings change, as long as it has a record of them.
    Without one, what the file itself says decides.
    """

    def no_more_input(wildcards):
        output = in_run(pattern).format(**wildcards)
        path = Path(output) / file
        if not workflow.is_main_process or not path.is_file():
            return []
        if workflow.persistence.metadata(IOFile(output, rule=None)) is None:
            try:
                check_stamp(path, made_with(path), expected(wildcards))
            except GeoEvsError as mistake:
                raise WorkflowError(str(mistake)) from None
        return []

    return no_more_input


# Snakemake forgets what made pictures when it drops them: then their scores remember it.
def renders_code(wildcards):
    """Hash of what renders pictures, where they are dropped."""
    return method_code("render")(wildcards) if DROPPED else "kept"

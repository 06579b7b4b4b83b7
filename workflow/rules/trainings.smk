# What methods learn before they are fitted (paper sections 3.2 to 3.4 for Geo-EVS): three rules for
# every method that has a training.py. A killed training goes on from its own folder, which is no
# output, because Snakemake deletes the outputs of jobs that it did not see end.

# The classes of the trainings that entrants take, by the method that has them.
TRAININGS = {
    trainer: training_class(trainer)
    for trainer in dict.fromkeys(
        entry.training.partition("/")[0] for entry in ENTRIES.values() if entry.training
    )
}
# Whose artifact masks are drawn: the ablation is about them.
ABLATED = config["tables"]["ablation"]


def prepared(wildcards):
    """What was prepared of every scene that a training has."""
    return prepared_files(wildcards.trainer)


def prepared_files(trainer):
    """The same, of a training by name."""
    pattern = layout.PREPARED.replace("{trainer}", trainer)
    partition = TRAININGS[trainer].partition
    return every_scene(pattern, partition_scenes(config, partition, config["datasets"]))


def combined(trainer):
    """What a training makes of all prepared files together, if it does so."""
    combines = issubclass(TRAININGS[trainer], CombinedTraining)
    return [in_run(layout.COMBINED).format(trainer=trainer)] if combines else []


def if_read(name, value):
    """A function for inputs and params: a value, where the training declares that it reads it."""

    def of(wildcards):
        if name not in TRAININGS[wildcards.trainer].reads:
            return []
        return value(wildcards) if callable(value) else value

    return of


def training_code(step):
    """A function for params: hash of what one step of a training reaches."""
    return lambda wildcards: code_hash(
        f"{find_trainings()[wildcards.trainer]}:Training.{step}",
        "geoevs.methods.training_steps",
    )


def settings_of(wildcards):
    """What the config says of a training."""
    return training_settings(config, f"{wildcards.trainer}/{wildcards.training}")


def prepare_arguments(wildcards, input):
    """What `geoevs prepare` is given besides the scene."""
    poses = shlex.quote(json.dumps(config["conditions"]["masks"]))
    masks = if_read("mask-poses", f"--mask-poses {poses}")(wildcards) or ""
    return f"{with_option('--point-maps', input.point_maps)} {masks}"


def train_arguments(wildcards, input):
    """What `geoevs train` is given besides settings."""
    geometry = [
        f"--geometry {GEOMETRY['model']}",
        with_option("--geometry-weights", FINETUNED or PRETRAINED),
    ]
    return " ".join(
        [
            with_option("--files", input.prepared),
            with_option("--combined", input.combined),
            *if_read("geometry", geometry)(wildcards),
            *if_read("prior", [with_option("--weights", [config["weights"]])])(
                wildcards
            ),
        ]
    )


def starting_hashes(wildcards):
    """Hashes of weights that no rule makes and that a training starts from."""
    return [
        if_read("geometry", pretrained_hash)(wildcards),
        if_read("prior", lambda _: prior_hash(prior_of(wildcards)))(wildcards),
    ]


def prior_of(wildcards):
    """The name of the weights that a training starts from."""
    settings = TRAININGS[wildcards.trainer].Settings
    return make_settings(wildcards.trainer, settings, settings_of(wildcards)).prior


rule prepare:
    input:
        scene=in_run(layout.SCENE),
        point_maps=if_read(
            "point-maps",
            lambda wildcards: in_run(layout.POINT_MAPS).format(**wildcards),
        ),
    output:
        in_run(layout.PREPARED),
    log:
        in_run("logs/prepare/{trainer}/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/prepare/{trainer}/{dataset}/{scene}.tsv")
    params:
        inputs=prepare_arguments,
        code=training_code("prepare"),
    shell:
        "geoevs --log {log:q} prepare {wildcards.trainer} --scene {input.scene:q} {params.inputs}"
        " --out {output:q}"


rule combine:
    input:
        prepared,
    output:
        in_run(layout.COMBINED),
    log:
        in_run("logs/combine/{trainer}.log"),
    params:
        code=training_code("combine"),
    shell:
        "geoevs --log {log:q} combine {wildcards.trainer} {input:q} --out {output:q}"


rule train:
    input:
        prepared=prepared,
        combined=lambda wildcards: combined(wildcards.trainer),
        geometry=if_read("geometry", FINETUNED),
    output:
        directory(in_run(layout.TRAINED)),
    log:
        in_run("logs/train/{trainer}/{training}.seed{seed}.log"),
    benchmark:
        in_run("benchmarks/train/{trainer}/{training}.seed{seed}.tsv")
    threads: workflow.cores
    params:
        inputs=train_arguments,
        settings=lambda wildcards: json.dumps(settings_of(wildcards)),
        starts_from=starting_hashes,
        work=in_run(layout.TRAINING).format(network="{trainer}/{training}.seed{seed}"),
        code=training_code("train"),
    shell:
        "geoevs --log {log:q} train {wildcards.trainer} {params.inputs}"
        " --settings {params.settings:q} --work {params.work:q} --seed {wildcards.seed}"
        " --out {output:q}"


rule mask_figure:
    input:
        every_scene(layout.TARGETS),
        every_scene(layout.REFERENCES),
        library=in_run(layout.COMBINED).format(trainer=ABLATED),
    output:
        in_run(layout.MASK_FIGURE),
    log:
        in_run("logs/mask_figure.log"),
    params:
        run=lambda wildcards, output: Path(output[0]).parents[1],
        scenes=scene_list(TEST_SCENES),
        code=code_hash("geoevs.results.mask_figure"),
    shell:
        "geoevs --log {log:q} mask-figure --library {input.library:q} --run {params.run:q}"
        " {params.scenes} --out {output:q}"


# What trainings learn from, and a picture of the masks that the ablation is about.
rule conditions:
    input:
        [
            file
            for trainer in TRAININGS
            for file in (*prepared_files(trainer), *combined(trainer))
        ],
        [
            in_run(layout.MASK_FIGURE)
            for trainer in TRAININGS
            if trainer == ABLATED and combined(trainer)
        ],

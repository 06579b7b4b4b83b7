# What stability's rules expand over, and how they tell commands which conditions to make.

STABILITY = config["stability"]
STABILITY_GROUPS = groups(STABILITY)
# The main run's entrants, with fewer iterations and the like where fits are long.
STABILITY_ENTRIES = {entry.label: entry for entry in stability_entries(config)}
STABILITY_FILES = [
    in_run(path)
    for path in (
        layout.STABILITY_TABLE,
        f"{layout.BREAKING_POINTS}.csv",
        f"{layout.BREAKING_POINTS}.md",
        layout.SEED_SPREAD,
    )
]
STABILITY_CURVES = [name for name in STRESSORS if STABILITY["levels"][name]]


def given_scenes(wildcards):
    """The stores that methods are given under the conditions of a group, in their order."""
    scenes = []
    for condition in conditions(wildcards.group, STABILITY):
        pattern, scene = layout.STRESSED, wildcards.scene
        if wildcards.group == CLEAN:
            pattern = layout.SCENE
        elif STRESSORS[wildcards.group].acts_on == "world":
            pattern, scene = layout.SCENE, world_name(scene, condition.level)
        level = f"{condition.level:g}"
        place = {"dataset": wildcards.dataset, "scene": scene, "level": level}
        scenes.append(
            in_run(pattern).format(
                stressor=wildcards.group, draw=condition.draw, **place
            )
        )
    return scenes


def stability_answers(wildcards):
    """The clean scene's answers; where each level is another world, those of all levels."""
    scenes = [wildcards.scene]
    if wildcards.group != CLEAN and STRESSORS[wildcards.group].acts_on == "world":
        scenes += [
            world_name(wildcards.scene, level)
            for level in STABILITY["levels"][wildcards.group]
        ]
    patterns = (layout.SCENE, layout.TARGETS, layout.REFERENCES, layout.TRUTH)
    return [
        in_run(pattern).format(dataset=wildcards.dataset, scene=scene)
        for pattern in patterns
        for scene in scenes
    ]


def stability_arguments(wildcards):
    """How a command is told which method, and which stressor it deals with."""
    entry = STABILITY_ENTRIES[wildcards.label]
    return (
        f"--method {entry.method} --variant {entry.variant} --seed {entry.seed} "
        f"--group {wildcards.group} --settings {shlex.quote(json.dumps(group_settings(wildcards)))}"
    )


def group_settings(wildcards):
    """What a group's jobs depend on: seeds, and its own levels."""
    levels = dict(STABILITY["levels"])
    if wildcards.group != CLEAN:
        levels = {wildcards.group: levels[wildcards.group]}
    return {
        "seeds": STABILITY["seeds"],
        "lateral": STABILITY["lateral"],
        "levels": levels,
    }

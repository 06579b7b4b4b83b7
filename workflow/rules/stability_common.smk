# What stability's rules expand over, and how they tell commands which stresses to make.

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
STABILITY_CURVES = [name for name in STRESSORS if levels_of(name, STABILITY)]


def given_scenes(wildcards):
    """The stores that methods are given under the stresses of a group, in their order."""
    return [
        in_run(layout.STRESSED if stress.kind == "store" else layout.SCENE).format(
            dataset=wildcards.dataset,
            scene=stress.world(wildcards.scene),
            stressor=stress.stressor,
            level=f"{stress.level:g}",
            draw=stress.draw,
        )
        for stress in stresses(wildcards.group, STABILITY)
    ]


def stability_answers(wildcards):
    """The clean scene's answers; where each level is another world, those of all levels."""
    worlds = [
        stress.world(wildcards.scene) for stress in stresses(wildcards.group, STABILITY)
    ]
    scenes = list(dict.fromkeys([wildcards.scene, *worlds]))
    patterns = (
        layout.SCENE,
        layout.TARGETS,
        layout.REFERENCES,
        layout.MASKS,
        layout.TRUTH,
    )
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
    stressors = STRESSORS if wildcards.group == CLEAN else [wildcards.group]
    return {
        "seeds": STABILITY["seeds"],
        "lateral": STABILITY["lateral"],
        "levels": {name: levels_of(name, STABILITY) for name in stressors},
    }

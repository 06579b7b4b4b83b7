# What jobs ask a cluster for, and which of them it is sent as one (docs/cluster.md). A local run is
# limited by none of it, unless --resources says how much there is.
import math

from geoevs.scenes.scene import SceneRef

# Of a step: MB whatever the size; MB a megapixel of resolution; MB, and minutes, a megapixel of all
# frames. About twice what benchmarks/ of the smoke and default runs say. A method's own minutes are
# those of budget.limits.
STEPS = {
    "scene": (1500, 15000, 20, 12),
    "truth": (1500, 25000, 20, 25),
    "references": (700, 5000, 20, 2),
    "depth": (1500, 10000, 20, 5),
    "prepare": (1000, 5000, 100, 0),
    "train": (2000, 40000, 40, 0),
    "fit": (2000, 20000, 100, 0),
    "score": (600, 5000, 10, 2),
    "features": (1500, 5000, 10, 4),
}
# Steps that may run networks, and the MB that networks of published size take besides.
NETWORKS = ("depth", "prepare", "train", "fit")
PUBLISHED = 16000
# Minutes of a job's own: starting, waiting for files, writing results.
SPARE = 30
# As many as a scene of Waymo, where the config does not say.
USUAL_FRAMES = 200

# Absent, not 0: to the plugin for Kubernetes a job that names none asks for one.
GPU = config["cluster"]["gpu"] or None
PRIORS = [training.get("prior", "nano") for training in config["trainings"].values()]
PUBLIC = GEOMETRY["model"] not in ("lidar", SUITE_MODEL) or {*PRIORS} - {"nano"}


localrules:
    scores,
    costs,
    set_scores,
    depth_scores,
    audit_rows,
    stability_scores,
    entrants,
    table,
    cost_table,
    ablation_table,
    geometry_table,
    complexity_table,
    rank_agreement,
    chart,
    complexity_chart,
    audit_page,
    stability_tables,
    stability_chart,
    detection_counts,
    detection_tables,
    install_weights,


def sent_as(group):
    """A group, whose jobs of one scene are sent as one.

    Snakemake has --jobs where they are sent elsewhere. Without, none has a group: a dry run adds up
    what a group asks for, and refuses more than this machine has.
    """
    return group if workflow.resource_settings.nodes is not None else None


@cache
def frames_of(dataset, scene):
    """How many frames a scene has, as far as its name or its source's options say."""
    name, _ = world_options(scene)
    _, first, last = SceneRef.parse(name)
    if first is not None:
        return last - first + 1
    return config["datasets"][dataset]["options"].get("frames", USUAL_FRAMES)


def megapixels(wildcards, scenes):
    """Those of an image, and of all frames of a job's scenes; one scene by its wildcards."""
    image = HEIGHT * WIDTH / 1e6
    if scenes is None:
        return image, image * frames_of(wildcards.dataset, wildcards.scene)
    return image, image * sum(frames_of(*scene) for scene in scenes(wildcards))


def scenes_of_dataset(wildcards):
    """The (dataset, scene) pairs of a data set's test scenes."""
    return [scene for scene in TEST_SCENES if scene[0] == wildcards.dataset]


def memory(step, scenes=None, tried=lambda wildcards: 0):
    """A function for `mem_mb`, more at each attempt.

    `scenes` gives the (dataset, scene) pairs that the job reads; `tried` the number of its attempt
    by what is on disk, odd after a fault of the machine, which lack of memory is to a method.
    """
    least, of_image, of_frames, _ = STEPS[step]
    if PUBLIC and step in NETWORKS:
        least += PUBLISHED

    def of(wildcards, attempt):
        image, frames = megapixels(wildcards, scenes)
        times = attempt + tried(wildcards) % 2
        return math.ceil(times * (least + image * of_image + frames * of_frames))

    return of


def minutes(step, scenes=None):
    """A function for `runtime`, more at each attempt."""
    of_frames = STEPS[step][-1]

    def of(wildcards, attempt):
        _, frames = megapixels(wildcards, scenes)
        return math.ceil(attempt * (SPARE + frames * of_frames))

    return of


def within(*limits):
    """Minutes in which steps of a method end or are ended; none where one of them may run on."""
    seconds = [LIMITS[limit] for limit in limits]
    return None if None in seconds else SPARE + math.ceil(sum(seconds) / 60)

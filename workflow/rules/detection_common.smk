# What the rules of table 3 expand over, and what their commands are given.
import re

from geoevs.detection.settings import DetectionSettings
from geoevs.detection.training_settings import NATIVE, settings_with, views_label
from geoevs.protocol.entries import TRUTH

DETECTION = config["detection"]
DETECTED = DetectionSettings.parse(DETECTION)
DETECTION_TRAIN = partition_scenes(config, "detection", config["datasets"])
DETECTION_TEST = partition_scenes(config, "detection-test", config["datasets"])
DETECTION_SCENES = [*DETECTION_TRAIN, *DETECTION_TEST]
# The main run's entrants, with the section's options.
DETECTION_ENTRIES = {entry.label: entry for entry in detection_entries(config)}
SETTINGS = settings_with(list(DETECTION_ENTRIES))
DETECTION_SEEDS = [config["seed"] + n for n in range(DETECTED.seeds)]
DETECTION_LABELS_OF = json.dumps(
    {label: [entry.method, entry.variant] for label, entry in DETECTION_ENTRIES.items()}
)
DETECTION_FILES = [
    *(in_run(layout.DETECTION_TABLE) + suffix for suffix in (".csv", ".md", ".tex")),
    *(in_run(layout.TASK_TABLE) + suffix for suffix in (".csv", ".md", ".tex")),
    *(in_run(layout.DETECTION_CHART) + suffix for suffix in (".csv", ".png", ".html")),
]


def detection_section(*keys):
    """Some keys of the config's section as JSON: what a job depends on."""
    return json.dumps({key: DETECTION[key] for key in keys if key in DETECTION})


def moved_too(wildcards):
    """Of test scenes, the rig moved aside is rendered too."""
    tested = (wildcards.dataset, wildcards.scene) in DETECTION_TEST
    return "--moved" if tested else ""


def of_detection(pattern, scenes=DETECTION_SCENES):
    """A pattern's paths for the stage's scenes; other wildcards are kept."""
    return [
        in_run(pattern).replace("{dataset}", dataset).replace("{scene}", scene)
        for dataset, scene in scenes
    ]


def pictures_of(label, scenes):
    """What holds an entrant's pictures of some scenes; nothing where there is none."""
    if label is None:
        return []
    if label == TRUTH:
        return of_detection(layout.DETECTION_TRUTH, scenes)
    return of_detection(layout.DETECTION_VIEWS.replace("{label}", label), scenes)


def detection_scenes(wildcards):
    """The (dataset, scene) pairs that detectors learn from, which take the most memory."""
    return DETECTION_TRAIN


def backbone_hash(wildcards):
    """Hash of the weights that a pretrained backbone is made of, which no rule makes."""
    return content_hash(f"{WEIGHTS_FOLDER}/{DETECTED.detector.backbone}.safetensors")


def run_of(pattern):
    """A function for params: the run's folder, which an output of this pattern lies in."""
    return lambda wildcards, output: Path(output[0]).parents[pattern.count("/")]


def shown_to(labels, scenes):
    """All that detectors see of some scenes, pictures of these entrants among it."""
    return [
        *of_detection(layout.SCENE, scenes),
        *of_detection(layout.DETECTION_LABELS, scenes),
        *of_detection(layout.DETECTION_TARGETS, scenes),
        *(path for label in labels for path in pictures_of(label, scenes)),
    ]

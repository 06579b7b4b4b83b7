# Whether generated views help a detector (paper section 4.6), and how far it can be trusted on them.
# Boxes are the labels: methods are given stores without any. Nothing here is timed alone, so jobs run
# side by side.

from geoevs.detection.task_rows import RECORDED
from geoevs.detection.training_settings import settings_with, views_label
from geoevs.protocol.entries import TRUTH

DETECTION = config["detection"]
DETECTION_TRAIN = partition_scenes(config, "detection", config["datasets"])
DETECTION_TEST = partition_scenes(config, "detection-test", config["datasets"])
DETECTION_SCENES = [*DETECTION_TRAIN, *DETECTION_TEST]
# The main run's entrants, with the section's options.
DETECTION_ENTRIES = {entry.label: entry for entry in detection_entries(config)}
SETTINGS = settings_with(list(DETECTION_ENTRIES))
DETECTION_SEEDS = [config["seed"] + n for n in range(DETECTION.get("seeds", 3))]
DETECTION_LABELS_OF = json.dumps(
    {label: [entry.method, entry.variant] for label, entry in DETECTION_ENTRIES.items()}
)
DETECTION_FILES = [
    *(in_run(layout.DETECTION_TABLE) + suffix for suffix in (".csv", ".md", ".tex")),
    *(in_run(layout.TASK_TABLE) + suffix for suffix in (".csv", ".md", ".tex")),
    *(in_run(layout.DETECTION_CHART) + suffix for suffix in (".csv", ".png", ".html")),
]


def detection_section(*keys):
    """The config's section, or some of its keys, as JSON: what a job depends on."""
    chosen = keys or [key for key in DETECTION if key != "methods"]
    return json.dumps({key: DETECTION[key] for key in chosen if key in DETECTION})


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
    """What holds an entrant's pictures of some scenes; nothing of what was recorded."""
    if label in (None, RECORDED):
        return []
    if label == TRUTH:
        return of_detection(layout.DETECTION_TRUTH, scenes)
    return of_detection(layout.DETECTION_VIEWS.replace("{label}", label), scenes)


def shown_to(scenes):
    """A function for inputs: all that detectors of a setting see of some scenes."""
    return lambda wildcards: [
        *of_detection(layout.SCENE, scenes),
        *of_detection(layout.DETECTION_LABELS, scenes),
        *of_detection(layout.DETECTION_TARGETS, scenes),
        *pictures_of(views_label(wildcards.setting), scenes),
    ]


rule detection_targets:
    input:
        scene=in_run(layout.SCENE),
    output:
        targets=in_run(layout.DETECTION_TARGETS),
        given=directory(in_run(layout.DETECTION_GIVEN)),
    log:
        in_run("logs/detection/targets/{dataset}/{scene}.log"),
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("references"),
        runtime=minutes("references"),
    params:
        settings=detection_section("views", "offsets"),
        moved=moved_too,
        code=code_hash("geoevs.detection.views"),
    shell:
        "geoevs --log {log:q} detection-targets --scene {input.scene:q}"
        " --settings {params.settings:q} {params.moved} --given {output.given:q}"
        " --out {output.targets:q}"


rule detection_labels:
    input:
        scene=in_run(layout.SCENE),
    output:
        in_run(layout.DETECTION_LABELS),
    log:
        in_run("logs/detection/labels/{dataset}/{scene}.log"),
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("references"),
        runtime=minutes("references"),
    params:
        settings=detection_section("classes", "detector"),
        code=code_hash("geoevs.detection.labels", "geoevs.detection.settings"),
    shell:
        "geoevs --log {log:q} detection-labels --scene {input.scene:q}"
        " --name {wildcards.dataset:q}/{wildcards.scene:q} --settings {params.settings:q}"
        " --out {output:q}"


rule detection_truth:
    input:
        targets=in_run(layout.DETECTION_TARGETS),
    output:
        directory(in_run(layout.DETECTION_TRUTH)),
    log:
        in_run("logs/detection/truth/{dataset}/{scene}.log"),
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("truth"),
        runtime=minutes("truth"),
    params:
        scene=scene_arguments,
        data=scene_data,
        code=source_code("geoevs.protocol.truth"),
    shell:
        "geoevs --log {log:q} truth {params.scene} --targets {input.targets:q} --out {output:q}"


rule detection_views:
    input:
        scene=in_run(layout.DETECTION_GIVEN),
        targets=in_run(layout.DETECTION_TARGETS),
        trained=trained,
    output:
        model=directory(in_run(layout.DETECTION_MODEL)),
        views=directory(in_run(layout.DETECTION_VIEWS)),
    log:
        in_run("logs/detection/views/{dataset}/{scene}/{label}.log"),
        fit=in_run("logs/detection/views/{dataset}/{scene}/{label}.fit.log"),
        render=in_run("logs/detection/views/{dataset}/{scene}/{label}.render.log"),
    group:
        sent_as("entrant")
    resources:
        mem_mb=memory("fit", tried=tried(layout.DETECTION_VIEWS, "render.json")),
        runtime=within("fit", "render"),
        gpu=GPU,
    params:
        entry=entry_arguments,
        options=lambda wildcards: method_options(DETECTION_ENTRIES, wildcards),
        outside=lambda wildcards: outside_files(**wildcards),
        attempt=attempt(layout.DETECTION_VIEWS, "render.json"),
        told=lambda wildcards, output: attempt_of(output.views, ["render.json"]),
        code=lambda wildcards: [method_code(step)(wildcards) for step in ("fit", "render")],
    shell:
        "geoevs --log {log[0]:q} detection-views {params.entry} --options {params.options:q}"
        " --scene {input.scene:q} --targets {input.targets:q} --model {output.model:q}"
        " --fit-log {log.fit:q} --render-log {log.render:q} --attempt {params.told}"
        " --out {output.views:q}"

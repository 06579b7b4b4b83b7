# The checked config, the code hashes that make rules rerun, and the lists that targets expand over.
import json
import shlex
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

from geoevs import layout
from geoevs.core.code_hash import code_hash
from geoevs.config.checks import SUITE_MODEL, check_config
from geoevs.config.entrants import (
    detection_entries,
    method_entries,
    stability_entries,
)
from geoevs.config.partitions import partition_scenes
from geoevs.config.places import merge_order
from geoevs.config.trainings import training_settings
from geoevs.core.errors import GeoEvsError
from geoevs.core.hashes import hash_path, outside_hash
from geoevs.core.locks import lock_folder
from geoevs.core.names import expanded
from geoevs.core.settings import make_settings
from geoevs.methods.finding import (
    find_methods,
    find_trainings,
    make_method,
    training_class,
)
from geoevs.methods.training import CombinedTraining
from geoevs.methods.contract import ORACLES, ReadsFiles
from geoevs.core.stamps import check_stamp
from geoevs.protocol.provenance import made_with, scene_stamp, target_settings
from geoevs.protocol.runs import fit_settings
from geoevs.protocol.stability import (
    CLEAN,
    clean_settings,
    groups,
    levels_of,
    stresses,
    world_options,
)
from geoevs.protocol.stressors import STRESSORS
from geoevs.results.manifest import cached_repository
from geoevs.results.table_specs import TABLES
from geoevs.scenes.scene import SceneRef, find_sources, load_source
from snakemake.exceptions import WorkflowError
from snakemake.io import IOFile


def config_files():
    """The files that the config was merged from, later ones winning, as named if they lie here."""
    settings = workflow.config_settings
    # Snakemake has the Snakefile's own last, though all that are given override it.
    own = workflow.configfiles[len(settings.configfiles) :]
    if settings.replace_workflow_config and settings.overwrite_config:
        own = []
    return merge_order(own, settings.configfiles)


if (
    workflow.is_main_process
):  # jobs sent elsewhere read these rules too, maybe without the schema
    try:
        check_config(
            config,
            Path(workflow.basedir) / "workflow/schemas/config.schema.yaml",
            config_files(),
            workflow.config_settings.config,
        )
    except GeoEvsError as mistake:
        raise WorkflowError(str(mistake)) from None

# `geoevs` is the one beside this Python, whether or not its environment is activated.
# Numba and OpenCV do not heed what Snakemake sets for other libraries, and their idle threads spin.
# Limits of seconds are no params: another one concerns only what ran into the one before, which
# `attempt` sees (attempts.smk).
LIMITS = config["budget"]["limits"]
shell.prefix(
    f"export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH;"
    " export NUMBA_NUM_THREADS=$OMP_NUM_THREADS OPENCV_FOR_THREADS_NUM=$OMP_NUM_THREADS; "
    + "".join(
        f"export GEOEVS_{step.upper()}_LIMIT={seconds}; "
        for step, seconds in LIMITS.items()
        if seconds is not None
    )
)

# Thousands of jobs share a few hashes.
code_hash = cache(code_hash)
adapter_module = cache(lambda method: find_methods()[method])

# The shell's own printf takes any number of files; no other program does.
COLLECT = (
    "printf '%s\\n' {input:q} | geoevs --log {log:q} collect --list - --out {output:q}"
)

RUN = f"results/{config['run']}"
HEIGHT, WIDTH = config["resolution"]
PROTOCOL = json.dumps(config["protocol"])
ENTRIES = {entry.label: entry for entry in method_entries(config)}
TEST_SCENES = partition_scenes(config, "test", config["evaluate"])
GEOMETRY_SCENES = partition_scenes(config, "geometry", config["datasets"])
STABILITY_SCENES = partition_scenes(config, "test", config["stability"]["datasets"])
PRETRAINING_SCENES = partition_scenes(config, "pretrain", config["datasets"])


wildcard_constraints:
    dataset="[^/]+",
    scene="[^/]+",
    label="[^/]+",
    table="|".join(TABLES),
    trainer="[^/]+",
    training="[^/.]+",
    seed="[0-9]+",


def lock_run():
    """Refuse to work on a run that another Snakemake works on; its own lock outlives a kill."""
    try:
        lock_folder(Path(RUN))
    except GeoEvsError as mistake:
        raise WorkflowError(str(mistake)) from None


def in_run(pattern):
    """A path pattern of the run, its wildcards kept."""
    return f"{RUN}/{pattern}"


def as_stored(path):
    """Where a job finds a file of the run: there, or in what a storage plugin copies to it."""
    return str(workflow.inputfile(path))


# Folder of this suite's own starting weights.
WEIGHTS_FOLDER = str(expanded(config["weights"]))
# The files with the depth network's weights before and after fine-tuning; one or none.
GEOMETRY = config["geometry"]
PRETRAINED = []
FINETUNED = []
if GEOMETRY["model"] != "lidar":
    PRETRAINED = [
        str(
            expanded(
                GEOMETRY["weights"] or f"{WEIGHTS_FOLDER}/{SUITE_MODEL}.safetensors"
            )
        )
    ]
    FINETUNED = [in_run(layout.FINETUNED)] if GEOMETRY["finetune"] else []


def every_scene(pattern, scenes=TEST_SCENES):
    """The pattern's paths for all test scenes, or for others."""
    return [
        in_run(pattern).format(dataset=dataset, scene=scene)
        for dataset, scene in scenes
    ]


def of_dataset(pattern, dataset):
    """The pattern's paths for a data set's test scenes; other wildcards are kept."""
    return [
        in_run(pattern).replace("{dataset}", dataset).replace("{scene}", scene)
        for owner, scene in TEST_SCENES
        if owner == dataset
    ]


def suite_results(wildcards):
    """Results of stages of their own, if they were run, or if this call runs them: report waits."""
    suites = {
        "stability": (layout.STABILITY_TABLE, rules.stability.input),
        "audit": (layout.AUDIT_PAGE, rules.audit.input),
        "detection": (f"{layout.DETECTION_TABLE}.csv", rules.detection.input),
    }
    return [
        file
        for suite, (sign, files) in suites.items()
        if suite in workflow.dag_settings.targets or Path(in_run(sign)).exists()
        for file in files
    ]


def other_results(expected):
    """Hashes of results in the run besides the expected ones: a report without them is remade."""
    found = [
        file
        for folder in Path(RUN).glob("[!.]*/")
        if folder.name not in layout.DATA_FOLDERS
        for suffix in ("csv", "png", "html", "md")
        for file in sorted(folder.glob(f"*.{suffix}"))
    ]
    return {str(file): hash_path(file) for file in found if str(file) not in expected}


def scene_list(scenes):
    """Scenes as options of commands that take many."""
    return with_option("--scenes", [f"{dataset}/{scene}" for dataset, scene in scenes])


@cache
def content_hash(path):
    """Hash of a file or folder that no rule makes; a job that needs a missing one says so."""
    return hash_path(path) if Path(path).exists() else "missing"


def every_result(pattern):
    """The pattern's paths for all entrants on all test scenes."""
    return [
        path.format(label=label)
        for path in every_scene(pattern.replace("{label}", "{{label}}"))
        for label in ENTRIES
    ]


def every_entrant(pattern):
    """The pattern's paths for all entrants on all data sets."""
    datasets = dict.fromkeys(dataset for dataset, _ in TEST_SCENES)
    return [
        in_run(pattern).format(dataset=dataset, label=label)
        for dataset in datasets
        for label in ENTRIES
    ]


def scene_of(wildcards):
    """A scene's source, its name there, and the source's options."""
    dataset = config["datasets"][wildcards.dataset]
    name, changed = world_options(wildcards.scene)
    return dataset["source"], name, dataset["options"] | changed


def scene_arguments(wildcards):
    """How `geoevs scene` and `geoevs truth` are told which scene to read or render."""
    source, name, options = scene_of(wildcards)
    return (
        f"--source {shlex.quote(source)} --name {shlex.quote(name)} --height {HEIGHT} "
        f"--width {WIDTH} --options {shlex.quote(json.dumps(options))}"
    )


def scene_data(wildcards):
    """Hash of the files that a scene is read from; where they are gone, the one in its store."""
    source, name, options = scene_of(wildcards)
    reader = load_source(source, HEIGHT, WIDTH, options)
    files = list(reader.files(SceneRef.parse(name)))
    store = Path(in_run(layout.SCENE).format(**wildcards)) / "scene.json"
    if files and store.exists() and not any(map(Path.exists, files)):
        return (made_with(store) or {}).get("data", "none")
    return outside_hash(files) if files else "none"


def source_code(module):
    """A function for `params`: hash of a scene's data source, and of the module that asks it."""

    def of(wildcards):
        source = config["datasets"][wildcards.dataset]["source"]
        return code_hash(find_sources()[source], module)

    return of


def method_code(step):
    """A function for `params`: hash of a method and of the step that runs it."""

    def of(wildcards):
        method = ENTRIES[wildcards.label].method
        oracle = method in ORACLES
        adapter = "geoevs.protocol.oracle" if oracle else adapter_module(method)
        return code_hash(
            f"geoevs.protocol.{step}_step", "geoevs.protocol.runs", adapter
        )

    return of


def entry_arguments(wildcards):
    """How a command is told which entrant it deals with."""
    entry = ENTRIES[wildcards.label]
    return (
        f"--method {shlex.quote(entry.method)} --variant {shlex.quote(entry.variant)} "
        f"--seed {entry.seed}"
    )


def entrant_options(wildcards):
    """Every entrant's options by its name in the config, as JSON; seeds share them."""
    return json.dumps({entry.name: entry.options for entry in ENTRIES.values()})


def entrant_code(wildcards):
    """Hash of all methods that play."""
    methods = {entry.method for entry in ENTRIES.values()} - set(ORACLES)
    modules = [adapter_module(method) for method in sorted(methods)]
    return code_hash("geoevs.protocol.entrants", *modules)


@cache
def reader_of_files(label):
    """An entrant that reads files that no step makes; None of others."""
    entry = ENTRIES[label]
    if entry.method in ORACLES:
        return None
    try:
        method = make_method(entry.method, entry.options)
    except Exception:  # as with an option that its training gives
        return None
    return method if isinstance(method, ReadsFiles) else None


@cache
def outside_files(label, dataset, scene):
    """Hash of the files that no step makes and that an entrant reads for a scene."""
    reader = reader_of_files(label)
    if reader is None:
        return "none"
    name, _ = world_options(scene)
    return outside_hash(reader.files(SceneRef.parse(name).name))


def fit_arguments(wildcards):
    """What only a fit is told: the method's options, and the wall time it may take."""
    seconds = config["budget"]["fit_seconds"]
    limit = "" if seconds is None else f"--fit-seconds {seconds}"
    return f"--options {shlex.quote(method_options(ENTRIES, wildcards))} {limit}"


def method_options(entries, wildcards):
    """An entrant's own options as JSON, and the weights that it was trained to."""
    weights = {"weights": as_stored(path) for path in trained(wildcards)}
    return json.dumps(entries[wildcards.label].options | weights)


def trained(wildcards):
    """The training whose weights an entrant takes, if it takes any."""
    entry = ENTRIES[wildcards.label]
    if not entry.training:
        return []
    trainer, _, training = entry.training.partition("/")
    path = in_run(layout.TRAINED)
    return [path.format(trainer=trainer, training=training, seed=entry.seed)]


# What trainings start from, which are no output that tables need.
PRIOR_FILES = [
    f"{WEIGHTS_FOLDER}/{name}.safetensors" for name in ("autoencoder", "prior")
]


def prior_hash(name):
    """Hash of the weights that a training starts from: one that failed without them runs again."""
    if name == "nano":
        return " ".join(content_hash(path) for path in PRIOR_FILES)
    folder = expanded(name)
    return content_hash(folder) if folder.exists() else cached_repository(name)


def starting_weights(wildcards):
    """The weights on this machine that trainings may start from."""
    return [path for path in [*PRETRAINED, *PRIOR_FILES] if Path(path).exists()]


def oracle_answers(wildcards):
    """What the controls reference and truth, and they alone, may look at."""
    if ENTRIES[wildcards.label].method not in ORACLES:
        return {}
    return {
        "scene": in_run(layout.SCENE),
        "references": in_run(layout.REFERENCES),
        "truth": in_run(layout.TRUTH),
    }


def oracle_arguments(wildcards, input):
    """How they are told where it is."""
    if not oracle_answers(wildcards):
        return ""
    run = Path(input.model).parents[3]
    return (
        f"--run {shlex.quote(str(run))} --dataset {shlex.quote(wildcards.dataset)} "
        f"--scene {shlex.quote(wildcards.scene)}"
    )


def with_option(option, paths):
    """Every path behind an option."""
    return " ".join(f"{option} {shlex.quote(str(path))}" for path in paths)


def pretrained_hash(wildcards):
    """No rule makes the depth network's starting weights, so params say which they are."""
    return " ".join(content_hash(path) for path in PRETRAINED)


def training_frames(wildcards, input):
    """Scenes, and their true depth where a depth network may learn from it."""
    return f"{with_option('--scenes', input.scenes)} {with_option('--depths', input.depths)}"


def training_arguments(settings):
    """How long and how fast a network learns."""
    return (
        f"--steps {settings['steps']} --batch {settings['batch']} "
        f"--learning-rate {settings['learning_rate']} --seed {config['seed']}"
    )

# What the rules of trainings expand over, and what their commands are given.

# The classes of the trainings that entrants take, by the method that has them.
TRAININGS = {
    trainer: training_class(trainer)
    for trainer in dict.fromkeys(
        entry.training.partition("/")[0] for entry in ENTRIES.values() if entry.training
    )
}
# The depth network's seconds lie beside its weights. A storage plugin copies what is named alone;
# elsewhere nobody names them, since another input would train again what is trained.
STORED_SECONDS = [
    in_run(layout.FINETUNED_SECONDS)
    for _ in FINETUNED
    if workflow.storage_settings.default_storage_provider
]
# Whose artifact masks are drawn: the ablation is about them.
ABLATED = config["tables"]["ablation"]


def prepared(wildcards):
    """What was prepared of every scene that a training has."""
    return prepared_files(wildcards.trainer)


def prepared_files(trainer):
    """The same, of a training by name."""
    pattern = layout.PREPARED.replace("{trainer}", trainer)
    return every_scene(pattern, scenes_of_training(trainer))


def learned_scenes(wildcards):
    """The (dataset, scene) pairs that a training has."""
    return scenes_of_training(wildcards.trainer)


def scenes_of_training(trainer):
    """The same, of a training by name."""
    partition = TRAININGS[trainer].partition
    return partition_scenes(config, partition, config["datasets"])


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
        with_option("--geometry-weights", input.geometry or PRETRAINED),
    ]
    return " ".join(
        [
            with_option("--files", input.prepared),
            with_option("--combined", input.combined),
            *if_read("geometry", geometry)(wildcards),
            *if_read("prior", [with_option("--weights", [WEIGHTS_FOLDER])])(wildcards),
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


def pretrained(network):
    """Where a new network is written."""
    return in_run(layout.PRETRAINED).format(weights=network)


def pretraining_work(network):
    """A pretraining's own folder, no output: Snakemake deletes those of killed jobs."""
    return in_run(layout.TRAINING).format(network=f"pretrain-{network}")

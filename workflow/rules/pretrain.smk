# This suite's own starting weights, on scenes that no other partition uses. No table needs these
# rules: tables start from the weights that lie in config["weights"], where `pretrain` puts new ones.

WEIGHTS = (SUITE_MODEL, "autoencoder", "prior")


rule pretrain_geometry:
    input:
        scenes=every_scene(layout.SCENE, PRETRAINING_SCENES),
        depths=every_scene(layout.DEPTHS, PRETRAINING_SCENES),
    output:
        pretrained("unrefined"),
    log:
        in_run("logs/pretrain/vggt-nano.log"),
    benchmark:
        in_run("benchmarks/pretrain/vggt-nano.tsv")
    threads: workflow.cores
    resources:
        mem_mb=memory("train", lambda wildcards: PRETRAINING_SCENES),
        runtime=within("training"),
        gpu=GPU,
    params:
        frames=training_frames,
        settings=training_arguments(config["pretrain"][SUITE_MODEL]),
        work=pretraining_work(SUITE_MODEL),
        code=code_hash("geoevs.geometry.finetuning"),
    shell:
        "geoevs --log {log:q} train-geometry {params.frames} {params.settings} --half"
        " --work {params.work:q} --out {output:q}"


# Its file holds both networks.
rule pretrain_refiner:
    input:
        scenes=every_scene(layout.SCENE, PRETRAINING_SCENES),
        depths=every_scene(layout.DEPTHS, PRETRAINING_SCENES),
        model=pretrained("unrefined"),
    output:
        pretrained(SUITE_MODEL),
    log:
        in_run("logs/pretrain/depth-refiner.log"),
    benchmark:
        in_run("benchmarks/pretrain/depth-refiner.tsv")
    threads: workflow.cores
    resources:
        mem_mb=memory("train", lambda wildcards: PRETRAINING_SCENES),
        runtime=within("training"),
        gpu=GPU,
    params:
        frames=training_frames,
        settings=training_arguments(config["pretrain"]["depth-refiner"]),
        work=pretraining_work("depth-refiner"),
        code=code_hash("geoevs.geometry.refiner_training"),
    shell:
        "geoevs --log {log:q} train-refiner --model {input.model:q} {params.frames}"
        " {params.settings} --work {params.work:q} --out {output:q}"


rule pretrain_autoencoder:
    input:
        scenes=every_scene(layout.SCENE, PRETRAINING_SCENES),
    output:
        pretrained("autoencoder"),
    log:
        in_run("logs/pretrain/autoencoder.log"),
    benchmark:
        in_run("benchmarks/pretrain/autoencoder.tsv")
    threads: workflow.cores
    resources:
        mem_mb=memory("train", lambda wildcards: PRETRAINING_SCENES),
        runtime=within("training"),
        gpu=GPU,
    params:
        scenes=lambda wildcards, input: with_option("--scenes", input.scenes),
        settings=training_arguments(config["pretrain"]["autoencoder"]),
        work=pretraining_work("autoencoder"),
        code=code_hash("geoevs.diffusion.pretraining"),
    shell:
        "geoevs --log {log:q} train-autoencoder {params.scenes} {params.settings}"
        " --work {params.work:q} --out {output:q}"


rule pretrain_prior:
    input:
        scenes=every_scene(layout.SCENE, PRETRAINING_SCENES),
        autoencoder=pretrained("autoencoder"),
    output:
        pretrained("prior"),
    log:
        in_run("logs/pretrain/prior.log"),
    benchmark:
        in_run("benchmarks/pretrain/prior.tsv")
    threads: workflow.cores
    resources:
        mem_mb=memory("train", lambda wildcards: PRETRAINING_SCENES),
        runtime=within("training"),
        gpu=GPU,
    params:
        scenes=lambda wildcards, input: with_option("--scenes", input.scenes),
        settings=training_arguments(config["pretrain"]["prior"]),
        work=pretraining_work("prior"),
        code=code_hash("geoevs.diffusion.pretraining"),
    shell:
        "geoevs --log {log:q} train-prior {params.scenes} --autoencoder {input.autoencoder:q}"
        " {params.settings} --work {params.work:q} --out {output:q}"


rule install_weights:
    input:
        [pretrained(weights) for weights in WEIGHTS],
    output:
        in_run("pretrain/provenance.json"),
    log:
        in_run("logs/pretrain/install.log"),
    params:
        work=" ".join(
            f"--work '{training}={pretraining_work(training)}'"
            for training in config["pretrain"]
        ),
        weights=WEIGHTS_FOLDER,
        config=json.dumps(config),
        code=code_hash("geoevs.results.manifest"),
    shell:
        "geoevs --log {log:q} install-weights {input:q} {params.work}"
        " --config {params.config:q} --weights {params.weights:q} --out {output:q}"


rule pretrain:
    input:
        rules.install_weights.output,

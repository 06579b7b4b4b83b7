# This suite's own starting weights, on scenes that no other partition uses. No table needs these
# rules: tables start from the weights that lie in config["weights"], where `pretrain` puts new ones.

NETWORKS = (SUITE_MODEL, "autoencoder", "prior")


rule pretrain_geometry:
    input:
        scenes=every_scene(layout.SCENE, PRETRAINING_SCENES),
        depths=every_scene(layout.DEPTHS, PRETRAINING_SCENES),
    output:
        pretrained(SUITE_MODEL),
    log:
        in_run("logs/pretrain/vggt-nano.log"),
    benchmark:
        in_run("benchmarks/pretrain/vggt-nano.tsv")
    threads: workflow.cores
    params:
        frames=training_frames,
        settings=training_arguments(config["pretrain"][SUITE_MODEL]),
        work=pretraining_work(SUITE_MODEL),
        code=code_hash("geoevs.geometry.finetuning"),
    shell:
        "geoevs --log {log:q} train-geometry {params.frames} {params.settings} --half"
        " --work {params.work:q} --out {output:q}"


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
    params:
        scenes=lambda wildcards, input: with_option("--scenes", input.scenes),
        settings=training_arguments(config["pretrain"]["autoencoder"]),
        work=pretraining_work("autoencoder"),
        code=code_hash("geoevs.generator.pretraining"),
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
    params:
        scenes=lambda wildcards, input: with_option("--scenes", input.scenes),
        settings=training_arguments(config["pretrain"]["prior"]),
        work=pretraining_work("prior"),
        code=code_hash("geoevs.generator.pretraining"),
    shell:
        "geoevs --log {log:q} train-prior {params.scenes} --autoencoder {input.autoencoder:q}"
        " {params.settings} --work {params.work:q} --out {output:q}"


rule install_weights:
    input:
        [pretrained(network) for network in NETWORKS],
    output:
        in_run("pretrain/provenance.json"),
    log:
        in_run("logs/pretrain/install.log"),
    params:
        new=lambda wildcards, output: Path(output[0]).parent,
        work=" ".join(
            f"--work '{network}={pretraining_work(network)}'" for network in NETWORKS
        ),
        weights=config["weights"],
        config=json.dumps(config),
    shell:
        "geoevs --log {log:q} install-weights {params.new:q} {params.work}"
        " --config {params.config:q} --weights {params.weights:q} --out {output:q}"


rule pretrain:
    input:
        rules.install_weights.output,

# Training FreeVS: pseudo-images of clips, and a denoiser of them (see rule train).


rule clips:
    input:
        scene=in_run(layout.SCENE),
    output:
        in_run(layout.CLIPS),
    log:
        in_run("logs/clips/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/clips/{dataset}/{scene}.tsv")
    params:
        code=code_hash("baselines.freevs.clips"),
    shell:
        "geoevs --log {log:q} clips --scene {input.scene:q} --out {output:q}"


rule train_freevs:
    input:
        clips=every_scene(layout.CLIPS, CLIP_SCENES),
    output:
        directory(in_run(layout.TRAINED).format(training=FREEVS, seed="{seed}")),
    log:
        in_run("logs/train/freevs.seed{seed}.log"),
    benchmark:
        in_run("benchmarks/train/freevs.seed{seed}.tsv")
    threads: workflow.cores
    params:
        clips=lambda wildcards, input: with_option("--clips", input.clips),
        settings=json.dumps(config["freevs"]),
        weights=config["weights"],
        prior=lambda wildcards: prior_hash(config["freevs"]["prior"]),
        work=in_run(layout.TRAINING).format(network="freevs.seed{seed}"),
        code=code_hash("baselines.freevs.task"),
    shell:
        "geoevs --log {log:q} train-freevs {params.clips} --settings {params.settings:q}"
        " --weights {params.weights:q} --work {params.work:q} --seed {wildcards.seed}"
        " --out {output:q}"


ruleorder: train_freevs > train

# Training Geo-EVS (paper sections 3.3, 3.4). A killed training goes on from its own folder, which
# is no output, because Snakemake deletes the outputs of jobs that it did not see end.


rule train:
    input:
        pairs=every_scene(layout.PAIRS, TRAINING_SCENES),
        library=in_run(layout.MASK_LIBRARY),
        geometry=FINETUNED,
    output:
        directory(in_run(layout.TRAINED)),
    log:
        in_run("logs/train/{training}.seed{seed}.log"),
    benchmark:
        in_run("benchmarks/train/{training}.seed{seed}.tsv")
    threads: workflow.cores
    params:
        pairs=lambda wildcards, input: with_option("--pairs", input.pairs),
        settings=lambda wildcards: json.dumps(
            training_settings(config, wildcards.training)
        ),
        geometry=GEOMETRY["model"],
        geometry_weights=with_option("--geometry-weights", FINETUNED or PRETRAINED),
        pretrained=pretrained_hash,
        weights=config["weights"],
        prior=lambda wildcards: prior_hash(
            training_settings(config, wildcards.training)["prior"]
        ),
        work=in_run(layout.TRAINING).format(network="{training}.seed{seed}"),
        code=code_hash("geoevs.generator.geo_evs.task"),
    shell:
        "geoevs --log {log:q} train {params.pairs} --library {input.library:q}"
        " --settings {params.settings:q} --weights {params.weights:q}"
        " --geometry {params.geometry:q} {params.geometry_weights} --work {params.work:q}"
        " --seed {wildcards.seed} --out {output:q}"

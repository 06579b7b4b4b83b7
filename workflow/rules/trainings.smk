# What methods learn before they are fitted (paper sections 3.2 to 3.4 for Geo-EVS): three rules for
# every method that has a training.py. A killed training goes on from its own folder, which is no
# output, because Snakemake deletes the outputs of jobs that it did not see end.


rule prepare:
    input:
        scene=in_run(layout.SCENE),
        point_maps=if_read(
            "point-maps",
            lambda wildcards: [in_run(layout.POINT_MAPS).format(**wildcards)],
        ),
    output:
        in_run(layout.PREPARED),
    log:
        in_run("logs/prepare/{trainer}/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/prepare/{trainer}/{dataset}/{scene}.tsv")
    group:
        sent_as("prepare")
    resources:
        mem_mb=memory("prepare", tried=tried(layout.PREPARED)),
        runtime=within("training"),
    params:
        inputs=prepare_arguments,
        attempt=attempt(layout.PREPARED),
        told=told(),
        code=training_code("prepare"),
    shell:
        "geoevs --log {log:q} prepare {wildcards.trainer} --scene {input.scene:q} {params.inputs}"
        " --attempt {params.told} --out {output:q}"


rule combine:
    input:
        prepared,
    output:
        in_run(layout.COMBINED),
    log:
        in_run("logs/combine/{trainer}.log"),
    resources:
        mem_mb=memory("prepare", learned_scenes, attempt(layout.COMBINED)),
        runtime=within("training"),
    params:
        attempt=attempt(layout.COMBINED),
        told=told(),
        code=training_code("combine"),
    shell:
        "geoevs --log {log:q} combine {wildcards.trainer} {input:q}"
        " --attempt {params.told} --out {output:q}"


rule train:
    input:
        prepared=prepared,
        combined=lambda wildcards: combined(wildcards.trainer),
        geometry=if_read("geometry", FINETUNED),
        seconds=if_read("geometry", STORED_SECONDS),
    output:
        directory(in_run(layout.TRAINED)),
    log:
        in_run("logs/train/{trainer}/{training}.seed{seed}.log"),
    benchmark:
        in_run("benchmarks/train/{trainer}/{training}.seed{seed}.tsv")
    threads: workflow.cores
    resources:
        mem_mb=memory(
            "train",
            learned_scenes,
            attempt(layout.TRAINED, "failure.json", "attempt.json"),
        ),
        runtime=within("training"),
        gpu=GPU,
    params:
        inputs=train_arguments,
        settings=lambda wildcards: json.dumps(settings_of(wildcards)),
        starts_from=starting_hashes,
        work=in_run(layout.TRAINING).format(network="{trainer}/{training}.seed{seed}"),
        attempt=attempt(layout.TRAINED, "failure.json", "attempt.json"),
        told=told("failure.json", "attempt.json"),
        code=training_code("train"),
    shell:
        "geoevs --log {log:q} train {wildcards.trainer} {params.inputs}"
        " --settings {params.settings:q} --work {params.work:q} --seed {wildcards.seed}"
        " --attempt {params.told} --out {output:q}"


rule mask_figure:
    input:
        every_scene(layout.TARGETS),
        every_scene(layout.REFERENCES),
        library=in_run(layout.COMBINED).format(trainer=ABLATED),
    output:
        in_run(layout.MASK_FIGURE),
    log:
        in_run("logs/mask_figure.log"),
    params:
        run=lambda wildcards, output: Path(output[0]).parents[1],
        scenes=scene_list(TEST_SCENES),
        code=code_hash("geoevs.results.mask_figure"),
    shell:
        "geoevs --log {log:q} mask-figure --library {input.library:q} --run {params.run:q}"
        " {params.scenes} --out {output:q}"


# What trainings learn from, and a picture of the masks that the ablation is about.
rule conditions:
    input:
        [
            file
            for trainer in TRAININGS
            for file in (*prepared_files(trainer), *combined(trainer))
        ],
        [
            in_run(layout.MASK_FIGURE)
            for trainer in TRAININGS
            if trainer == ABLATED and combined(trainer)
        ],

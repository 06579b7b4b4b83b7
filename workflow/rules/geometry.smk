# Depth of every recorded view, by a depth model (paper section 3.2), and how good it is.

if FINETUNED:

    rule finetune_geometry:
        input:
            scenes=every_scene(layout.SCENE, GEOMETRY_SCENES),
            depths=(
                every_scene(layout.DEPTHS, GEOMETRY_SCENES)
                if GEOMETRY["supervision"] == "dense"
                else []
            ),
        output:
            weights=FINETUNED,
            seconds=in_run(layout.FINETUNED_SECONDS),
        log:
            in_run("logs/finetune_geometry.log"),
        benchmark:
            in_run("benchmarks/finetune_geometry.tsv")
        threads: workflow.cores
        resources:
            mem_mb=memory("train", lambda wildcards: GEOMETRY_SCENES),
            runtime=within("training"),
            gpu=GPU,
        params:
            frames=training_frames,
            settings=training_arguments(GEOMETRY["finetune"]),
            start=with_option("--start", PRETRAINED),
            pretrained=pretrained_hash,
            # Not an output: those of a killed job are deleted.
            work=in_run(layout.TRAINING).format(network="vggt"),
            code=code_hash("geoevs.geometry.finetuning"),
        shell:
            "geoevs --log {log:q} train-geometry {params.frames} {params.settings}"
            " {params.start} --work {params.work:q} --out {output.weights:q}"


rule point_maps:
    input:
        scene=in_run(layout.SCENE),
        weights=FINETUNED,
    output:
        in_run(layout.POINT_MAPS),
    log:
        in_run("logs/point-maps/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/point-maps/{dataset}/{scene}.tsv")
    group:
        sent_as("prepare")
    resources:
        mem_mb=memory("depth"),
        runtime=minutes("depth"),
        gpu=GPU,
    params:
        model=GEOMETRY["model"],
        weights=with_option("--weights", [*map(as_stored, FINETUNED)] or PRETRAINED),
        pretrained=pretrained_hash,
        code=code_hash("geoevs.geometry.point_maps"),
    shell:
        "geoevs --log {log:q} point-maps --scene {input.scene:q} --model {params.model:q}"
        " {params.weights} --out {output:q}"


# Timed, so it takes all cores and runs alone.
rule depth_scores_of_scene:
    input:
        scene=in_run(layout.SCENE),
        depths=in_run(layout.DEPTHS),
        finetuned=FINETUNED,
    output:
        in_run(layout.DEPTH_SCORE_PART),
    log:
        in_run(layout.DEPTH_SCORE_LOG),
    benchmark:
        in_run("benchmarks/depth-scores/{dataset}/{scene}.tsv")
    threads: workflow.cores
    resources:
        mem_mb=memory("depth"),
        runtime=minutes("depth"),
        gpu=GPU,
    params:
        model=GEOMETRY["model"],
        before=with_option("--pretrained", PRETRAINED),
        after=with_option("--finetuned", map(as_stored, FINETUNED)),
        pretrained=pretrained_hash,
        code=code_hash("geoevs.protocol.depth_scoring"),
    shell:
        "geoevs --log {log:q} score-geometry --dataset {wildcards.dataset:q}"
        " --scene-name {wildcards.scene:q} --scene {input.scene:q} --depths {input.depths:q}"
        " --model {params.model:q} {params.before} {params.after} --out {output:q}"


rule depth_scores:
    input:
        every_scene(layout.DEPTH_SCORE_PART),
    output:
        in_run(layout.DEPTH_SCORES),
    log:
        in_run("logs/depth-scores.log"),
    params:
        code=code_hash("geoevs.core.parquet"),
    shell:
        COLLECT

# This suite's own starting weights, on scenes that no other partition uses. No table needs it.


rule pretrain_geometry:
    input:
        scenes=every_scene(layout.SCENE, PRETRAINING_SCENES),
        depths=every_scene(layout.DEPTHS, PRETRAINING_SCENES),
    output:
        in_run(layout.PRETRAINED).format(weights=SUITE_MODEL),
    log:
        in_run("logs/pretrain/vggt-nano.log"),
    benchmark:
        in_run("benchmarks/pretrain/vggt-nano.tsv")
    threads: workflow.cores
    params:
        frames=training_frames,
        settings=training_arguments(config["pretrain"]["geometry"]),
        work=in_run(layout.TRAINING).format(network="pretrain-vggt-nano"),
        code=code_hash("geoevs.geometry.finetuning"),
    shell:
        "geoevs --log {log:q} train-geometry {params.frames} {params.settings} --half"
        " --work {params.work:q} --out {output:q}"


rule pretrain:
    input:
        rules.pretrain_geometry.output,

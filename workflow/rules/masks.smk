# The artifact-mask library: validity masks at virtual poses of training scenes (section 3.4).


rule masks:
    input:
        scene=in_run(layout.SCENE),
        point_maps=in_run(layout.POINT_MAPS),
    output:
        in_run(layout.ARTIFACT_MASKS),
    log:
        in_run("logs/masks/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/masks/{dataset}/{scene}.tsv")
    params:
        poses=json.dumps(config["conditions"]["masks"]),
        code=code_hash("geoevs.conditions.artifact_masks"),
    shell:
        "geoevs --log {log:q} masks --scene {input.scene:q} --point-maps {input.point_maps:q}"
        " --poses {params.poses:q} --out {output:q}"


rule mask_library:
    input:
        every_scene(layout.ARTIFACT_MASKS, TRAINING_SCENES),
    output:
        in_run(layout.MASK_LIBRARY),
    log:
        in_run("logs/mask_library.log"),
    params:
        code=code_hash("geoevs.conditions.artifact_masks"),
    shell:
        "geoevs --log {log:q} mask-library {input:q} --out {output:q}"


rule mask_figure:
    input:
        every_scene(layout.TARGETS),
        every_scene(layout.REFERENCES),
        library=in_run(layout.MASK_LIBRARY),
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


rule conditions:
    input:
        every_scene(layout.PAIRS, TRAINING_SCENES),
        in_run(layout.MASK_LIBRARY),
        in_run(layout.MASK_FIGURE),

# Condition maps X and supervision Y of the training scenes' recorded views (paper section 3.2).


rule pairs:
    input:
        scene=in_run(layout.SCENE),
        point_maps=in_run(layout.POINT_MAPS),
    output:
        in_run(layout.PAIRS),
    log:
        in_run("logs/pairs/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/pairs/{dataset}/{scene}.tsv")
    params:
        code=code_hash("geoevs.conditions.pairs"),
    shell:
        "geoevs --log {log:q} pairs --scene {input.scene:q} --point-maps {input.point_maps:q}"
        " --out {output:q}"

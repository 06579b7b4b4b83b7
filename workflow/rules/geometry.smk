# Depth of every recorded view, by a depth model (paper section 3.2).


rule point_maps:
    input:
        scene=in_run(layout.SCENE),
    output:
        in_run(layout.POINT_MAPS),
    log:
        in_run("logs/point-maps/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/point-maps/{dataset}/{scene}.tsv")
    params:
        model=config["geometry"]["model"],
        code=code_hash("geoevs.geometry.point_maps"),
    shell:
        "geoevs --log {log:q} point-maps --scene {input.scene:q} --model {params.model:q}"
        " --out {output:q}"

# Scene stores, and the truth that no method may see (paper section 4.1).


rule scene:
    input:
        recorded(layout.SCENE, scene_made_with, "scene.json"),
    output:
        scene=directory(in_run(layout.SCENE)),
        depths=directory(in_run(layout.DEPTHS)),
    log:
        in_run("logs/scene/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/scene/{dataset}/{scene}.tsv")
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("scene"),
        runtime=minutes("scene"),
    params:
        scene=scene_arguments,
        data=scene_data,
        code=source_code("geoevs.projection.coloured_scenes"),
    shell:
        "geoevs --log {log:q} scene {params.scene} --data {params.data:q} --out {output.scene:q}"
        " --depths {output.depths:q}"


rule truth:
    input:
        targets=in_run(layout.TARGETS),
    output:
        directory(in_run(layout.TRUTH)),
    log:
        in_run("logs/truth/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/truth/{dataset}/{scene}.tsv")
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("truth"),
        runtime=minutes("truth"),
    params:
        scene=scene_arguments,
        data=scene_data,
        code=source_code("geoevs.protocol.truth"),
    shell:
        "geoevs --log {log:q} truth {params.scene} --targets {input.targets:q} --out {output:q}"

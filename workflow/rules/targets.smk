# The views to synthesise, the sparse references that score them, and the masks that degrade their
# conditions (paper sections 3.4, 3.5, 4.3).


rule targets:
    input:
        recorded(layout.TARGETS, targets_made_with),
        scene=in_run(layout.SCENE),
    output:
        in_run(layout.TARGETS),
    log:
        in_run("logs/targets/{dataset}/{scene}.log"),
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("references"),
        runtime=minutes("references"),
    params:
        protocol=json.dumps(
            {
                key: config["protocol"][key]
                for key in ("lateral", "every", "pose_sweep", "masked")
                if key in config["protocol"]
            }
        ),
        seed=config["seed"],
        code=code_hash("geoevs.protocol.targets"),
    shell:
        "geoevs --log {log:q} targets --scene {input.scene:q} --protocol {params.protocol:q}"
        " --seed {params.seed} --out {output:q}"


rule references:
    input:
        scene=in_run(layout.SCENE),
        targets=in_run(layout.TARGETS),
    output:
        references=in_run(layout.REFERENCES),
        masks=in_run(layout.MASKS),
    log:
        in_run("logs/references/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/references/{dataset}/{scene}.tsv")
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("references"),
        runtime=minutes("references"),
    params:
        seed=config["seed"],
        code=code_hash("geoevs.protocol.reference"),
    shell:
        "geoevs --log {log:q} references --scene {input.scene:q} --targets {input.targets:q}"
        " --seed {params.seed} --out {output.references:q} --masks {output.masks:q}"

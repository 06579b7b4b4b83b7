# Where methods break: graded stress, over seeds (paper section 4.7). Nothing here is timed, so jobs run
# side by side; one job does all levels and seeds of a stressor.


wildcard_constraints:
    stressor="|".join(STRESSORS),
    group="|".join(STABILITY_GROUPS),


# Its data sets have target lists of their own.
ruleorder: stability_targets > targets


rule stability_targets:
    input:
        recorded(layout.TARGETS, stability_targets_made_with),
        scene=in_run(layout.SCENE),
    output:
        in_run(layout.TARGETS),
    log:
        in_run("logs/targets/{dataset}/{scene}.log"),
    wildcard_constraints:
        dataset="|".join(STABILITY["datasets"]) or "(?!)",  # none: nothing matches
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("references"),
        runtime=minutes("references"),
    params:
        settings=lambda wildcards: json.dumps(
            clean_settings(STABILITY, wildcards.scene)
        ),
        code=code_hash("geoevs.protocol.stability"),
    shell:
        "geoevs --log {log:q} stability-targets --scene {input.scene:q}"
        " --settings {params.settings:q} --out {output:q}"


rule stress:
    input:
        scene=in_run(layout.SCENE),
    output:
        directory(in_run(layout.STRESSED)),
    log:
        in_run("logs/stress/{dataset}/{scene}/{stressor}/{level}.seed{draw}.log"),
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("references"),
        runtime=minutes("references"),
    params:
        code=code_hash("geoevs.protocol.stressors"),
    shell:
        "geoevs --log {log:q} stress {input.scene:q} --stressor {wildcards.stressor}"
        " --level {wildcards.level} --seed {wildcards.draw} --out {output:q}"


rule stability_render:
    input:
        scenes=given_scenes,
        targets=in_run(layout.TARGETS),
        masks=in_run(layout.MASKS),
        trained=trained,
    output:
        directory(in_run(layout.STABILITY_RENDERS)),
    log:
        in_run("logs/stability/{dataset}/{scene}/{group}/{label}.log"),
        method=in_run("logs/stability/{dataset}/{scene}/{group}/{label}.method.log"),
    benchmark:
        in_run("benchmarks/stability/{dataset}/{scene}/{group}/{label}.tsv")
    group:
        sent_as("stability")
    resources:
        mem_mb=memory("fit", tried=tried(layout.STABILITY_RENDERS, "*/outcome.json")),
        runtime=within("fit", "render"),
        gpu=GPU,
    params:
        entry=stability_arguments,
        options=lambda wildcards: method_options(STABILITY_ENTRIES, wildcards),
        attempt=attempt(layout.STABILITY_RENDERS, "*/outcome.json"),
        told=told("*/outcome.json"),
        code=method_code("stability"),
    shell:
        "geoevs --log {log[0]:q} stability-render {input.scenes:q} {params.entry}"
        " --options {params.options:q} --targets {input.targets:q} --masks {input.masks:q}"
        " --method-log {log.method:q} --attempt {params.told}"
        " --out {output:q}"


rule stability_score:
    input:
        stability_answers,
        in_run(layout.STABILITY_RENDERS),
    output:
        in_run(layout.STABILITY_PART),
    log:
        in_run("logs/stability-score/{dataset}/{scene}/{group}/{label}.log"),
    group:
        sent_as("stability")
    resources:
        mem_mb=memory("score"),
        runtime=minutes("score"),
    params:
        entry=stability_arguments,
        run=lambda wildcards, output: Path(output[0]).parents[5],
        seed=config["seed"],
        code=code_hash("geoevs.protocol.stability_scoring"),
    shell:
        "geoevs --log {log:q} stability-score --run {params.run:q}"
        " --dataset {wildcards.dataset:q} --scene {wildcards.scene:q} {params.entry}"
        " --run-seed {params.seed} --out {output:q}"


rule stability_scores:
    input:
        [
            path.format(group=group, label=label)
            for path in every_scene(
                layout.STABILITY_PART.replace("{group}", "{{group}}").replace(
                    "{label}", "{{label}}"
                ),
                STABILITY_SCENES,
            )
            for group in STABILITY_GROUPS
            for label in STABILITY_ENTRIES
        ],
    output:
        in_run(layout.STABILITY_SCORES),
    log:
        in_run("logs/stability-scores.log"),
    params:
        code=code_hash("geoevs.core.parquet"),
    shell:
        COLLECT


rule stability_tables:
    input:
        scores=in_run(layout.STABILITY_SCORES),
        entrants=in_run(layout.ENTRANTS),
    output:
        STABILITY_FILES,
    log:
        in_run("logs/stability-tables.log"),
    params:
        settings=json.dumps(config["tables"]),
        folder=lambda wildcards, output: Path(output[0]).parent,
        code=code_hash("geoevs.results.stability_page"),
    shell:
        "geoevs --log {log:q} stability-table --scores {input.scores:q}"
        " --settings {params.settings:q} --entrants {input.entrants:q} --out {params.folder:q}"


rule stability_chart:
    input:
        in_run(layout.STABILITY_TABLE),
    output:
        [
            in_run(layout.STABILITY_CHART) + suffix
            for suffix in (".csv", ".png", ".html")
        ],
    log:
        in_run("logs/stability-chart/{stressor}.log"),
    params:
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.stability_chart"),
    shell:
        "geoevs --log {log:q} stability-chart {wildcards.stressor} --table {input:q}"
        " --out {params.stem:q}"


rule stability:
    input:
        STABILITY_FILES,
        expand(
            in_run(layout.STABILITY_CHART) + "{suffix}",
            stressor=STABILITY_CURVES,
            suffix=(".csv", ".png", ".html"),
        ),

# From rows to what people read.

TABLE_FILES = [in_run(layout.TABLE) + suffix for suffix in (".csv", ".md", ".tex")]
ABLATION_FILES = [
    in_run(layout.ABLATION_TABLE) + suffix for suffix in (".csv", ".md", ".tex")
]
COST_FILES = [in_run(layout.COST_TABLE) + suffix for suffix in (".csv", ".md")]
GEOMETRY_FILES = [
    in_run(layout.GEOMETRY_TABLE) + suffix for suffix in (".csv", ".md", ".tex")
]
COMPLEXITY_FILES = [
    in_run(layout.COMPLEXITY_TABLE) + suffix for suffix in (".csv", ".md")
]
RANK_FILES = [in_run(layout.RANK_TABLE) + suffix for suffix in (".csv", ".md")]
# What figures and the report show: those that are dropped do not wait for them.
SHOWN_RENDERS = [] if DROPPED else every_result(layout.RENDERS)
BREAKDOWNS = ("pose_offset", "sparsity")


# Who plays, once for all tables: they import no method.
rule entrants:
    output:
        in_run(layout.ENTRANTS),
    log:
        in_run("logs/entrants.log"),
    params:
        options=entrant_options,
        code=entrant_code,
    shell:
        "geoevs --log {log:q} entrants --options {params.options:q} --out {output:q}"


rule table:
    input:
        scores=in_run(layout.SCORES),
        sets=in_run(layout.SET_SCORES),
        entrants=in_run(layout.ENTRANTS),
    output:
        TABLE_FILES,
    log:
        in_run("logs/table/{table}.log"),
    params:
        settings=json.dumps(config["tables"]),
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.formats"),
    shell:
        "geoevs --log {log:q} table {wildcards.table} --scores {input.scores:q}"
        " --sets {input.sets:q} --settings {params.settings:q} --entrants {input.entrants:q}"
        " --out {params.stem:q}"


rule cost_table:
    input:
        costs=in_run(layout.COSTS),
        entrants=in_run(layout.ENTRANTS),
    output:
        COST_FILES,
    log:
        in_run("logs/cost_table.log"),
    params:
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.costs"),
    shell:
        "geoevs --log {log:q} cost-table --costs {input.costs:q} --entrants {input.entrants:q}"
        " --out {params.stem:q}"


rule ablation_table:
    input:
        scores=in_run(layout.SCORES),
        entrants=in_run(layout.ENTRANTS),
    output:
        ABLATION_FILES,
    log:
        in_run("logs/ablation_table.log"),
    params:
        settings=json.dumps(config["tables"]),
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.ablation"),
    shell:
        "geoevs --log {log:q} ablation-table --scores {input.scores:q}"
        " --settings {params.settings:q} --entrants {input.entrants:q} --out {params.stem:q}"


rule geometry_table:
    input:
        in_run(layout.DEPTH_SCORES),
    output:
        GEOMETRY_FILES,
    log:
        in_run("logs/geometry_table.log"),
    params:
        settings=json.dumps(config["tables"]),
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.geometry_table"),
    shell:
        "geoevs --log {log:q} geometry-table --scores {input:q} --settings {params.settings:q}"
        " --out {params.stem:q}"


rule complexity_table:
    input:
        scores=in_run(layout.SCORES),
        costs=in_run(layout.COSTS),
        entrants=in_run(layout.ENTRANTS),
    output:
        COMPLEXITY_FILES,
    log:
        in_run("logs/complexity_table.log"),
    params:
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.complexity"),
    shell:
        "geoevs --log {log:q} complexity-table --scores {input.scores:q} --costs {input.costs:q}"
        " --entrants {input.entrants:q} --out {params.stem:q}"


rule rank_agreement:
    input:
        scores=in_run(layout.SCORES),
    output:
        RANK_FILES,
    log:
        in_run("logs/rank_agreement.log"),
    params:
        settings=json.dumps(config["tables"]),
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.rank_agreement"),
    shell:
        "geoevs --log {log:q} rank-agreement --scores {input.scores:q}"
        " --settings {params.settings:q} --out {params.stem:q}"


rule figure:
    input:
        SHOWN_RENDERS,
        every_scene(layout.SCENE),
        every_scene(layout.TARGETS),
        every_scene(layout.REFERENCES),
        every_scene(layout.MASKS),
        every_scene(layout.TRUTH),
    output:
        in_run(layout.FIGURE),
    log:
        in_run("logs/figure/{table}.log"),
    params:
        run=lambda wildcards, output: Path(output[0]).parents[1],
        scenes=scene_list(TEST_SCENES),
        labels=" ".join(
            f"--labels {label}"
            for label, entry in ENTRIES.items()
            if entry.method not in ORACLES and not DROPPED
        ),
        keeps=json.dumps(config["protocol"]["reference_keep"]),
        code=code_hash("geoevs.results.figures"),
    shell:
        "geoevs --log {log:q} grid {wildcards.table} --run {params.run:q} {params.scenes}"
        " {params.labels} --keeps {params.keeps:q} --out {output:q}"


rule breakdowns:
    input:
        expand(TABLE_FILES, table=BREAKDOWNS),


rule tables:
    input:
        expand(TABLE_FILES, table=TABLES),
        expand(in_run(layout.FIGURE), table=TABLES),
        ABLATION_FILES,
        COST_FILES,
        GEOMETRY_FILES,
        COMPLEXITY_FILES,
        RANK_FILES,
        in_run(layout.MANIFEST),

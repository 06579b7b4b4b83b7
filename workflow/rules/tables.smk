# From rows to what people read.

TABLE_FILES = [in_run(layout.TABLE) + suffix for suffix in (".csv", ".md", ".tex")]
BREAKDOWNS = ("pose_offset", "sparsity")


rule table:
    input:
        scores=in_run(layout.SCORES),
    output:
        TABLE_FILES,
    params:
        protocol=PROTOCOL,
        settings=json.dumps(config["tables"]),
        stem=in_run(layout.TABLE),
        code=code_hash("geoevs.results.tables", "geoevs.results.formats"),
    log:
        in_run("logs/table/{table}.log"),
    shell:
        "geoevs --log {log:q} table {wildcards.table} --scores {input.scores:q}"
        " --protocol {params.protocol:q} --settings {params.settings:q} --out {params.stem:q}"


rule figure:
    input:
        every_result(layout.RENDERS),
        every_scene(layout.REFERENCES),
        every_scene(layout.TRUTH),
    output:
        in_run(layout.FIGURE),
    params:
        run=RUN,
        scenes=" ".join(f"--scenes '{dataset}/{scene}'" for dataset, scene in TEST_SCENES),
        labels=" ".join(f"--labels {label}" for label in ENTRIES),
        keeps=json.dumps(config["protocol"]["reference_keep"]),
        code=code_hash("geoevs.results.figures"),
    log:
        in_run("logs/figure/{table}.log"),
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
        in_run(layout.COSTS),
        in_run(layout.MANIFEST),

# The metric on trial: what the sparse reference says, against dense truth.

AUDIT_TABLES = (
    "agreement",
    "support_bias",
    "reference_errors",
    "ceiling",
    "harm",
    "conditioning_gain",
)
AUDIT_FILES = [
    in_run(layout.AUDIT_PAGE),
    *(in_run(layout.AUDIT_TABLE).format(table=table) for table in AUDIT_TABLES),
    *(
        in_run(layout.AUDIT_CHART).format(chart=chart) + suffix
        for chart in ("agreement", "support_bias")
        for suffix in (".png", ".html")
    ),
]


rule audit_scene:
    input:
        scene=in_run(layout.SCENE),
        depths=in_run(layout.DEPTHS),
        targets=in_run(layout.TARGETS),
        references=in_run(layout.REFERENCES),
        truth=in_run(layout.TRUTH),
        renders=[in_run(layout.RENDERS).replace("{label}", label) for label in ENTRIES],
    output:
        in_run(layout.AUDIT_PART),
    log:
        in_run("logs/audit/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/audit/{dataset}/{scene}.tsv")
    resources:
        mem_mb=memory("score"),
        runtime=minutes("score"),
    params:
        run=lambda wildcards, output: Path(output[0]).parents[3],
        entrants=json.dumps(
            [[entry.method, entry.variant, entry.seed] for entry in ENTRIES.values()]
        ),
        seed=config["seed"],
        code=code_hash("geoevs.protocol.audit"),
    shell:
        "geoevs --log {log:q} audit-scene --run {params.run:q} --dataset {wildcards.dataset:q}"
        " --scene {wildcards.scene:q} --entrants {params.entrants:q} --seed {params.seed}"
        " --out {output:q}"


rule audit_rows:
    input:
        every_scene(layout.AUDIT_PART),
    output:
        in_run(layout.AUDIT_ROWS),
    log:
        in_run("logs/audit-rows.log"),
    params:
        code=code_hash("geoevs.core.parquet"),
    shell:
        COLLECT


rule audit_page:
    input:
        rows=in_run(layout.AUDIT_ROWS),
        entrants=in_run(layout.ENTRANTS),
    output:
        AUDIT_FILES,
    log:
        in_run("logs/audit-page.log"),
    params:
        settings=json.dumps(config["tables"]),
        folder=lambda wildcards, output: Path(output[0]).parent,
        code=code_hash("geoevs.results.audit_page"),
    shell:
        "geoevs --log {log:q} audit-page --rows {input.rows:q} --settings {params.settings:q}"
        " --entrants {input.entrants:q} --out {params.folder:q}"


rule audit:
    input:
        AUDIT_FILES,

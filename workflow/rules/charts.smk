# Speed against accuracy of every entrant, one page for every table; accuracy over size.

CHART_FILES = [in_run(layout.CHART) + suffix for suffix in (".csv", ".png", ".html")]
SIZE_FILES = [
    in_run(layout.COMPLEXITY_CHART) + suffix for suffix in (".csv", ".png", ".html")
]


rule chart:
    input:
        scores=in_run(layout.SCORES),
        costs=in_run(layout.COSTS),
        sets=in_run(layout.SET_SCORES),
        entrants=in_run(layout.ENTRANTS),
    output:
        CHART_FILES,
    log:
        in_run("logs/chart/{table}.log"),
    params:
        settings=json.dumps(config["tables"]),
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.chart_pages"),
    shell:
        "geoevs --log {log:q} chart {wildcards.table} --scores {input.scores:q}"
        " --costs {input.costs:q} --sets {input.sets:q} --settings {params.settings:q}"
        " --entrants {input.entrants:q} --out {params.stem:q}"


rule complexity_chart:
    input:
        scores=in_run(layout.SCORES),
        costs=in_run(layout.COSTS),
        entrants=in_run(layout.ENTRANTS),
    output:
        SIZE_FILES,
    log:
        in_run("logs/complexity_chart.log"),
    params:
        settings=json.dumps(config["tables"]),
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.complexity_chart"),
    shell:
        "geoevs --log {log:q} complexity-chart --scores {input.scores:q} --costs {input.costs:q}"
        " --settings {params.settings:q} --entrants {input.entrants:q} --out {params.stem:q}"


rule charts:
    input:
        expand(CHART_FILES, table=TABLES),
        SIZE_FILES,

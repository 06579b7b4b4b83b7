# Speed against accuracy of every entrant, one page for every table.

CHART_FILES = [in_run(layout.CHART) + suffix for suffix in (".csv", ".png", ".html")]


rule chart:
    input:
        scores=in_run(layout.SCORES),
        costs=in_run(layout.COSTS),
    output:
        CHART_FILES,
    log:
        in_run("logs/chart/{table}.log"),
    params:
        settings=json.dumps(config["tables"]),
        stem=in_run(layout.CHART),
        code=code_hash("geoevs.results.chart_pages"),
    shell:
        "geoevs --log {log:q} chart {wildcards.table} --scores {input.scores:q}"
        " --costs {input.costs:q} --settings {params.settings:q} --out {params.stem:q}"


rule charts:
    input:
        expand(CHART_FILES, table=TABLES),

# Speed against accuracy of every entrant.

CHART_FILES = [in_run(layout.CHART) + suffix for suffix in (".csv", ".png", ".html")]


rule chart:
    input:
        scores=in_run(layout.SCORES),
        costs=in_run(layout.COSTS),
    output:
        CHART_FILES,
    log:
        in_run("logs/chart.log"),
    params:
        settings=json.dumps(config["tables"]),
        stem=lambda wildcards, output: Path(output[0]).with_suffix(""),
        code=code_hash("geoevs.results.charts"),
    shell:
        "geoevs --log {log:q} chart --scores {input.scores:q} --costs {input.costs:q}"
        " --settings {params.settings:q} --out {params.stem:q}"


rule charts:
    input:
        CHART_FILES,

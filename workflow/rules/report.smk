# One page that shows the whole run and opens without a network.


rule report:
    input:
        rules.tables.input,
        rules.charts.input,
        SHOWN_RENDERS,
        every_scene(layout.SCENE),
        every_scene(layout.TARGETS),
        every_scene(layout.REFERENCES),
        every_scene(layout.MASKS),
        every_scene(layout.TRUTH),
        scores=in_run(layout.SCORES),
        costs=in_run(layout.COSTS),
        suites=suite_results,
        sets=in_run(layout.SET_SCORES),
        entrants=in_run(layout.ENTRANTS),
        manifest=in_run(layout.MANIFEST),
    output:
        in_run(layout.REPORT),
    log:
        in_run("logs/report.log"),
    threads: workflow.cores
    params:
        run=lambda wildcards, output: Path(output[0]).parent,
        others=lambda wildcards: other_results(
            {
                *rules.tables.input,
                *rules.charts.input,
                in_run(layout.MASK_FIGURE),
                *suite_results(wildcards),
            }
        ),
        code=code_hash("geoevs.results.report.page"),
    shell:
        "geoevs --log {log:q} report --run {params.run:q} --threads {threads} --out {output:q}"

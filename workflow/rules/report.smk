# One page that shows the whole run and opens without a network.


def other_results():
    """Which results lie in the run besides those that the report always waits for, and how new."""
    folders = [
        path
        for path in Path(RUN).glob("[!.]*/")
        if path.is_dir() and path.name not in layout.DATA_FOLDERS
    ]
    files = [
        file
        for folder in folders
        for suffix in ("csv", "png", "html")
        for file in folder.glob(f"*.{suffix}")
    ]
    waited_for = {*rules.tables.input, *rules.charts.input}
    return {
        str(file): hash_path(file)
        for file in sorted(files)
        if str(file) not in waited_for
    }


rule report:
    input:
        rules.tables.input,
        rules.charts.input,
        every_result(layout.RENDERS),
        every_scene(layout.REFERENCES),
        every_scene(layout.MASKS),
        every_scene(layout.TRUTH),
        scores=in_run(layout.SCORES),
        costs=in_run(layout.COSTS),
        sets=in_run(layout.SET_SCORES),
        manifest=in_run(layout.MANIFEST),
    output:
        in_run(layout.REPORT),
    log:
        in_run("logs/report.log"),
    params:
        run=RUN,
        others=lambda wildcards: other_results(),
        code=code_hash("geoevs.results.report.page"),
    shell:
        "geoevs --log {log:q} report --run {params.run:q} --out {output:q}"

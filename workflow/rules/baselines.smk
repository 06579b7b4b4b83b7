# Fits and renders of every entrant. Both are timed, so each takes all cores and runs alone. What a
# method does wrong is in what they write; so is a fault of the machine, which has a second attempt.

# Whether pictures are deleted when nobody in this call needs them any more.
DROPPED = config.get("renders", "keep") == "drop"
RENDERED = directory(in_run(layout.RENDERS))
RENDERED = temp(RENDERED) if DROPPED else RENDERED


rule fit:
    input:
        recorded(layout.MODEL, fit_made_with, "fit.json"),
        scene=in_run(layout.SCENE),
        targets=in_run(layout.TARGETS),
        trained=trained,
    output:
        directory(in_run(layout.MODEL)),
    log:
        in_run(layout.FIT_LOG),
        method=in_run("logs/fit/{dataset}/{scene}/{label}.method.log"),
    benchmark:
        in_run("benchmarks/fit/{dataset}/{scene}/{label}.tsv")
    group:
        sent_as("entrant")
    threads: workflow.cores
    resources:
        mem_mb=memory("fit", tried=tried(layout.MODEL, "fit.json")),
        runtime=within("fit", "fit"),
        gpu=GPU,
    params:
        entry=entry_arguments,
        settings=fit_arguments,
        outside=lambda wildcards: outside_files(**wildcards),
        attempt=attempt(layout.MODEL, "fit.json"),
        told=told("fit.json"),
        code=method_code("fit"),
    shell:
        "geoevs --log {log[0]:q} fit {params.entry} {params.settings} --scene {input.scene:q}"
        " --targets {input.targets:q} --threads {threads} --method-log {log.method:q}"
        " --attempt {params.told} --out {output:q}"


rule render:
    input:
        unpack(oracle_answers),
        model=in_run(layout.MODEL),
        targets=in_run(layout.TARGETS),
        masks=in_run(layout.MASKS),
    output:
        RENDERED,
    log:
        in_run(layout.RENDER_LOG),
        method=in_run("logs/render/{dataset}/{scene}/{label}.method.log"),
    benchmark:
        in_run("benchmarks/render/{dataset}/{scene}/{label}.tsv")
    group:
        sent_as("entrant")
    threads: workflow.cores
    resources:
        mem_mb=memory("fit", tried=tried(layout.RENDERS, "render.json")),
        runtime=within("render", "render"),
        gpu=GPU,
    params:
        method=lambda wildcards: ENTRIES[wildcards.label].method,
        answers=oracle_arguments,
        outside=lambda wildcards: outside_files(**wildcards),
        attempt=attempt(layout.RENDERS, "render.json"),
        told=told("render.json"),
        code=method_code("render"),
    shell:
        "geoevs --log {log[0]:q} render --method {params.method} --model {input.model:q}"
        " --targets {input.targets:q} --masks {input.masks:q} {params.answers}"
        " --method-log {log.method:q} --attempt {params.told}"
        " --out {output:q}"

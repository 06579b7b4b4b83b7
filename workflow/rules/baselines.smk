# Fits and renders of every entrant. Both are timed, so each takes all cores and runs alone.


def budget_arguments(wildcards):
    """The budget of a fit, and the options it is made with."""
    seconds = config["budget"]["fit_seconds"]
    limit = "" if seconds is None else f"--fit-seconds {seconds}"
    return f"--options '{json.dumps(ENTRIES[wildcards.label].options)}' {limit}"


def evidence(wildcards):
    """What the reference control, and it alone, may look at."""
    if ENTRIES[wildcards.label].method != REFERENCE:
        return {}
    return {
        "scene": in_run(layout.SCENE),
        "references": in_run(layout.REFERENCES),
        "truth": in_run(layout.TRUTH),
    }


def evidence_arguments(wildcards, input):
    """The same as arguments."""
    return " ".join(f"--{name} '{input[name]}'" for name in evidence(wildcards))


rule fit:
    input:
        scene=in_run(layout.SCENE),
        targets=in_run(layout.TARGETS),
    output:
        directory(in_run(layout.MODEL)),
    params:
        entry=entry_arguments,
        budget=budget_arguments,
        code=method_code("fit"),
    threads: workflow.cores
    log:
        in_run("logs/fit/{dataset}/{scene}/{label}.log"),
        method=in_run("logs/fit/{dataset}/{scene}/{label}.method.log"),
    benchmark:
        in_run("benchmarks/fit/{dataset}/{scene}/{label}.tsv")
    shell:
        "geoevs --log {log[0]:q} fit {params.entry} {params.budget} --scene {input.scene:q}"
        " --targets {input.targets:q} --threads {threads} --method-log {log.method:q}"
        " --out {output:q}"


rule render:
    input:
        unpack(evidence),
        model=in_run(layout.MODEL),
        targets=in_run(layout.TARGETS),
    output:
        directory(in_run(layout.RENDERS)),
    params:
        method=lambda wildcards: ENTRIES[wildcards.label].method,
        evidence=evidence_arguments,
        code=method_code("render"),
    threads: workflow.cores
    log:
        in_run("logs/render/{dataset}/{scene}/{label}.log"),
        method=in_run("logs/render/{dataset}/{scene}/{label}.method.log"),
    benchmark:
        in_run("benchmarks/render/{dataset}/{scene}/{label}.tsv")
    shell:
        "geoevs --log {log[0]:q} render --method {params.method} --model {input.model:q}"
        " --targets {input.targets:q} {params.evidence} --method-log {log.method:q}"
        " --out {output:q}"

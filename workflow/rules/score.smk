# One score row for every target and metric, one cost row for every fit (paper section 3.5).


rule score:
    input:
        scene=in_run(layout.SCENE),
        targets=in_run(layout.TARGETS),
        references=in_run(layout.REFERENCES),
        truth=in_run(layout.TRUTH),
        masks=in_run(layout.MASKS),
        renders=in_run(layout.RENDERS),
    output:
        scores=in_run(layout.SCORE_PART),
        costs=in_run(layout.COST_PART),
    log:
        in_run("logs/score/{dataset}/{scene}/{label}.log"),
    benchmark:
        in_run("benchmarks/score/{dataset}/{scene}/{label}.tsv")
    group:
        sent_as("entrant")
    resources:
        mem_mb=memory("score"),
        runtime=minutes("score"),
    params:
        entry=entry_arguments,
        run=lambda wildcards, output: Path(output.scores).parents[3],
        protocol=PROTOCOL,
        seed=config["seed"],
        renders=renders_code,
        code=code_hash("geoevs.protocol.scoring", "geoevs.protocol.rows"),
    shell:
        "geoevs --log {log:q} score {params.entry} --run {params.run:q} --dataset {wildcards.dataset:q}"
        " --scene {wildcards.scene:q} --protocol {params.protocol:q} --run-seed {params.seed}"
        " --out {output.scores:q}"
        " --costs {output.costs:q}"


rule scores:
    input:
        every_result(layout.SCORE_PART),
        every_entrant(layout.LEARNED_PART),
    output:
        in_run(layout.SCORES),
    log:
        in_run("logs/scores.log"),
    params:
        code=code_hash("geoevs.core.parquet"),
    shell:
        COLLECT


rule costs:
    input:
        every_result(layout.COST_PART),
    output:
        in_run(layout.COSTS),
    log:
        in_run("logs/costs.log"),
    params:
        code=code_hash("geoevs.core.parquet"),
    shell:
        COLLECT


# What a network sees in true pictures: of every entrant's distances from them, the same half.
rule truth_features:
    input:
        scene=in_run(layout.SCENE),
        targets=in_run(layout.TARGETS),
        truth=in_run(layout.TRUTH),
    output:
        temp(directory(in_run(layout.TRUTH_FEATURES))),
    log:
        in_run("logs/truth_features/{dataset}/{scene}.log"),
    benchmark:
        in_run("benchmarks/truth_features/{dataset}/{scene}.tsv")
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("features"),
        runtime=minutes("features"),
    params:
        run=lambda wildcards, output: Path(output[0]).parents[2],
        code=code_hash("geoevs.protocol.set_scoring"),
    shell:
        "geoevs --log {log:q} truth-features --run {params.run:q} --dataset {wildcards.dataset:q}"
        " --scene {wildcards.scene:q} --out {output:q}"


# Distances between all of an entrant's views of a data set and the truth, and of each view what
# shares their features.
rule score_sets:
    input:
        scenes=lambda wildcards: of_dataset(layout.SCENE, wildcards.dataset),
        targets=lambda wildcards: of_dataset(layout.TARGETS, wildcards.dataset),
        references=lambda wildcards: of_dataset(layout.REFERENCES, wildcards.dataset),
        truth=lambda wildcards: of_dataset(layout.TRUTH, wildcards.dataset),
        features=lambda wildcards: of_dataset(layout.TRUTH_FEATURES, wildcards.dataset),
        renders=lambda wildcards: of_dataset(layout.RENDERS, wildcards.dataset),
    output:
        sets=in_run(layout.SET_SCORE_PART),
        views=in_run(layout.LEARNED_PART),
    log:
        in_run("logs/score_sets/{dataset}/{label}.log"),
    benchmark:
        in_run("benchmarks/score_sets/{dataset}/{label}.tsv")
    resources:
        mem_mb=memory("features", scenes_of_dataset),
        runtime=minutes("features", scenes_of_dataset),
    params:
        entry=entry_arguments,
        run=lambda wildcards, output: Path(output.sets).parents[2],
        scenes=lambda wildcards, input: with_option(
            "--scenes", [Path(path).name for path in input.scenes]
        ),
        confidence=config["tables"]["confidence"],
        protocol=PROTOCOL,
        renders=renders_code,
        code=code_hash("geoevs.protocol.set_scoring"),
    shell:
        "geoevs --log {log:q} score-sets {params.entry} --run {params.run:q}"
        " --dataset {wildcards.dataset:q} {params.scenes} --confidence {params.confidence}"
        " --protocol {params.protocol:q} --out {output.sets:q} --views {output.views:q}"


rule set_scores:
    input:
        every_entrant(layout.SET_SCORE_PART),
    output:
        in_run(layout.SET_SCORES),
    log:
        in_run("logs/set_scores.log"),
    params:
        code=code_hash("geoevs.core.parquet"),
    shell:
        COLLECT


# Stores are large: each is read once, and not again when another one changes.
rule scene_hash:
    input:
        in_run(layout.SCENE),
    output:
        in_run(layout.SCENE_HASH),
    log:
        in_run("logs/scene_hash/{dataset}/{scene}.log"),
    group:
        sent_as("scene")
    params:
        code=code_hash("geoevs.core.hashes"),
    shell:
        "geoevs --log {log:q} hash {input:q} --out {output:q}"


rule manifest:
    input:
        scores=in_run(layout.SCORES),
        hashed=every_scene(layout.SCENE_HASH),
    output:
        in_run(layout.MANIFEST),
    log:
        in_run("logs/manifest.log"),
    params:
        weights=starting_weights,
        hashed=lambda wildcards, input: with_option("--hashed", input.hashed),
        config=json.dumps(config),
        configfiles=with_option("--configfiles", config_files()),
        code=code_hash("geoevs.results.manifest"),
    shell:
        "geoevs --log {log:q} manifest {input.scores:q} {params.weights:q} {params.hashed}"
        " --config {params.config:q} {params.configfiles} --out {output:q}"

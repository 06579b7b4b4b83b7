# Whether generated views help a detector (paper section 4.6), and how far it can be trusted on them.
# Boxes are the labels: methods are given stores without any. Nothing here is timed alone, so jobs run
# side by side.


wildcard_constraints:
    setting="|".join(map(re.escape, SETTINGS)),


rule detection_targets:
    input:
        recorded(layout.DETECTION_TARGETS, detection_targets_made_with),
        scene=in_run(layout.SCENE),
    output:
        targets=in_run(layout.DETECTION_TARGETS),
        given=directory(in_run(layout.DETECTION_GIVEN)),
    log:
        in_run("logs/detection/targets/{dataset}/{scene}.log"),
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("references"),
        runtime=minutes("references"),
    params:
        settings=detection_section("views", "offsets"),
        moved=moved_too,
        code=code_hash("geoevs.detection.views"),
    shell:
        "geoevs --log {log:q} detection-targets --scene {input.scene:q}"
        " --settings {params.settings:q} {params.moved} --given {output.given:q}"
        " --out {output.targets:q}"


rule detection_labels:
    input:
        scene=in_run(layout.SCENE),
    output:
        in_run(layout.DETECTION_LABELS),
    log:
        in_run("logs/detection/labels/{dataset}/{scene}.log"),
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("references"),
        runtime=minutes("references"),
    params:
        settings=detection_section("classes", "detector"),
        code=code_hash("geoevs.detection.labels", "geoevs.detection.settings"),
    shell:
        "geoevs --log {log:q} detection-labels --scene {input.scene:q}"
        " --name {wildcards.dataset:q}/{wildcards.scene:q} --settings {params.settings:q}"
        " --out {output:q}"


rule detection_truth:
    input:
        targets=in_run(layout.DETECTION_TARGETS),
    output:
        directory(in_run(layout.DETECTION_TRUTH)),
    log:
        in_run("logs/detection/truth/{dataset}/{scene}.log"),
    group:
        sent_as("scene")
    resources:
        mem_mb=memory("truth"),
        runtime=minutes("truth"),
    params:
        scene=scene_arguments,
        data=scene_data,
        code=source_code("geoevs.protocol.truth"),
    shell:
        "geoevs --log {log:q} truth {params.scene} --targets {input.targets:q} --out {output:q}"


rule detection_views:
    input:
        scene=in_run(layout.DETECTION_GIVEN),
        targets=in_run(layout.DETECTION_TARGETS),
        trained=trained,
    output:
        model=directory(in_run(layout.DETECTION_MODEL)),
        views=directory(in_run(layout.DETECTION_VIEWS)),
    log:
        in_run("logs/detection/views/{dataset}/{scene}/{label}.log"),
        fit=in_run("logs/detection/views/{dataset}/{scene}/{label}.fit.log"),
        render=in_run("logs/detection/views/{dataset}/{scene}/{label}.render.log"),
    group:
        sent_as("entrant")
    resources:
        mem_mb=memory("fit", tried=tried(layout.DETECTION_VIEWS, "render.json")),
        runtime=within("fit", "render"),
        gpu=GPU,
    params:
        entry=entry_arguments,
        options=lambda wildcards: method_options(DETECTION_ENTRIES, wildcards),
        outside=lambda wildcards: outside_files(**wildcards),
        attempt=attempt(layout.DETECTION_VIEWS, "render.json"),
        told=lambda wildcards, output: attempt_of(output.views, ["render.json"]),
        code=lambda wildcards: [
            method_code(step)(wildcards) for step in ("fit", "render")
        ],
    shell:
        "geoevs --log {log[0]:q} detection-views {params.entry} --options {params.options:q}"
        " --scene {input.scene:q} --targets {input.targets:q} --model {output.model:q}"
        " --fit-log {log.fit:q} --render-log {log.render:q} --attempt {params.told}"
        " --out {output.views:q}"


rule detection_backbone:
    input:
        of_detection(layout.SCENE, DETECTION_TRAIN),
        of_detection(layout.DETECTION_LABELS, DETECTION_TRAIN),
    output:
        directory(in_run(layout.DETECTION_BACKBONE)),
    log:
        in_run("logs/detection/backbone.seed{seed}.log"),
    benchmark:
        in_run("benchmarks/detection/backbone.seed{seed}.tsv")
    resources:
        mem_mb=memory("train", detection_scenes),
        runtime=within("training"),
        gpu=GPU,
    params:
        run=run_of(layout.DETECTION_BACKBONE),
        scenes=scene_list(DETECTION_TRAIN),
        settings=detection_section("detector", "training"),
        weights=WEIGHTS_FOLDER,
        starts_from=backbone_hash,
        work=in_run(layout.TRAINING).format(network="detection/backbone.seed{seed}"),
        code=code_hash("geoevs.detection.detectors"),
    shell:
        "geoevs --log {log:q} detection-backbone --run {params.run:q} {params.scenes}"
        " --settings {params.settings:q} --seed {wildcards.seed} --weights {params.weights:q}"
        " --work {params.work:q} --out {output:q}"


rule detection_train:
    input:
        lambda wildcards: shown_to([views_label(wildcards.setting)], DETECTION_TRAIN),
        backbone=in_run(layout.DETECTION_BACKBONE),
    output:
        directory(in_run(layout.DETECTOR)),
    log:
        in_run("logs/detection/train/{setting}.seed{seed}.log"),
    benchmark:
        in_run("benchmarks/detection/train/{setting}.seed{seed}.tsv")
    resources:
        mem_mb=memory("train", detection_scenes),
        runtime=within("training"),
        gpu=GPU,
    params:
        run=run_of(layout.DETECTOR),
        scenes=scene_list(DETECTION_TRAIN),
        settings=detection_section("detector", "training", "longer"),
        work=in_run(layout.TRAINING).format(network="detection/{setting}.seed{seed}"),
        code=code_hash("geoevs.detection.detectors"),
    shell:
        "geoevs --log {log:q} detection-train --run {params.run:q} {params.scenes}"
        " --setting {wildcards.setting:q} --settings {params.settings:q} --seed {wildcards.seed}"
        " --work {params.work:q} --out {output:q}"


rule detection_find:
    input:
        shown_to(DETECTION_ENTRIES, DETECTION_TEST),
        lambda wildcards: [
            in_run(layout.DETECTOR).format(setting=setting, seed=wildcards.seed)
            for setting in SETTINGS
        ],
    output:
        found=directory(in_run(layout.PREDICTIONS)),
        counts=in_run(layout.DETECTION_COUNT_PART),
    log:
        in_run("logs/detection/find/seed{seed}.log"),
    resources:
        mem_mb=memory("train", detection_scenes),
        runtime=within("render"),
        gpu=GPU,
    params:
        run=run_of(layout.PREDICTIONS),
        scenes=scene_list(DETECTION_TEST),
        labels=DETECTION_LABELS_OF,
        code=code_hash("geoevs.detection.detectors", "geoevs.detection.setting_counts"),
    shell:
        "geoevs --log {log:q} detection-find --run {params.run:q} {params.scenes}"
        " --labels {params.labels:q} --seed {wildcards.seed} --counts {output.counts:q}"
        " --out {output.found:q}"


rule detection_counts:
    input:
        expand(in_run(layout.DETECTION_COUNT_PART), seed=DETECTION_SEEDS),
    output:
        in_run(layout.DETECTION_COUNTS),
    log:
        in_run("logs/detection/counts.log"),
    params:
        code=code_hash("geoevs.core.parquet"),
    shell:
        COLLECT


rule task_offsets:
    input:
        shown_to(DETECTION_ENTRIES, DETECTION_TEST),
        expand(in_run(layout.DETECTOR), setting=NATIVE, seed=DETECTION_SEEDS),
    output:
        in_run(layout.TASK_ROWS),
    log:
        in_run("logs/detection/offsets.log"),
    resources:
        mem_mb=memory("train", detection_scenes),
        runtime=within("render"),
        gpu=GPU,
    params:
        run=run_of(layout.TASK_ROWS),
        scenes=scene_list(DETECTION_TEST),
        labels=DETECTION_LABELS_OF,
        seeds=with_option("--seeds", DETECTION_SEEDS),
        settings=detection_section("offsets"),
        code=code_hash("geoevs.detection.detectors", "geoevs.detection.task_rows"),
    shell:
        "geoevs --log {log:q} task-offsets --run {params.run:q} {params.scenes}"
        " --labels {params.labels:q} --settings {params.settings:q} {params.seeds}"
        " --out {output:q}"


rule detection_tables:
    input:
        expand(in_run(layout.PREDICTIONS), seed=DETECTION_SEEDS),
        counts=in_run(layout.DETECTION_COUNTS),
        offsets=in_run(layout.TASK_ROWS),
        entrants=in_run(layout.ENTRANTS),
    output:
        DETECTION_FILES,
    log:
        in_run("logs/detection/tables.log"),
    params:
        run=lambda wildcards, input: Path(input.counts).parents[1],
        settings=json.dumps(config["tables"]),
        labels=DETECTION_LABELS_OF,
        seeds=with_option("--seeds", DETECTION_SEEDS),
        code=code_hash(
            "geoevs.results.detection_page",
            "geoevs.results.detection_chart",
            "geoevs.results.task_offsets",
        ),
    shell:
        "geoevs --log {log:q} detection-tables --run {params.run:q} --settings {params.settings:q}"
        " --labels {params.labels:q} {params.seeds} --entrants {input.entrants:q}"


rule detection_figure:
    input:
        of_detection(layout.SCENE, DETECTION_TEST[:1]),
        of_detection(layout.DETECTION_LABELS, DETECTION_TEST[:1]),
        expand(in_run(layout.PREDICTIONS), seed=DETECTION_SEEDS[:1]),
    output:
        in_run(layout.DETECTION_FIGURE),
    log:
        in_run("logs/detection/figure.log"),
    params:
        run=lambda wildcards, output: Path(output[0]).parents[1],
        scene=scene_list(DETECTION_TEST[:1]),
        settings=detection_section("detector"),
        labels=DETECTION_LABELS_OF,
        seed=DETECTION_SEEDS[0],
        code=code_hash("geoevs.results.detection_figure"),
    shell:
        "geoevs --log {log:q} detection-figure --run {params.run:q} {params.scene}"
        " --settings {params.settings:q} --labels {params.labels:q} --seed {params.seed}"
        " --out {output:q}"


rule detection:
    input:
        DETECTION_FILES if DETECTION_TEST else [],
        [in_run(layout.DETECTION_FIGURE)] if DETECTION_TEST else [],

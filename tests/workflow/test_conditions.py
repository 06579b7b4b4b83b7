"""What trains comes from training scenes, and from them alone."""

import re

from geoevs.core.files import read_json

OTHER = """\
datasets:
  street-train: {partitions: {validation: [straight-701], geometry: [straight-702]}}
  other:
    source: street
    options: {frames: 2}
    partitions: {train: [curve-601], test: [curve-602]}
"""


def test_pairs_and_masks_are_of_every_data_sets_training_scenes(workspace):
    (workspace.folder / "other.yaml").write_text(OTHER)
    plan = workspace.snakemake(*workspace.SMOKE, "other.yaml", "-n", "--", "conditions")
    assert plan.returncode == 0, plan.stderr[-3000:]
    text = plan.stdout + plan.stderr
    for rule, folder in (
        ("pairs", "pairs"),
        ("masks", "artifact-masks"),
        ("point_maps", "point-m"),
    ):
        outputs = re.findall(rf"rule {rule}:\n.*\n +output: results/smoke/{folder}\S*?/(\S+)", text)
        assert sorted(outputs) == ["other/curve-601.npz", "street-train/straight-301.npz"]
    scenes = re.findall(r"rule scene:\n +output: results/smoke/scenes/(\S+),", text)
    # The picture alone looks at the test scene; geometry is learned apart.
    assert sorted(scenes) == [
        *("other/curve-601", "street-train/straight-301", "street-train/straight-702"),
        "street/junction-201",
    ]


def test_a_training_that_lacked_its_prior_runs_again_once_that_is_there(workspace):
    (workspace.folder / "prior.yaml").write_text(
        "freevs: {prior: downloaded}\nresolution: [16, 24]\n"
        "datasets: {street-clips: {options: {frames: 3, samples: 1}}}\n"
    )
    trained = "results/smoke/trained/freevs.seed0"
    arguments = (*workspace.SMOKE, "prior.yaml", "--", trained)
    run = workspace.snakemake(*arguments)
    assert run.returncode == 0, run.stderr[-3000:]
    reason = read_json(workspace.folder / trained / "failure.json")["reason"]
    assert reason.startswith("prior 'downloaded' is not on this machine")
    plan = workspace.snakemake("-n", *arguments)
    assert "Nothing to be done" in plan.stdout + plan.stderr
    (workspace.folder / "downloaded").mkdir()
    plan = workspace.snakemake("-n", *arguments)
    assert "rule train_freevs:" in plan.stdout + plan.stderr
    assert "rule clips:" not in plan.stdout + plan.stderr


def test_a_run_without_training_scenes_says_what_to_name(workspace):
    (workspace.folder / "none.yaml").write_text(
        "datasets: {street-train: {partitions: {train: []}}}\n"
        "methods: {geo-evs: null, geo-evs.v1: null, geo-evs-support: null}\n"
    )
    library = "results/smoke/artifact-masks/library.npz"
    run = workspace.snakemake(*workspace.SMOKE, "none.yaml", "--", library)
    assert run.returncode != 0
    sentence = "holds no masks; name training scenes under partitions.train of a data set"
    assert f"error: the mask library {sentence}" in run.stderr

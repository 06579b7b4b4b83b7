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
    for rule, folder in (("prepare", "prepared/geo-evs"), ("point_maps", "point-maps")):
        outputs = re.findall(rf"rule {rule}:\n.*\n +output: results/smoke/{folder}/(\S+)", text)
        assert sorted(outputs) == ["other/curve-601.npz", "street-train/straight-301.npz"]
    scenes = re.findall(r"rule scene:\n +output: results/smoke/scenes/(\S+),", text)
    # The picture alone looks at the test scene; geometry is learned apart.
    assert sorted(scenes) == [
        *("other/curve-601", "street-clips/straight-501", "street-train/straight-301"),
        *("street-train/straight-702", "street/junction-201"),
    ]


def test_a_training_that_lacked_its_prior_runs_again_once_that_is_there(workspace):
    (workspace.folder / "prior.yaml").write_text(
        "trainings: {freevs: {prior: downloaded}}\nresolution: [16, 24]\n"
        "datasets: {street-clips: {options: {frames: 3, samples: 1}}}\n"
    )
    trained = "results/smoke/trained/freevs/default.seed0"
    arguments = (*workspace.SMOKE, "prior.yaml", "--", trained)
    run = workspace.snakemake(*arguments)
    assert run.returncode == 0, run.stderr[-3000:]
    reason = read_json(workspace.folder / trained / "failure.json")["reason"]
    assert reason.startswith("prior 'downloaded' is not on this machine")
    plan = workspace.snakemake("-n", *arguments)
    assert "Nothing to be done" in plan.stdout + plan.stderr
    (workspace.folder / "downloaded").mkdir()
    plan = workspace.snakemake("-n", *arguments)
    assert "rule train:" in plan.stdout + plan.stderr
    assert "rule prepare:" not in plan.stdout + plan.stderr

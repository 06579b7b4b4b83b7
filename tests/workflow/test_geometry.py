"""VGGT in the DAG: fine-tuned on its own scenes, scored before and after, pretrained apart."""

import re
from dataclasses import replace

import numpy as np

from geoevs.core.files import read_json
from geoevs.core.hashes import hash_path
from geoevs.diffusion.prior import load_prior
from geoevs.geometry.refinement import NANO_CHANNELS
from geoevs.geometry.vggt import VGGT_NANO, load_vggt


def rules(plan) -> list[str]:
    assert plan.returncode == 0, plan.stderr[-3000:]
    return re.findall(r"^rule (\w+):$", plan.stdout + plan.stderr, re.MULTILINE)


def plan(workspace, overlay, *arguments):
    (workspace.folder / "overlay.yaml").write_text(overlay)
    return workspace.snakemake(*workspace.SMOKE, "overlay.yaml", "-n", *arguments)


def test_point_maps_come_from_the_fine_tuned_network(workspace):
    maps = "results/smoke/point-maps/street-train/straight-301.npz"
    made = plan(workspace, "{}\n", "-p", "--", maps)
    assert rules(made).count("finetune_geometry") == 1
    text = made.stdout + made.stderr
    scenes = re.findall(r"rule scene:\n +output: results/smoke/scenes/(\S+),", text)
    assert sorted(scenes) == ["street-train/curve-402", "street-train/straight-301"]
    assert "--start weights/vggt-nano.safetensors" in text
    assert "--depths results/smoke/depths/street-train/curve-402" in text
    assert "--model vggt-nano --weights results/smoke/geometry/vggt.safetensors" in text


def test_as_pretrained_it_is_read_from_where_it_lies(workspace):
    other = "geometry: {model: vggt-1b, weights: public.pt, finetune: null}\n"
    made = plan(workspace, other, "-p", "--", "tables", "conditions")
    assert "finetune_geometry" not in rules(made)
    text = made.stdout + made.stderr
    assert "--model vggt-1b --weights public.pt" in text
    assert "--pretrained public.pt" in text
    assert "--finetuned" not in text


def test_lidar_supervision_sees_no_truth(workspace):
    overlay = "geometry: {supervision: lidar}\n"
    text = plan(workspace, overlay, "-p", "--", "results/smoke/geometry/vggt.safetensors").stdout
    (command,) = re.findall(r"geoevs .* train-geometry .*", text)
    assert "--scenes results/smoke/scenes/street-train/curve-402" in command
    assert "--depths" not in command


def test_lidar_needs_no_network(workspace):
    overlay = "geometry: {model: lidar}\n"
    made = plan(workspace, overlay, "-p", "--", "tables", "conditions")
    assert "finetune_geometry" not in rules(made)
    text = made.stdout + made.stderr
    assert "--model lidar" in text
    assert "--pretrained" not in text
    assert "--geometry-weights" not in text
    assert not re.search(r"point-maps .* --weights", text)


def test_missing_weights_are_one_sentence(workspace):
    (workspace.folder / "none.yaml").write_text(
        "weights: nowhere\ngeometry: {supervision: lidar}\ndatasets: {street-train: "
        "{options: {frames: 1, samples: 1}}}\nresolution: [16, 24]\n"
    )
    weights = "results/smoke/geometry/vggt.safetensors"
    run = workspace.snakemake(*workspace.SMOKE, "none.yaml", "--", weights)
    assert run.returncode != 0
    assert "error: nowhere/vggt-nano.safetensors is missing; make or copy it there" in run.stderr


def test_pretraining_is_apart_from_the_tables(workspace):
    everything = plan(workspace, "{}\n", "--", "all", "tables", "breakdowns", "conditions")
    assert not [rule for rule in rules(everything) if "pretrain" in rule]
    assert "straight-1001" not in everything.stdout + everything.stderr


def test_pretraining_installs_every_network(workspace):
    (workspace.folder / "one.yaml").write_text(
        "datasets: {street-pretrain: {options: {frames: 1, samples: 1}}}\nresolution: [64, 96]\n"
    )
    run = workspace.snakemake(*workspace.SMOKE, "one.yaml", "--", "pretrain")
    assert run.returncode == 0, run.stderr[-3000:]
    results = workspace.folder / "results/smoke"
    weights = workspace.folder / "weights"
    assert load_vggt(weights / "vggt-nano.safetensors").config == replace(
        VGGT_NANO, refiner=NANO_CHANNELS
    )
    for network in ("vggt-nano", "autoencoder", "prior"):
        new = (results / f"pretrain/{network}.safetensors").read_bytes()
        assert (weights / f"{network}.safetensors").read_bytes() == new
    (provenance,) = read_json(weights / "provenance.json")  # nothing of what was replaced
    assert provenance["trainings"]["prior"]["settings"]["steps"] == 4
    for training in ("vggt-nano", "depth-refiner", "autoencoder", "prior"):
        assert np.isfinite(provenance["trainings"][training]["losses"]["loss"])
    assert provenance["files"]["vggt-nano.safetensors"] == hash_path(
        weights / "vggt-nano.safetensors"
    )
    assert load_prior("nano", weights).diffusion.prediction == "v_prediction"
    scenes = sorted(path.name for path in (results / "scenes/street-pretrain").iterdir())
    assert scenes == ["straight-1001", "straight-1002"]

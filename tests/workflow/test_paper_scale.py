"""The paper's own rules, end to end on a CPU: its resolution, its overlays, and tiny weights.

Run by `pytest -m paper`; it takes minutes. Numbers mean nothing: networks are not trained.
"""

import numpy as np
import pandas as pd
import pytest
import torch

from geoevs.core.networks import seeded
from geoevs.geometry.vggt import Vggt, VggtConfig, save_vggt
from tests.scenes.waymo.world import make_segment
from tests.scenes.waymo.writers import write_v1

SEGMENTS = ("1000_000_000_020_000", "2000_000_000_020_000")
TINY = """
run: paper-tiny
datasets:
  waymo:
    partitions:
      geometry: ["1000_000_000_020_000@0-0"]
      train: ["1000_000_000_020_000@1-2"]
      clips: ["1000_000_000_020_000@1-2"]
      test: ["2000_000_000_020_000"]
geometry: {weights: vggt.safetensors, finetune: {steps: 2}}
trainings:
  geo-evs: {prior: stable-diffusion, steps: 2, batch: 1, sampling: {steps: 1}}
  freevs:
    {prior: stable-diffusion, frames: 2, steps: 2, batch: 1, sampling: {steps: 1, average: 1}}
methods:
  three-dgs: {options: {iterations: 20}}
  street-gaussians: {options: {iterations: 20}}
  emernerf:
    options:
      {iterations: 4, rays: 64, levels: 4, log2_entries: 10, width: 8, samples: [8, 4, 4]}
protocol:
  pose_sweep: {angles: [10.0], every: 2}
  masked: {yaw: [13], lateral: [-1.5], every: 2}
"""
MUST_RUN = ("mean-colour", "reproject", "geo-evs", "geo-evs-support", "freevs", "emernerf")
OVERLAYS = ("config.yaml", "workflow/scales/waymo-mini.yaml", "workflow/scales/paper.yaml")


@pytest.fixture
def paper(workspace, networks, monkeypatch):
    """A workspace with two made-up segments, and weights in the public layouts."""
    for name in SEGMENTS:
        segment = make_segment(frames=3 if name == SEGMENTS[0] else 2)
        segment.name = name
        write_v1(workspace.folder / f"waymo/segment-{name}_with_camera_labels.tfrecord", segment)
    config = VggtConfig(
        patch_size=14,
        dim=32,
        depth=4,
        heads=2,
        head_layers=(0, 1, 2, 3),
        head_channels=(8, 8, 8, 8),
        head_features=8,
        dino_depth=1,
        longest=126,
    )
    with seeded(0), torch.no_grad():
        save_vggt(Vggt(config), workspace.folder / "vggt.safetensors")
        networks.public_prior(
            workspace.folder / "stable-diffusion", levels=4
        )  # eighths, as its own
    (workspace.folder / "tiny.yaml").write_text(TINY, encoding="utf-8")
    monkeypatch.setenv("GEOEVS_WAYMO", str(workspace.folder / "waymo"))
    return workspace


@pytest.mark.paper
def test_the_papers_rules_pass_end_to_end(paper):
    run = paper.snakemake("--configfile", *OVERLAYS, "tiny.yaml", "--", "tables", "report")
    assert run.returncode == 0, run.stderr[-3000:]
    results = paper.folder / "results/paper-tiny"
    scores = pd.read_parquet(results / "scores.parquet")
    assert set(scores["scene"]) == {SEGMENTS[1]}
    ran = scores[scores["status"] == "ok"]
    assert set(MUST_RUN) <= set(ran["method"]), scores["reason"].unique()
    table = pd.read_csv(results / "tables/extrapolation.csv").set_index("method")
    assert np.isfinite(table.loc["geo-evs", "sparse_psnr"])
    assert (results / "report.html").stat().st_size > 10_000


def test_the_papers_rules_are_planned_whole(workspace, monkeypatch):
    monkeypatch.setenv("GEOEVS_WAYMO", str(workspace.folder / "nowhere"))
    run = workspace.snakemake("-n", "--configfile", *OVERLAYS, "--", "tables")
    assert run.returncode == 0, run.stderr[-3000:]
    assert "fit " in run.stdout + run.stderr

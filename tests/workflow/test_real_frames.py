"""The whole DAG on real frames."""

import os

import numpy as np
import pandas as pd
import pytest


@pytest.mark.skipif(
    "GEOEVS_PANDASET" not in os.environ,
    reason="set GEOEVS_PANDASET to the folder that holds PandaSet sequences such as 002",
)
def test_real_frames_run_too(workspace):
    (workspace.folder / "small.yaml").write_text(
        "resolution: [96, 96]\n"
        'datasets: {pandaset: {partitions: {test: ["002@65-65"]}}}\n'
        "methods: {reproject: null, reproject-inpaint.navier-stokes: null, reference: null,"
        " reproject-inpaint.all-frames: null, nearest-view: null,"
        " three-dgs: null, street-gaussians: null, emernerf: null, freevs: null}\n"
        "geometry: {finetune: {steps: 2}}\n"
        "weights: weights\n"
        "trainings: {geo-evs: {steps: 2}}\n"
    )
    scale = ("config.yaml", "workflow/scales/pandaset.yaml", "small.yaml")
    made = "results/pandaset/tables/extrapolation.csv"
    run = workspace.snakemake("--configfile", *scale, "--", made)
    assert run.returncode == 0, run.stderr[-3000:]
    table = pd.read_csv(workspace.folder / made)
    means = table.set_index("method")["sparse_psnr"]
    assert means["reproject-inpaint"] > means["mean-colour"] + 3
    assert np.isfinite(means[["geo-evs", "geo-evs-support"]]).all()

"""Broken files of a run, and of weights: each is used or refused in one line, never more."""

import json
import math

import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from geoevs import layout
from geoevs.core.networks import built_as_described, load_weights, read_network, save_network
from geoevs.methods.trained import FAILURE_FILE, read_trained, trained_seconds
from geoevs.protocol.entries import FINE, read_outcomes
from geoevs.protocol.rows import COST_TYPES, SCORE_TYPES, cost_frame, score_frame
from geoevs.results.entrants import Entrants
from geoevs.results.manifest import NOT_SAID, read_manifest
from geoevs.results.rows import read_rows
from tests.fuzzing import SHARE, changed, edit_bytes, edit_column, edit_json, refused

BLANK = {"string": "", "int64": 0, "float64": math.nan}
INFO = {"name": "A", "paradigm": "reconstruction", "extra_prior": "none", "needs": "lidar"}
OUTCOME = {**FINE, "threads": 2, "peak_memory": 10**9, "gpu_memory": 0, "fit_seconds": 1.5}
OUTCOME |= {"attempt": 0, "bytes": 7, "pictures": {"front/000000": "0" * 64}}
PLACE = {"dataset": "d", "scene": "s", "method": "a", "variant": "default"}


def rows_of(types, **given):
    return {name: BLANK[kind] for name, kind in types.items()} | PLACE | given


def read_all_outcomes(path):
    for outcome in read_outcomes(path).values():
        cost_frame([{**rows_of(COST_TYPES), **outcome}])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """One of each file that other people's runs hold, and what reads it."""
    folder = tmp_path_factory.mktemp("foreign")
    scored = {"support_ratio": 0.1, "pose_offset": 5.0, "lateral_shift": 1.0, "target": "t"}
    scores = [
        rows_of(SCORE_TYPES, metric="psnr", value=20.0 + frame, frame=frame, **scored)
        for frame in range(3)
    ]
    score_frame(scores).to_parquet(folder / layout.SCORES)
    cost_frame([rows_of(COST_TYPES, sources="all-cameras")]).to_parquet(folder / layout.COSTS)
    texts = {
        "render.json": {"all-cameras": OUTCOME, "front-side": OUTCOME},
        "entrants.json": {"a": {**INFO, "citation": "A et al."}, "b.c": {**INFO, "citation": ""}},
        "manifest.json": {**NOT_SAID, "config": {"methods": {"a": {}}, "tables": {}}},
        "settings.json": {"steps": 3, "sampling": {"steps": 1}},
        FAILURE_FILE: {"reason": "lost", "stage": "training"},
        "networks.seconds.json": {"training": 3.5, "prior": 2},
    }
    for name, value in texts.items():
        (folder / name).write_text(json.dumps(value), encoding="utf-8")
    return {
        layout.SCORES: (folder, lambda path: read_rows(path, layout.SCORES)),
        layout.COSTS: (folder, lambda path: read_rows(path, layout.COSTS)),
        "render.json": (folder, read_all_outcomes),
        "entrants.json": (folder, Entrants.read),
        "manifest.json": (folder, read_manifest),
        "settings.json": (folder, lambda path: read_trained(path.parent)),
        FAILURE_FILE: (folder, lambda path: read_trained(path.parent)),
        "networks.seconds.json": (
            folder,
            lambda path: trained_seconds(path.with_name("networks.safetensors")),
        ),
    }


@SHARE
@given(data=st.data())
def test_a_broken_file_of_a_run_is_used_or_refused(files, data):
    name = data.draw(st.sampled_from(sorted(files)), "file")
    folder, read = files[name]
    with changed(folder / name) as path:
        if path.suffix == ".json" and data.draw(st.integers(0, 5)):
            edit_json(path, data)
        elif path.suffix == ".json" or not data.draw(st.integers(0, 3)):
            edit_bytes(path, data)
        else:
            table = pd.read_parquet(path)
            column = data.draw(st.sampled_from(list(table)), "column")
            if data.draw(st.integers(0, 5)) == 0:
                table = table.drop(columns=column)
            else:
                cells = pd.Series(edit_column(table[column].to_numpy(), data))
                table = table.assign(**{column: cells})
            try:
                table.to_parquet(path)
            except Exception:  # mixed cells that no Parquet file can hold
                return
        refused(lambda: read(path))


def tiny(width: int) -> nn.Module:
    return nn.Sequential(nn.Linear(width, width), nn.LayerNorm(width))


def load_tiny(path) -> None:
    settings, weights = read_network(path)
    with built_as_described(path, "make it again"):
        model = tiny(**(settings or {}))
    load_weights(model, weights, path, "make it again")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_network(path, tiny(4), {"width": 4})
    return path


@SHARE
@given(data=st.data())
def test_broken_weights_are_used_or_refused(weights, data):
    with changed(weights) as path:
        raw = path.read_bytes()
        if data.draw(st.booleans(), "header"):  # lies in it, of the right length
            size = int.from_bytes(raw[:8], "little")
            (path.parent / "header.json").write_bytes(raw[8 : 8 + size])
            edit_json(path.parent / "header.json", data)
            header = (path.parent / "header.json").read_bytes()
            path.write_bytes(len(header).to_bytes(8, "little") + header + raw[8 + size :])
        else:
            edit_bytes(path, data)
        refused(lambda: load_tiny(path))


def test_whole_weights_are_used(weights):
    load_tiny(weights)
    assert not torch.isnan(read_network(weights)[1]["0.weight"]).any()

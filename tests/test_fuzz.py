"""Broken files of a run, weights and pictures of others: each is used or refused in one line."""

import json
import math

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from torch import nn

from baselines.external.adapter import Method as External
from geoevs import layout
from geoevs.core.networks import built_as_described, load_weights, read_network, save_network
from geoevs.methods.tiny import tiny_camera, tiny_truth
from geoevs.methods.trained import FAILURE_FILE, read_trained, trained_seconds
from geoevs.protocol.entries import FINE, read_outcomes
from geoevs.protocol.rows import COST_TYPES, SCORE_TYPES, cost_frame, score_frame
from geoevs.results.entrants import Entrants
from geoevs.results.manifest import NOT_SAID, read_manifest
from geoevs.results.rows import read_rows
from tests.fuzzing import (
    SHARE,
    anything,
    changed,
    edit_bytes,
    edit_column,
    edit_json,
    edit_json_bytes,
    edit_png,
    judged,
    name,
    number,
    read_plainly,
    sound_columns,
    text,
    whole,
)

BLANK = {"string": "", "int64": 0, "float64": math.nan}
INFO = {
    **{"name": "A", "paradigm": "reconstruction", "extra_prior": "none", "needs": "lidar"},
    "sees": "views",
}
OUTCOME = {**FINE, "threads": 2, "peak_memory": 10**9, "gpu_memory": 0, "fit_seconds": 1.5}
OUTCOME |= {"attempt": 0, "bytes": 7, "pictures": {"front/000000": "0" * 64}}
PLACE = {"dataset": "d", "scene": "s", "method": "a", "variant": "default"}
TYPES = {layout.SCORES: SCORE_TYPES, layout.COSTS: COST_TYPES}
NAMES = ("dataset", "scene", "target", "method", "variant", "split", "metric", "sources")
KNOWN = ("support_ratio", "pose_offset", "lateral_shift")


def section(value):
    return isinstance(value, dict)


def seconds_or_none(value):
    return value is None or number(0, 2**62)(value)


RULES = {
    "render.json": {
        ("*", "?"): lambda value: section(value) and OUTCOME.keys() - {"pictures"} <= value.keys(),
        ("*", "status"): lambda value: value in ("ok", "failed"),
        **{("*", key): text for key in ("stage", "reason", "log")},
        **{("*", key): whole() for key in ("threads", "peak_memory", "gpu_memory")},
        **{("*", key, "?"): whole() for key in ("attempt", "bytes")},
        ("*", "fit_seconds", "?"): seconds_or_none,
        ("*", "*", ..., "?"): anything,
    },
    "entrants.json": {
        ("*", "?"): lambda value: section(value) and all(text(value.get(key)) for key in INFO),
        **{("*", key): text for key in INFO},
        ("*", "*", ..., "?"): anything,
        (): lambda value: value == {},
    },
    "manifest.json": {
        ("commit", "?"): text,
        **{(key, "?"): lambda value: type(value) is int for key in ("protocol", "seed")},
        ("configfiles", "?"): lambda value: isinstance(value, list) and all(map(text, value)),
        **{(key, "?"): section for key in ("config", "inputs", "versions", "machine")},
        **{("config", key, "?"): section for key in ("methods", "tables")},
        ("config", "methods", "*", "?"): lambda value: value is None or section(value),
        ("*", ..., "?"): anything,
        (): section,
    },
    "settings.json": {(): section, ("*", ..., "?"): anything},
    FAILURE_FILE: {},
    "networks.seconds.json": {
        ("*", "?"): number(0, 2**62),
        (): lambda value: section(value) and all(map(number(0, 2**62), value.values())),
    },
}


def row_rules(types):
    """What may stand in a cell, by column."""
    kinds = {
        "string": text,
        "int64": whole(-(2**63)),
        "float64": lambda cell: type(cell) in (int, float) or cell is None,
    }
    rules = {column: kinds[kind] for column, kind in types.items()}
    return (
        rules
        | {column: name for column in NAMES if column in rules}
        | {column: number() for column in KNOWN if column in rules}
    )


def rows_of(types, **given):
    return {column: BLANK[kind] for column, kind in types.items()} | PLACE | given


def read_all_outcomes(path):
    for outcome in read_outcomes(path).values():
        cost_frame([{**rows_of(COST_TYPES), **outcome}])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """One of each file that other people's runs hold, and what reads it."""
    folder = tmp_path_factory.mktemp("foreign")
    scored = {"support_ratio": 0.1, "pose_offset": 5.0, "lateral_shift": 1.0, "target": "t"}
    scored |= {"split": "extrapolation", "metric": "psnr"}
    scores = [rows_of(SCORE_TYPES, value=20.0 + frame, frame=frame, **scored) for frame in range(3)]
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
    for file, value in texts.items():
        (folder / file).write_text(json.dumps(value), encoding="utf-8")
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


def edit_rows(path, data):
    """Change a cell, a column or a byte of a Parquet file; whether its rows are still sound."""
    rules = row_rules(TYPES[path.name])
    if not data.draw(st.integers(0, 3)):
        edit_bytes(path, data)
        try:
            return sound_columns(read_plainly(path), rules)
        except Exception:  # whatever bytes make of it
            return False
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
        return True
    return sound_columns(read_plainly(path), rules)


@SHARE
@given(data=st.data())
def test_a_broken_file_of_a_run_is_used_or_refused(files, data):
    file = data.draw(st.sampled_from(sorted(files)), "file")
    folder, read = files[file]
    with changed(folder / file) as path:
        if path.suffix != ".json":
            sound = edit_rows(path, data)
        else:
            edit = edit_json if data.draw(st.integers(0, 5)) else edit_json_bytes
            sound = edit(path, data, RULES[file])
        kind = "rows" if path.suffix != ".json" else "outcomes, manifests, trainings"
        judged(kind, sound, lambda: read(path))


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


def sound_weights(raw: bytes, shapes: dict[str, list[int]]) -> bool:
    """Whether a file has these weights, finite, side by side, and the settings; read by hand."""
    try:
        size = int.from_bytes(raw[:8], "little")
        header = json.loads(raw[8 : 8 + size], object_pairs_hook=lambda pairs: pairs)
        if len(dict(header)) < len(header):
            return False
        tensors = {key: dict(value) for key, value in header if key != "__metadata__"}
        told = dict(dict(header)["__metadata__"])
        numbers = np.frombuffer(raw[8 + size :], "<f4")
        ends = sorted(tuple(tensor["data_offsets"]) for tensor in tensors.values())
        joined = [0, *(end for _, end in ends)] == [
            *(begin for begin, _ in ends),
            numbers.nbytes,
        ]
        return bool(
            joined
            and all(map(text, told.values()))
            and json.loads(told["settings"]) == {"width": 4}
            and {key: tensor["shape"] for key, tensor in tensors.items()} == shapes
            and all(tensor["dtype"] == "F32" for tensor in tensors.values())
            and all(
                end - begin == 4 * math.prod(tensors[key]["shape"])
                for key in tensors
                for begin, end in [tensors[key]["data_offsets"]]
            )
            and np.isfinite(numbers).all()
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return False


@SHARE
@given(data=st.data())
def test_broken_weights_are_used_or_refused(weights, data):
    shapes = {key: list(value.shape) for key, value in tiny(4).state_dict().items()}
    with changed(weights) as path:
        raw = path.read_bytes()
        if data.draw(st.booleans(), "header"):  # lies in it, of the right length
            size = int.from_bytes(raw[:8], "little")
            (path.parent / "header.json").write_bytes(raw[8 : 8 + size])
            edit_json(path.parent / "header.json", data, {})
            header = (path.parent / "header.json").read_bytes()
            path.write_bytes(len(header).to_bytes(8, "little") + header + raw[8 + size :])
        else:
            edit_bytes(path, data)
        judged("weights", sound_weights(path.read_bytes(), shapes), lambda: load_tiny(path))


def test_whole_weights_are_used(weights):
    load_tiny(weights)
    assert not torch.isnan(read_network(weights)[1]["0.weight"]).any()


CAMERA = tiny_camera("front", 0.0, np.array([0.0, 0.0, 1.6]))


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """A folder with a picture of one view by another program."""
    folder = tmp_path_factory.mktemp("theirs") / "theirs"
    (folder / "tiny/front").mkdir(parents=True)
    Image.fromarray(tiny_truth(CAMERA).rgb).save(folder / "tiny/front/000000.png")
    return folder


def alter_picture(path, data):
    """Make something else of a picture; whether it may still be scored."""
    change = data.draw(
        st.sampled_from(["bytes", "bytes", "bytes", "size", "mode", "format", "gone", "folder"])
    )
    image = Image.open(path)
    image.load()
    path.unlink()
    if change == "bytes":
        image.save(path)
        return edit_png(path, data)
    if change == "size":
        size = data.draw(st.sampled_from([(72, 47), (36, 24), (48, 72), (72, 48), (1, 1)]))
        image.resize(size).save(path)
        return size == (72, 48)
    if change == "mode":
        mode = data.draw(st.sampled_from(["L", "P", "1", "I;16", "RGBA", "LA", "RGB"]))
        image = image.convert("L").convert(mode) if mode == "I;16" else image.convert(mode)
        if mode in ("RGBA", "LA") and data.draw(st.booleans(), "transparent"):
            image.putalpha(100)
            image.save(path)
            return False
        image.save(path)
        return True
    if change == "format":
        format = data.draw(st.sampled_from(["BMP", "GIF", "TIFF", "JPEG", "EPS", "PPM", "WEBP"]))
        image.save(path, format=format)
        return format == "JPEG"
    if change == "folder":
        path.mkdir()
    return False


@SHARE
@given(data=st.data())
def test_a_broken_picture_of_others_is_used_or_refused(pictures, data):
    with changed(pictures) as folder:
        sound = alter_picture(folder / "tiny/front/000000.png", data)
        method = External(str(folder))
        method.scene = "tiny"
        judged("external folders", sound, lambda: method.render(CAMERA, 0))

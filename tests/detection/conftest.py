"""Boxes, frames and files for tests of detection metrics."""

import struct
from pathlib import Path

import numpy as np
import pytest

from geoevs import layout
from geoevs.core.files import write_json
from geoevs.core.hashes import file_hash
from geoevs.core.images import write_image
from geoevs.core.parquet import write_parquet
from geoevs.core.stamps import MADE_WITH
from geoevs.detection.frames import Predictions, Truths
from geoevs.detection.labels import scene_labels
from geoevs.detection.rigs import DetectionScene
from geoevs.detection.rules import CLASSES
from geoevs.detection.views import ViewSettings, moved_rig, views_between
from geoevs.methods.tiny import tiny_truth, write_tiny_scene
from geoevs.protocol.entries import FINE
from geoevs.protocol.pictures import PICTURES, seal_pictures
from geoevs.protocol.provenance import targets_stamp
from geoevs.protocol.targets import ALL_CAMERAS, read_targets, write_targets
from geoevs.scenes.scene import SceneExtras
from geoevs.scenes.store import Scene

BOX = {"x": 1, "y": 2, "z": 3, "width": 4, "length": 5, "height": 6, "heading": 7}
"""The numbers of label.proto."""


def box(x=0.0, y=0.0, z=0.0, length=1.0, width=2.0, height=2.0, heading=0.0):
    return np.array([x, y, z, length, width, height, heading], float)


def varint(value: int) -> bytes:
    value &= 2**64 - 1
    groups = [value >> shift & 0x7F for shift in range(0, max(value.bit_length(), 1), 7)]
    return bytes([*(group | 0x80 for group in groups[:-1]), groups[-1]])


def field(number: int, value) -> bytes:
    """A message's field: whole numbers as varints, float32 as four bytes, floats as eight."""
    if isinstance(value, np.float32):
        return varint(number << 3 | 5) + struct.pack("<f", value)
    if isinstance(value, float):
        return varint(number << 3 | 1) + struct.pack("<d", value)
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def message(fields) -> bytes:
    """A message of a number-to-value mapping; None is left out."""
    return b"".join(field(number, value) for number, value in fields.items() if value is not None)


def box_message(values) -> bytes:
    names = ("x", "y", "z", "length", "width", "height", "heading")
    return message({BOX[name]: float(value) for name, value in zip(names, values, strict=True)})


def prediction_object(values, kind=1, score=0.9, scene="s", frame=7, ignored=None, camera=None):
    label = message({1: box_message(values), 3: kind})
    score = None if score is None else np.float32(score)
    return message({1: label, 2: score, 3: ignored, 4: scene, 5: frame, 6: camera})


def truth_object(
    values, kind=1, scene="s", frame=7, points=9, top=9, camera="FRONT", level=None, synced=None
):
    synced = box_message(values if synced is None else synced)
    label = {1: box_message(values), 3: kind, 4: "id", 5: level, 7: points, 11: camera}
    return message({1: message({**label, 12: synced, 13: top}), 4: scene, 5: frame})


def write_objects(path: Path, objects) -> Path:
    path.write_bytes(b"".join(field(1, data) for data in objects))
    return path


def predictions(*boxes, scores=None, classes=None, ignored=None):
    count = len(boxes)
    return Predictions(
        np.array(boxes).reshape(-1, 7),
        np.array([CLASSES.index(name) for name in classes or ["vehicle"] * count], int),
        np.array([0.9] * count if scores is None else scores, float),
        np.array([False] * count if ignored is None else ignored, bool),
    )


def truths(*boxes, classes=None, levels=None, cameras=None):
    count = len(boxes)
    return Truths(
        np.array(boxes).reshape(-1, 7),
        np.array([CLASSES.index(name) for name in classes or ["vehicle"] * count], int),
        np.array([2] * count if levels is None else levels, int),
        np.array(["FRONT"] * count if cameras is None else cameras, object),
    )


@pytest.fixture
def street():
    """Seven boxes of three classes around the vehicle, near and far, with headings."""
    rng = np.random.default_rng(3)
    places = [(12, 1), (35, -4), (60, 9), (8, 7), (20, 20), (10, -9), (3, -15)]
    sides = [(4.6, 1.9, 1.7)] * 4 + [(0.8, 0.8, 1.8)] * 2 + [(1.9, 0.8, 1.8)]
    headings = rng.uniform(-np.pi, np.pi, 7)
    boxes = np.array([(x, y, 0.9, *sides[n], headings[n]) for n, (x, y) in enumerate(places)])
    names = ["vehicle"] * 4 + ["pedestrian"] * 2 + ["cyclist"]
    return boxes, names


PLACE = {"dataset": "d", "scene": "tiny"}
OFFSETS = (-1.0, 2.0)
COSTS = {"threads": 1, "peak_memory": 0, "gpu_memory": 0}
ZONE = np.array([[8.0, 1.0], [40.0, 1.0], [40.0, 3.0], [8.0, 3.0]])


def stamp(run):
    """What renders of the tiny scene are made with."""
    scene, targets = (
        run / name.format(**PLACE) for name in (layout.SCENE, layout.DETECTION_TARGETS)
    )
    return {"scene": Scene(scene).stamp, "targets": file_hash(targets)}


def grey_views(run, label, value, leave_out=()):
    """Renders of an entrant that knows one grey value."""
    folder = run / layout.DETECTION_VIEWS.format(**PLACE, label=label)
    targets = read_targets(run / layout.DETECTION_TARGETS.format(**PLACE))
    for target in targets:
        if target.key not in leave_out:
            picture = np.full((target.camera.height, target.camera.width, 3), value, np.uint8)
            write_image(folder / f"{target.key}.png", picture)
    outcome = {**FINE, **COSTS, PICTURES: seal_pictures(folder, targets)}
    outcome[MADE_WITH] = stamp(run)
    write_json(folder / "render.json", {ALL_CAMERAS: outcome})
    return folder


@pytest.fixture(scope="session")
def rig_run(tmp_path_factory):
    """A run with the tiny scene as the stage of detection has it, and truth at all its targets."""
    run = tmp_path_factory.mktemp("run")
    extras = SceneExtras(no_label_zones={1: [ZONE]})
    scene = write_tiny_scene(run / layout.SCENE.format(**PLACE), extras=extras)
    labels = scene_labels(scene, "d/tiny", {"vehicle": ["car"]}, (-8, -28, -3, 48, 28, 5))
    write_parquet(run / layout.DETECTION_LABELS.format(**PLACE), labels)
    targets = [*views_between(scene, ViewSettings()), *moved_rig(scene, OFFSETS)]
    path = run / layout.DETECTION_TARGETS.format(**PLACE)
    write_targets(path, targets, targets_stamp(scene, {}, 0))
    for target in targets:
        path = run / layout.DETECTION_TRUTH.format(**PLACE) / f"{target.key}.png"
        write_image(path, tiny_truth(target.camera).rgb)
    grey_views(run, "grey", 51)
    return run


@pytest.fixture
def rig_scene(rig_run):
    return DetectionScene(rig_run, "d", "tiny")

"""PandaSet's real sequence 002; these tests repeat the measurements that docs/pandaset.md names."""

import gzip
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from pandas.compat import pickle_compat

from geoevs.projection import colour_frame, zbuffer
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.pandaset.source import Source
from geoevs.scenes.sources.pandaset.unpickle import read_table


@pytest.fixture(scope="module")
def real_folder():
    if "GEOEVS_PANDASET" not in os.environ:
        pytest.skip("set GEOEVS_PANDASET to the folder that holds PandaSet's sequence 002")
    return Path(os.environ["GEOEVS_PANDASET"])


@pytest.fixture(scope="module")
def real_frames(real_folder):
    """Boxes of frames 62 to 66, and frame 62 at 512 x 512."""
    source = Source(512, 512, folder=str(real_folder))
    record = source.open(SceneRef("002", 62, 66))
    return record, next(iter(record.frames))


def half_way(front: Camera, side: Camera, shift: float) -> Camera:
    """`front` turned half-way to `side` about world z, between the two, `shift` m to the left."""
    turn = np.radians(side.yaw - front.yaw) / 2
    pose = front.world_from_camera.copy()
    cos, sin = np.cos(turn), np.sin(turn)
    pose[:3, :3] = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ pose[:3, :3]
    heading = np.radians(front.yaw)
    left = np.array([-np.sin(heading), np.cos(heading), 0])
    pose[:3, 3] = (front.centre + side.centre) / 2 + shift * left
    return replace(front, world_from_camera=pose)


def support_ratio(xyz: np.ndarray, camera: Camera) -> float:
    """Share of the pixels that at least one point falls into; xyz is [N, 3]."""
    seen = (xyz - camera.centre) @ camera.world_from_camera[:3, :3]
    seen = seen[seen[:, 2] > 0] @ camera.K.T
    pixels = np.floor(seen[:, :2] / seen[:, 2:]).astype(int)
    inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    return len(np.unique(pixels[inside], axis=0)) / (camera.height * camera.width)


@pytest.mark.parametrize("side", ["front_left", "front_right"])
@pytest.mark.parametrize("shift", [-1.0, 1.0])
def test_targets_have_the_known_support(real_frames, side, shift):
    record, frame = real_frames
    rig = record.info.rig
    target = half_way(frame.cameras[rig.front], frame.cameras[getattr(rig, side)], shift)
    points = frame.points

    assert 0.052 < support_ratio(points.xyz[rig.scores(points)], target) < 0.061


def test_boxes_hold_their_points(real_frames):
    record, frame = real_frames
    boxes = record.tracks[(record.tracks["frame"] == 62) & (record.tracks["label"] == "Car")]

    def held(turn: float) -> int:
        count = 0
        for box in boxes.itertuples():
            yaw = np.radians(box.yaw + turn)
            rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
            local = (frame.points.xyz[:, :2] - (box.x, box.y)) @ rotation
            inside = (np.abs(local) <= (box.length / 2, box.width / 2)).all(axis=1)
            count += np.sum(inside & (np.abs(frame.points.xyz[:, 2] - box.z) <= box.height / 2))
        return count

    assert held(0) > 1.5 * held(90)


def test_boxes_drive_forwards(real_frames):
    record, _ = real_frames
    boxes = record.tracks.set_index(["frame", "track"])
    start, end = boxes.loc[62], boxes.loc[66]
    both = start.index.intersection(end.index)
    step = end.loc[both, ["x", "y"]] - start.loc[both, ["x", "y"]]
    driven = (np.hypot(step["x"], step["y"]) > 2) & (start.loc[both, "label"] == "Car")
    course = np.degrees(np.arctan2(step["y"], step["x"]))[driven]
    error = (course - start.loc[both, "yaw"][driven] + 180) % 360 - 180

    assert driven.sum() >= 10
    assert start.loc[both, "moving"][driven].all()
    assert np.abs(error).median() < 1.5
    assert np.abs(error).max() < 10


def test_tables_read_as_pandas_reads_them(real_folder):
    for file in ("lidar/62.pkl.gz", "annotations/cuboids/62.pkl.gz"):
        path = real_folder / "002" / file
        expected = pickle_compat.loads(gzip.decompress(path.read_bytes()))
        table = read_table(path)

        assert list(table) == list(expected)
        for column in table:
            same = table[column].to_numpy() == expected[column].to_numpy()
            assert (same | (table[column].isna() & expected[column].isna()).to_numpy()).all()


def test_lidar_edges_lie_on_image_edges_without_distortion(real_folder):
    # The left and right fifth of a wide image, where the raw lens shifts points by 30 px and more.
    record = Source(540, 960, folder=str(real_folder)).open(SceneRef("002", 62, 62))
    frame = next(iter(record.frames))
    camera = frame.cameras["front_left_camera"]
    image = cv2.cvtColor(frame.images["front_left_camera"], cv2.COLOR_RGB2GRAY)
    gradient = np.abs(cv2.Sobel(cv2.GaussianBlur(image, (0, 0), 2), cv2.CV_32F, 1, 0))

    def edge_strength(radial: float) -> float:
        seen = (frame.points.xyz - camera.centre) @ camera.world_from_camera[:3, :3]
        seen = seen[seen[:, 2] > 1]
        plane = seen[:, :2] / seen[:, 2:]
        seen, plane = (a[np.abs(plane).max(axis=1) < 1.1] for a in (seen, plane))
        squared = np.sum(plane**2, axis=1, keepdims=True)
        pixels = plane * (1 + radial * squared) * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2]
        depth = np.full(image.shape, np.inf)
        column, row = np.floor(pixels).astype(int).T
        inside = (column >= 0) & (column < 960) & (row >= 0) & (row < 540)
        inside &= np.abs(column - 480) > 288
        np.minimum.at(depth, (row[inside], column[inside]), seen[inside, 2])
        step = depth[:, 2:] > depth[:, :-2] + 2  # a nearer thing's right-hand outline
        step &= np.isfinite(depth[:, 2:])
        return float(gradient[:, 1:-1][step].mean())

    pinhole = edge_strength(0.0)
    assert all(pinhole > 1.1 * edge_strength(radial) for radial in (-0.165, -0.05, 0.05))


def test_a_frame_far_from_its_origin_has_the_same_pixels(real_folder, tmp_path, pandaset_files):
    shift = np.array([500_000.0, 4_649_776.0, 220.0])
    copy = tmp_path / "002"
    for folder in sorted(path for path in (real_folder / "002").rglob("*") if path.is_dir()):
        for path in (*folder.glob("62.*"), *folder.glob("*.json")):
            (copy / folder.relative_to(real_folder / "002")).mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy / path.relative_to(real_folder / "002"))
    for path in copy.rglob("poses.json"):
        poses = json.loads(path.read_text())
        for pose in poses:
            for axis, metres in zip("xyz", shift, strict=True):
                pose["position"][axis] += metres
        path.write_text(json.dumps(poses))
    for file, prefix in (("lidar", ""), ("annotations/cuboids", "position.")):
        path = copy / f"{file}/62.pkl.gz"
        table = read_table(path)
        columns = {
            name: table[name].to_numpy(object if table[name].dtype.kind not in "bif" else None)
            for name in table
        }
        for axis, metres in zip("xyz", shift, strict=True):
            columns[prefix + axis] = columns[prefix + axis] + metres
        pandaset_files.write_gzip(path, pandaset_files.old_pickle(columns))

    def seen(folder):
        """The record, its coloured points in the world, and the share of a target they fill."""
        record = Source(128, 192, folder=str(folder)).open(SceneRef("002", 62, 62))
        frame = colour_frame(next(iter(record.frames)))
        rig = record.info.rig
        target = half_way(frame.cameras[rig.front], frame.cameras[rig.front_left], 1.0)
        scoring = frame.points.select(rig.scores(frame.points))
        return record, frame.points, zbuffer(scoring.xyz, target).index

    near, points, index = seen(real_folder)
    far, moved, other = seen(tmp_path)
    assert near.info.origin == (0, 0, 0)
    # Rounding to float32 about another origin: 1e-5 m, which moves some points by a pixel.
    np.testing.assert_allclose(
        moved.xyz + (np.array(far.info.origin) - shift), points.xyz, rtol=0, atol=3e-5
    )
    assert (moved.camera != points.camera).mean() < 1e-4
    assert (index != other).mean() < 1e-3
    places = far.tracks[["x", "y", "z"]] + (np.array(far.info.origin) - shift)
    np.testing.assert_allclose(places, near.tracks[["x", "y", "z"]], rtol=0, atol=1e-8)

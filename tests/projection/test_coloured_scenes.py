import dataclasses

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import tiny_truth, write_tiny_scene
from geoevs.projection import colour_points
from geoevs.projection.coloured_scenes import write_coloured_scene
from geoevs.scenes.depths import read_depths
from geoevs.scenes.scene import NO_EXTRAS, Frame, PointCloud, SceneRecord
from geoevs.scenes.store import Scene


def uncoloured_frames(scene):
    """The frames of a scene as a source gives them: no colours, but true depths."""
    for frame in scene.frames:
        cameras = {name: scene.camera(name, frame) for name in scene.cameras}
        truth = {name: tiny_truth(camera) for name, camera in cameras.items()}
        points = scene.points(frame)
        yield Frame(
            frame,
            scene.timestamp(frame),
            cameras,
            {name: view.rgb for name, view in truth.items()},
            PointCloud.uncoloured(points.xyz, points.sensor, points.beam),
            {name: view.depth for name, view in truth.items()},
        )


def test_a_store_is_coloured_and_depths_lie_apart(tmp_path):
    expected = write_tiny_scene(tmp_path / "expected", extras=NO_EXTRAS)  # as coloured there
    steps = []
    record = SceneRecord(expected.info, expected.tracks, uncoloured_frames(expected), 2)
    write_coloured_scene(tmp_path / "s", tmp_path / "d", record, lambda: steps.append(1))
    assert len(steps) == 2
    scene = Scene(tmp_path / "s")
    assert scene.info == expected.info
    for frame in scene.frames:
        for field in dataclasses.fields(PointCloud):
            np.testing.assert_array_equal(
                getattr(scene.points(frame), field.name),
                getattr(expected.points(frame), field.name),
            )
        front = tiny_truth(scene.camera("front", frame)).depth
        np.testing.assert_array_equal(read_depths(tmp_path / "d", frame)["front"], front)
    files = [path.relative_to(tmp_path / "s") for path in (tmp_path / "s").rglob("*")]
    assert sorted(files) == sorted(
        path.relative_to(tmp_path / "expected") for path in (tmp_path / "expected").rglob("*")
    )


def test_a_scene_that_cannot_score_or_condition_leaves_nothing(tmp_path):
    tiny = write_tiny_scene(tmp_path / "tiny")

    def frames(keep):
        for frame in uncoloured_frames(tiny):
            points = frame.points.select(keep(frame.points))
            yield dataclasses.replace(frame, points=points)

    for keep, sentence in (
        (lambda points: points.beam % 2 == 0, "no LiDAR point is of odd beams, which score"),
        (lambda points: points.beam % 2 == 1, "no LiDAR point is of even beams, which condition"),
        (lambda points: points.xyz[:, 2] > 6.9, "no LiDAR point of odd beams falls into an image"),
        (lambda points: points.beam < 0, "no LiDAR point is of odd beams"),
    ):
        record = SceneRecord(tiny.info, tiny.tracks, frames(keep), 2)
        with pytest.raises(GeoEvsError, match=f"frame 0 of scene 'tiny': {sentence}"):
            write_coloured_scene(tmp_path / "out/s", tmp_path / "out/d", record, lambda: None)
        assert list((tmp_path / "out").iterdir()) == []


def test_more_cameras_than_an_int8_counts_are_refused(tmp_path):
    tiny = write_tiny_scene(tmp_path / "tiny")
    camera, image = tiny.camera("front", 0), tiny.image("front", 0)
    names = [f"c{number}" for number in range(128)]
    with pytest.raises(GeoEvsError, match="128 cameras are too many to colour points; give 127"):
        colour_points(tiny.points(0), dict.fromkeys(names, camera), dict.fromkeys(names, image))
    most = colour_points(
        tiny.points(0), dict.fromkeys(names[:127], camera), dict.fromkeys(names[:127], image)
    )
    assert set(most.camera.tolist()) == {-1, 0}

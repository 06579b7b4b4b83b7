"""The tiny room seen from a standing camera, its car driving by."""

import numpy as np
import pandas as pd
import pytest

from geoevs.methods import tiny as room
from geoevs.projection import colour_points, unproject_depth
from geoevs.scenes.scene import TRACK_COLUMNS, Frame, PointCloud, Rig, SceneInfo
from geoevs.scenes.store import Scene, write_scene

INFO = SceneInfo("moving", "tiny", "CC0-1.0", Rig("front", "left", "right", "beam"), ("front",))
CAR, FRAMES = room.CAR, 4
STEP = np.array([0.0, -0.9, 0.0])  # metres the car drives to the right each frame


def car_at(frame):
    return CAR + frame * STEP


def tracks(moving=True, size=None):
    rows = []
    for frame in range(FRAMES):
        car = car_at(frame)
        lengths = car[1] - car[0] if size is None else size
        rows.append((frame, "car-0", "car", *car.mean(axis=0), *lengths, 0.0, moving))
    return pd.DataFrame(rows, columns=list(TRACK_COLUMNS)).astype({"moving": bool})


def frames(lidar=True):
    with pytest.MonkeyPatch.context() as monkeypatch:
        for frame in range(FRAMES):
            monkeypatch.setattr(room, "CAR", car_at(frame))
            camera = room.tiny_camera("front", 0.0, room.MOUNT)
            truth = room.tiny_truth(camera)
            cameras, images = {"front": camera}, {"front": truth.rgb}
            xyz = unproject_depth(truth.depth, camera)[0][::3][: None if lidar else 0]
            points = PointCloud.uncoloured(xyz, np.zeros(len(xyz)), np.zeros(len(xyz)))
            yield Frame(frame, 0.1 * frame, cameras, images, colour_points(points, cameras, images))


@pytest.fixture(scope="session")
def write_room(tmp_path_factory):
    """Write the room with given tracks, its LiDAR or none."""

    def write(boxes, lidar=True):
        folder = tmp_path_factory.mktemp("moving") / "scene"
        write_scene(folder, INFO, boxes, frames(lidar))
        return Scene(folder)

    return write


@pytest.fixture(scope="session")
def moving(write_room):
    return write_room(tracks())


@pytest.fixture
def boxes():
    """Makes the car's boxes: moving or not, of another size."""
    return tracks


@pytest.fixture
def truth_with_car():
    """What the standing camera sees with the car so many frames on: colours, and where it is."""

    def make(frame):
        with pytest.MonkeyPatch.context() as monkeypatch:
            monkeypatch.setattr(room, "CAR", car_at(frame))
            camera = room.tiny_camera("front", 0.0, room.MOUNT)
            truth = room.tiny_truth(camera)
            monkeypatch.setattr(room, "CAR_TINT", np.zeros(3))
            return truth.rgb / 255, (truth.rgb != room.tiny_truth(camera).rgb).any(axis=2)

    return make

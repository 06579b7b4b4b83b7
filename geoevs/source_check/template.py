"""A new data source's first files: a small source that already keeps the contract, and its test."""

from pathlib import Path

import geoevs
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import new_folder, write_text
from geoevs.core.plugins import new_module
from geoevs.scenes.scene import find_sources

SOURCE = '''"""{name}: say in one line whose recordings these are."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import (
    TRACK_COLUMNS,
    Exposure,
    Frame,
    PointCloud,
    Rig,
    SceneExtras,
    SceneInfo,
    SceneRecord,
    SceneRef,
    Truth,
    scene_origin,
)
from geoevs.scenes.sources import made_up as recording  # a drive that is none: read your files
from geoevs.scenes.sources.conventions import MOVING_SPEED, beams_by_elevation, mark_moving

# Beams, since one LiDAR has to score methods and to condition them. Two LiDARs: "sensor".
RIG = Rig("front", "front_left", "front_right", lidar_split="beam")

# A camera's axes in a Scene are OpenCV's: x right, y down, z forward. Here they are x forward,
# y left, z up; the columns say where right, down and forward lie in those.
OPENCV_AXES = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


class Source:
    """Keywords are options, which the config gives; an annotation says what one takes.

    Args:
        height, width: size of the run's images in pixels; whole images are resized to it.
        frames: how many of a drive are read.
    """

    has_truth = False  # nobody can render a recorded street from elsewhere

    def __init__(self, height: int, width: int, *, frames: int = recording.FRAMES) -> None:
        self.height, self.width, self.frames = height, width, frames

    def check(self, scene: SceneRef) -> None:
        """Refuse what cannot be, before any job; without looking at data."""
        if scene.last is not None and scene.last >= recording.FRAMES:
            raise GeoEvsError(
                f"{name} scene '{{scene.name}}' has no frame {{scene.last}}; its frames are 0 to "
                f"{{recording.FRAMES - 1}}, so choose a range of those"
            )

    def files(self, scene: SceneRef) -> Iterable[Path]:
        """What a scene is read from: a change of one of these files or folders reads it again."""
        return ()

    def open(self, scene: SceneRef) -> SceneRecord:
        """Read what is small now, and the frames as they are iterated."""
        self.check(scene)
        frames = [frame for frame in range(self.frames) if scene.holds(frame)]
        # float32 holds millimetres up to 10 km, so a far origin is subtracted, in float64.
        origin = scene_origin(recording.pose(frames[0])[:3, 3])
        info = SceneInfo(
            name=scene.name,
            source="{name}",
            licence="CC0-1.0",  # of the data; tables and stores show it
            rig=RIG,
            cameras=tuple(recording.CAMERAS),
            origin=origin,
            redistribute=True,  # whether the licence lets anybody hand on the pictures
            box_delay=0.0,  # seconds from a frame's timestamp to the instant of its boxes
        )
        # (H, W) bool by camera where it sees its own car; nothing is scored or coloured there.
        extras = SceneExtras(ego_masks={{}})
        images = (self._read(frame, origin) for frame in frames)
        return SceneRecord(info, _read_tracks(frames, origin), images, len(frames), extras)

    def truth(self, scene: SceneRef, views: Sequence[tuple[Camera, int]]) -> Iterator[Truth]:
        """Only called where `has_truth`."""
        raise GeoEvsError(f"{name} scene '{{scene.name}}' has no truth; score it on its LiDAR")

    def _read(self, frame: int, origin: tuple[float, float, float]) -> Frame:
        ego = _ego(frame, origin)  # where each camera has an ego pose of its own, take that
        time = frame * recording.INTERVAL  # seconds
        cameras, images, exposures = {{}}, {{}}, {{}}
        for name in recording.CAMERAS:
            pose = ego @ recording.mount(name) @ OPENCV_AXES
            # Their pixels' centres are integers, as OpenCV's; in a Camera they lie at +0.5.
            cx, cy = (recording.WIDTH - 1) / 2 + 0.5, (recording.HEIGHT - 1) / 2 + 0.5
            K = np.array([[recording.FOCAL, 0, cx], [0, recording.FOCAL, cy], [0, 0, 1]])
            camera = Camera(K, pose, recording.HEIGHT, recording.WIDTH, name)
            image = recording.image(frame, name)  # undistort it first if its lens is no pinhole
            cameras[name] = camera.resized(self.height, self.width)
            size = self.width, self.height
            images[name] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            exposures[name] = Exposure(time, time, time)  # when it looked; leave out if unknown
        points = recording.sweep(frame)
        # Where data name the beam, take it, counted from the top.
        beam = beams_by_elevation(points, recording.BEAMS)
        world = _moved(ego @ recording.lidar_mount(), points)
        cloud = PointCloud.uncoloured(world, sensor=np.zeros(len(points)), beam=beam)
        return Frame(frame, time, cameras, images, cloud, exposures=exposures)


def _ego(frame: int, origin: tuple[float, float, float]) -> np.ndarray:
    """(4, 4) world from vehicle."""
    pose = recording.pose(frame)
    pose[:3, 3] -= origin
    return pose


def _moved(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N, 3) points in the frame that a pose leads to."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def _read_tracks(frames: Sequence[int], origin: tuple[float, float, float]) -> pd.DataFrame:
    """All boxes: centre and sides in metres, yaw in degrees about the world's z."""
    rows, speeds = [], []
    for frame in frames:
        ego = _ego(frame, origin)
        turned = np.degrees(np.arctan2(ego[1, 0], ego[0, 0]))
        for box in recording.boxes(frame):
            centre = _moved(ego, box["centre"])
            size = box["length"], box["width"], box["height"]
            yaw = (np.degrees(box["heading"]) + turned + 180) % 360 - 180
            rows.append((frame, box["id"], "car", *centre, *size, yaw, False))
            speeds.append(box["speed"])
    tracks = pd.DataFrame(rows, columns=list(TRACK_COLUMNS))
    return mark_moving(tracks, np.array(speeds) > MOVING_SPEED)
'''

TEST = '''"""{name} keeps the conventions of a scene."""

from geoevs.source_check.check import check_source


def test_conventions():
    findings, _ = check_source("{name}", "drive", {{}}, 240, 360)
    assert [finding for finding in findings if finding.status == "wrong"] == []
'''


def sources_root() -> Path:
    """The folder that holds `geoevs`, where new sources are written."""
    return Path(geoevs.__file__).parents[1]


def new_source(name: str, root: Path) -> list[Path]:
    """Write a working data source called `name`, and its test, into the repository at `root`.

    Args:
        name: such as `my-data`.
        root: holds `geoevs` and `tests`.

    Returns:
        The files that were written, the source first.

    Raises:
        GeoEvsError: the name is illegal or taken, or nothing can be written.
    """
    module = new_module(name, "data source")
    folder = root / "geoevs/scenes/sources" / module
    test = root / f"tests/scenes/test_{module}.py"
    name = module.replace("_", "-")
    taken = [path for path in (folder, folder.with_suffix(".py"), test) if path.exists()]
    if taken or name in find_sources():
        where = taken[0] if taken else f"data source '{name}'"
        raise GeoEvsError(f"{where} exists already; choose another name")
    write_text(test, TEST.format(name=name))
    with new_folder(folder) as partial:
        write_text(partial / "__init__.py", f'"""The data source {name}."""\n')
        write_text(partial / "source.py", SOURCE.format(name=name))
    return [folder / "source.py", folder / "__init__.py", test]

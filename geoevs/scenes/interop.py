"""A scene in the formats of other tools: its points as a PLY file, and all of it for COLMAP."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geoevs.core.files import new_folder, write_bytes, write_text
from geoevs.core.images import to_uint8
from geoevs.core.text import clean
from geoevs.scenes.camera import Camera, view_key
from geoevs.scenes.scene import PointCloud, Rig

if TYPE_CHECKING:
    from geoevs.scenes.store import Scene

MOST_POINTS = 1_000_000
"""Of a point file: viewers and trainings start from fewer."""

COLOURS = ("red", "green", "blue")
VERTEX = np.dtype([*((axis, "<f4") for axis in "xyz"), *((name, "u1") for name in COLOURS)])


class ThinnedPoints:
    """The coloured points of a scene's frames that may condition methods, at most MOST_POINTS.

    Points that score are left out, so that nobody trains on what scores. Of too many, every second
    one is dropped again and again: what is kept lies an even stride apart, and memory is bounded.
    """

    def __init__(self, rig: Rig, most: int = MOST_POINTS) -> None:
        self._rig, self._most = rig, most
        self._stride, self._seen = 1, 0
        self._kept = np.zeros(0, VERTEX)

    def add(self, points: PointCloud) -> None:
        """Take the next frame's points."""
        chosen = points.select((points.camera >= 0) & ~self._rig.scores(points))
        first = -self._seen % self._stride
        self._seen += len(chosen)
        vertices = np.zeros(len(chosen.xyz[first :: self._stride]), VERTEX)
        xyz, rgb = chosen.xyz[first :: self._stride], to_uint8(chosen.rgb[first :: self._stride])
        for column, name in enumerate("xyz"):
            vertices[name] = xyz[:, column]
        for column, name in enumerate(COLOURS):
            vertices[name] = rgb[:, column]
        self._kept = np.concatenate([self._kept, vertices])
        while len(self._kept) > self._most:
            self._kept = self._kept[::2]
            self._stride *= 2

    @property
    def vertices(self) -> np.ndarray:
        """(N,) of VERTEX: what is kept so far."""
        return self._kept


def write_ply(path: Path, vertices: np.ndarray, comments: Sequence[str] = ()) -> None:
    """Write a table of vertices as a binary PLY file, little endian.

    Args:
        path: of the file, whole or not at all.
        vertices: (N,) of named float32 and uint8 columns, such as VERTEX.
        comments: of the header, one line each.
    """
    kinds = {"<f4": "float", "|u1": "uchar"}
    names = vertices.dtype.names or ()
    properties = [f"property {kinds[vertices.dtype[name].str]} {name}" for name in names]
    header = "\n".join(
        (
            *("ply", "format binary_little_endian 1.0"),
            *(f"comment {clean(comment)}" for comment in comments),
            f"element vertex {len(vertices)}",
            *(*properties, "end_header\n"),
        )
    )
    write_bytes(path, header.encode("ascii", "backslashreplace") + vertices.tobytes())


def export_colmap(scene: "Scene", out: Path) -> None:
    """Write a scene as a COLMAP text model with its images: `sparse/0` and `images`.

    COLMAP counts pixels as a Scene does, from the corner of the first one. Each camera of each
    frame is an image; views of one camera and one K share a COLMAP camera. The points are those of
    the store's `points.ply`, without tracks, for nobody matched features.

    Args:
        scene: the store.
        out: the folder to write, whole or not at all.

    Raises:
        GeoEvsError: a file of the store is missing or damaged, or nothing can be written.
    """
    cameras: dict[tuple[str, bytes], int] = {}
    camera_lines: list[str] = []
    image_lines: list[str] = []
    thinned = ThinnedPoints(scene.info.rig)
    with new_folder(out) as partial:
        for frame in scene.frames:
            thinned.add(scene.points(frame))
            for name in scene.cameras:
                camera = scene.camera(name, frame)
                key = name, camera.K.tobytes()
                if key not in cameras:
                    cameras[key] = len(cameras) + 1
                    camera_lines.append(f"{cameras[key]} {_intrinsics(camera)}")
                number, file = len(image_lines) + 1, f"{view_key(name, frame)}.png"
                image_lines.append(f"{number} {_pose(camera)} {cameras[key]} {file}\n")
                write_bytes(partial / "images" / file, scene.image_path(name, frame).read_bytes())
        point_lines = [
            f"{number} {' '.join(repr(float(p[axis])) for axis in 'xyz')} "
            f"{p['red']} {p['green']} {p['blue']} 0"
            for number, p in enumerate(thinned.vertices, 1)
        ]
        model = partial / "sparse/0"
        write_text(
            model / "cameras.txt", _lines("CAMERA_ID MODEL WIDTH HEIGHT PARAMS", camera_lines)
        )
        head = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then an empty line of POINTS2D"
        write_text(model / "images.txt", _lines(head, image_lines))
        head = "POINT3D_ID X Y Z R G B ERROR, no TRACK"
        write_text(model / "points3D.txt", _lines(head, point_lines))


def _lines(head: str, lines: list[str]) -> str:
    return "\n".join((f"# {head}", *lines)) + "\n"


def _intrinsics(camera: Camera) -> str:
    K = camera.K
    numbers = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    return f"PINHOLE {camera.width} {camera.height} {' '.join(repr(float(n)) for n in numbers)}"


def _pose(camera: Camera) -> str:
    """Camera from world: a quaternion, w first, and a translation."""
    from scipy.spatial.transform import Rotation  # slow to import, and stores need none

    x, y, z, w = Rotation.from_matrix(camera.camera_from_world[:3, :3]).as_quat()
    numbers = (w, x, y, z, *camera.camera_from_world[:3, 3])
    return " ".join(repr(float(number)) for number in numbers)

"""Building triangle meshes out of quads, boxes, lofts and blobs, sorted by finish."""

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike


class Surface(NamedTuple):
    """Triangles of one finish; corners are not shared."""

    corners: np.ndarray  # [T, 3, 3] metres, counter-clockwise seen from outside
    normals: np.ndarray  # [T, 3, 3]
    colours: np.ndarray  # [T, 3] linear RGB
    uv: np.ndarray  # [T, 3, 2] metres on the surface


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(N, 3) cross products; many times faster than NumPy's for the few rows of a box or a tube."""
    a, b, c = first.T
    d, e, f = second.T
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d], axis=1)


def face_normals(corners: np.ndarray) -> np.ndarray:
    """(N, 3) unit normals of (N, K, 3) polygons with K >= 3."""
    across = corners[:, 2] - corners[:, 0]
    if corners.shape[1] == 4:
        normals = cross(across, corners[:, 3] - corners[:, 1])
    else:
        normals = cross(corners[:, 1] - corners[:, 0], across)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


class MeshBuilder:
    """Collects polygons by finish; `surfaces` gives each finish's triangles."""

    def __init__(self) -> None:
        self._parts: dict[str, list[Surface]] = defaultdict(list)

    def triangles(
        self,
        finish: str,
        corners: np.ndarray,  # [N, 3, 3]
        colour: ArrayLike,  # [3] or [N, 3]
        normals: np.ndarray | None = None,  # [N, 3, 3]
        uv: np.ndarray | None = None,  # [N, 3, 2]
    ) -> None:
        """Add triangles; flat-shaded unless `normals` are given."""
        count = len(corners)
        if normals is None:
            normals = np.repeat(face_normals(corners)[:, None], 3, axis=1)
        if uv is None:
            uv = np.zeros((count, 3, 2))
        colours = np.broadcast_to(np.asarray(colour, float), (count, 3))
        self._parts[finish].append(Surface(corners, normals, colours, uv))

    def quads(
        self,
        finish: str,
        corners: np.ndarray,  # [N, 4, 3]
        colour: ArrayLike,  # [3] or [N, 3]
        normals: np.ndarray | None = None,  # [N, 4, 3]
        uv: np.ndarray | None = None,  # [N, 4, 2]
    ) -> None:
        """Add quads, each as two triangles."""
        corners = np.asarray(corners, float)
        if normals is None:
            normals = np.repeat(face_normals(corners)[:, None], 4, axis=1)
        colours = np.broadcast_to(np.asarray(colour, float), (len(corners), 3))
        for pick in ([0, 1, 2], [0, 2, 3]):
            part = None if uv is None else uv[:, pick]
            self.triangles(finish, corners[:, pick], colours, normals[:, pick], part)

    def place(
        self, other: "MeshBuilder", x: float, y: float, z: float, yaw: float, scale: float = 1.0
    ) -> None:
        """Add everything of `other`, turned by `yaw` radians about z and moved."""
        cos, sin = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        for finish, parts in other._parts.items():
            for part in parts:
                self._parts[finish].append(
                    part._replace(
                        corners=part.corners @ (scale * turn.T) + np.array([x, y, z]),
                        normals=part.normals @ turn.T,
                    )
                )

    def surfaces(self) -> dict[str, Surface]:
        """Each finish's triangles in one piece, without those that have no area."""
        merged = {}
        for finish, parts in self._parts.items():
            whole = Surface(*(np.concatenate(field) for field in zip(*parts, strict=True)))
            first, second = (whole.corners[:, i] - whole.corners[:, 0] for i in (1, 2))
            solid = np.linalg.norm(cross(first, second), axis=1) > 1e-9
            merged[finish] = Surface(*(field[solid] for field in whole))
        return merged


def boxes(low: ArrayLike, high: ArrayLike) -> np.ndarray:
    """(6 N, 4, 3) quads of N axis-aligned boxes between (N, 3) corners."""
    ends = np.stack([np.atleast_2d(corner).astype(float) for corner in (low, high)])  # [2, N, 3]
    quads = []
    for axis in range(3):
        second, third = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            ring = [(0, 0), (1, 0), (1, 1), (0, 1)] if side else [(0, 0), (0, 1), (1, 1), (1, 0)]
            quad = np.empty((ends.shape[1], 4, 3))
            for corner, (b, c) in enumerate(ring):
                quad[:, corner, axis] = ends[side, :, axis]
                quad[:, corner, second] = ends[b, :, second]
                quad[:, corner, third] = ends[c, :, third]
            quads.append(quad)
    return np.concatenate(quads)


def loft(rings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Skin over (M, K, 3) closed rings: ((M-1) K, 4, 3) quads and their smooth corner normals.

    Rings run counter-clockwise seen from the last ring's end.
    """
    following = np.roll(rings, -1, axis=1)
    quads = np.stack([rings[:-1], following[:-1], following[1:], rings[1:]], axis=2)
    flat = face_normals(quads.reshape(-1, 4, 3)).reshape((*quads.shape[:2], 3))
    padded = np.concatenate([flat[:1], flat, flat[-1:]])  # [M + 1, K, 3]
    around = padded[:-1] + padded[1:]
    smooth = around + np.roll(around, 1, axis=1)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=2, keepdims=True), 1e-12)
    after = np.roll(smooth, -1, axis=1)
    normals = np.stack([smooth[:-1], after[:-1], after[1:], smooth[1:]], axis=2)
    return quads.reshape(-1, 4, 3), normals.reshape(-1, 4, 3)


def fan(ring: np.ndarray) -> np.ndarray:
    """(K, 3, 3) triangles that close a convex (K, 3) ring, counter-clockwise from outside."""
    centre = np.broadcast_to(ring.mean(axis=0), ring.shape)
    return np.stack([ring, np.roll(ring, -1, axis=0), centre], axis=1)


def tube(
    start: np.ndarray, end: np.ndarray, radii: tuple[float, float], sides: int = 8
) -> np.ndarray:
    """(2, sides, 3) rings of a tapered tube from `start` to `end`, for `loft`."""
    axis = np.subtract(end, start) / np.linalg.norm(np.subtract(end, start))
    other = np.array([1.0, 0, 0]) if abs(axis[0]) < 0.9 else np.array([0, 1.0, 0])
    first = np.cross(axis, other)
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[:, None]
    circle = np.cos(angle) * first + np.sin(angle) * second
    return np.stack([start + radii[0] * circle, end + radii[1] * circle])


def add_tube(
    builder: MeshBuilder,
    finish: str,
    start: ArrayLike,  # [3]
    end: ArrayLike,  # [3]
    radii: tuple[float, float],
    colour: ArrayLike,  # [3]
    sides: int = 8,
) -> None:
    """Add a closed, smooth-shaded tapered tube."""
    rings = tube(np.array(start, float), np.array(end, float), radii, sides)
    quads, normals = loft(rings)
    builder.quads(finish, quads, colour, normals)
    builder.triangles(finish, fan(rings[1]), colour)
    builder.triangles(finish, fan(rings[0][::-1]), colour)


def icosphere(level: int) -> np.ndarray:
    """(20 * 4**level, 3, 3) triangles of the unit sphere."""
    golden = (1 + 5**0.5) / 2
    flat = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    points = np.array(flat + [(z, x, y) for x, y, z in flat] + [(y, z, x) for x, y, z in flat])
    points = points / np.linalg.norm(points[0])
    index = np.array([(i, j, k) for i in range(12) for j in range(12) for k in range(12)])
    corners = points[index]  # the faces are the triples whose edges are all shortest
    edge = 2 / np.sqrt(golden * golden + 1)
    lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    near = (np.abs(lengths - edge) < 1e-6).all(axis=1)
    outward = np.einsum("ni,ni->n", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) > 0
    first = (index[:, 0] < index[:, 1]) & (index[:, 0] < index[:, 2])
    triangles = corners[near & outward & first]
    for _ in range(level):
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
        triangles /= np.linalg.norm(triangles, axis=2, keepdims=True)
    return triangles

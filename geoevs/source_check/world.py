"""Checks of poses, times, beams and coordinates: what can be told without an image."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera
from geoevs.scenes.camera_json import OPENCV_FROM_OPENGL
from geoevs.scenes.checks import check_exposure, check_rig, check_sensors, timestamp
from geoevs.scenes.scene import NEAR
from geoevs.scenes.sources.conventions import FORWARD_FROM_OPENCV
from geoevs.source_check.findings import NotCheckedError, Sample

FASTEST = 70.0
"""Metres a second of a car at most."""

LONGEST_INTERVAL = 5.0
"""Seconds between frames at most; data sets have 0.1 to 0.5."""

EXPOSURE_APART = 1.0
"""Seconds from a frame's timestamp to one of its exposures at most."""

ALONG = 45.0
"""Degrees from the car's course to its front camera's axis at most."""

STANDING = 0.3
"""Metres on the way of all frames below which nothing tells an ego pose."""

PAIRS = 4
"""Pairs of consecutive frames, spread evenly, whose still points are compared."""

DISAGREE, DISAGREE_DEGREES = 0.3, 0.7
"""Metres and degrees by which the still points of two frames may disagree; right poses have 0.1 m,
and a frame at 10 Hz without its own pose 0.5 m and more."""

FALLING = -0.8
"""Correlation of a point's elevation with its beam, at most, if beams count from the top."""

LIKELY: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "a camera's axes are x forward, y left, z up, and should be OpenCV's": (
        lambda pose: pose @ FORWARD_FROM_OPENCV
    ),
    "a camera's axes are OpenGL's, and should be OpenCV's": lambda pose: pose @ OPENCV_FROM_OPENGL,
    "the poses are camera from world, and should be inverted": np.linalg.inv,
}
"""Mistakes in poses that have no upright world, and what mends them."""


def check_cameras(sample: Sample) -> str:
    """Whether z is up, and cameras look where their names and the car's course say.

    Raises:
        ValueError: one of these is not so.
    """
    for frame in sample.frames:
        cameras = {name: frame.cameras[name] for name in sample.info.cameras}
        try:
            check_rig(sample.info.rig, cameras, f"frame {frame.frame}")
        except GeoEvsError as error:
            raise ValueError(f"{error}{_likely(sample, cameras)}") from error
    told = f"z is up, and {len(sample.info.cameras)} cameras look where their names say"
    way = _way(sample)
    if np.linalg.norm(way) < STANDING:
        return f"{told}; the car stands, so nothing tells front from back"
    front = sample.frames[0].cameras[sample.info.rig.front].optical_axis[:2]
    angle = np.degrees(np.arccos(way @ front / np.linalg.norm(way) / np.linalg.norm(front)))
    if ALONG < angle < 180 - ALONG:
        raise ValueError(
            f"the car drives {angle:.0f} degrees off its front camera's axis; the ego poses may "
            "be inverted, or the camera be another one"
        )
    return f"{told}; the car drives {'backward, ' if angle > 90 else ''}{angle:.0f} degrees off"


def _likely(sample: Sample, cameras: dict[str, Camera]) -> str:
    for words, mended in LIKELY.items():
        try:
            turned = {
                name: Camera(
                    camera.K, mended(camera.world_from_camera), camera.height, camera.width, name
                )
                for name, camera in cameras.items()
            }
            check_rig(sample.info.rig, turned, "")
        except GeoEvsError:
            continue
        return f" (likely: {words})"
    return ""


def _way(sample: Sample) -> np.ndarray:
    """(2,) metres on the ground from the first frame to the last."""
    return (sample.centre(sample.frames[-1]) - sample.centre(sample.frames[0]))[:2]


def check_times(sample: Sample) -> str:
    """Whether frames rise in seconds, exposures lie near them, and the car's speed can be.

    Raises:
        ValueError: one of these is not so.
        NotCheckedError: there is one frame only.
    """
    for frame in sample.frames:
        where = f"frame {frame.frame}"
        for name, exposure in frame.exposures.items():
            apart = check_exposure(exposure, where).time - frame.timestamp
            if abs(apart) > EXPOSURE_APART:
                raise ValueError(
                    f"{where}: camera '{name}' looked {apart:+.3g} s from the frame's timestamp; "
                    "give both in seconds of one clock"
                )
    if len(sample.frames) < 2:
        raise NotCheckedError("there is one frame only")
    seconds = [frame.timestamp for frame in sample.frames]
    for before, frame in zip(seconds, sample.frames[1:], strict=False):
        timestamp(frame.timestamp, f"frame {frame.frame}", before)
    steps = np.diff(seconds)
    centres = np.array([sample.centre(frame) for frame in sample.frames])
    speed = float(np.max(np.linalg.norm(np.diff(centres, axis=0), axis=1) / steps))
    told = f"frames are {np.median(steps):.3g} s apart, and the car drives {speed:.1f} m/s at most"
    if np.median(steps) > LONGEST_INTERVAL or speed > FASTEST:
        raise ValueError(f"{told}; give timestamps in seconds, and ego poses of the same frames")
    return told


def check_origin(sample: Sample) -> str:
    """Whether the scene lies near the world's origin.

    Raises:
        ValueError: it lies further off than float32 holds well.
    """
    frame = sample.frames[0]
    far = float(np.abs(sample.centre(frame)).max())
    if far > NEAR:
        raise ValueError(
            f"the cameras stand {far:,.0f} m from the world's origin; subtract scene_origin(place) "
            "from poses, points and boxes in float64, and give it as SceneInfo.origin"
        )
    if len(frame.points):
        away = np.linalg.norm(frame.points.xyz - sample.centre(frame), axis=1)
        middle = float(np.median(away))
        if middle > 200:
            raise ValueError(
                f"the LiDAR's points lie {middle:,.0f} m from the cameras at the median; put both "
                "into one world, in metres"
            )
    return f"the cameras begin {far:.0f} m from the world's origin"


def check_beams(sample: Sample) -> str:
    """Whether both halves of the LiDAR have points, and beams count from the top.

    Raises:
        ValueError: a half is empty, or elevation does not fall from beam to beam.
        NotCheckedError: there is no LiDAR, or the data name no beams and need none.
    """
    sample.need_points()
    rig = sample.info.rig
    for frame in sample.frames:
        coloured = replace(frame.points, camera=np.zeros_like(frame.points.camera))
        try:
            check_sensors(rig, coloured, f"frame {frame.frame}")
        except GeoEvsError as error:
            raise ValueError(str(error)) from error
    share = np.mean([rig.scores(frame.points).mean() for frame in sample.frames])
    told = f"{share:.0%} of the points score methods, the others may condition them"
    if not any(frame.points.beam.any() for frame in sample.frames):
        if rig.lidar_split == "beam":
            raise ValueError("all points are of beam 0; take beams_by_elevation")
        raise NotCheckedError(f"the data name no beams, and the split needs none; {told}")
    falls = {sensor: _fall(sample, sensor) for sensor in _sensors(sample)}
    known = {sensor: fall for sensor, fall in falls.items() if fall is not None}
    for sensor, fall in known.items():
        if fall > FALLING:
            cause = "count them from the top" if fall > 0.5 else "they are no rows of one LiDAR"
            raise ValueError(
                f"elevation and beam of sensor {sensor} have a correlation of {fall:+.2f}, and "
                f"should have -1; {cause}"
            )
    if not known:
        raise NotCheckedError(f"too few points lie 5 m off to tell their beams' order; {told}")
    worst = max(known.values())
    return f"elevation falls with the beam (correlation {worst:+.2f}); {told}"


def _sensors(sample: Sample) -> list[int]:
    return sorted({int(s) for f in sample.frames for s in np.unique(f.points.sensor)})


def _fall(sample: Sample, sensor: int) -> float | None:
    """Rank correlation of the beams of a LiDAR with the median elevation of their points."""
    frame = max(sample.frames, key=lambda frame: (frame.points.sensor == sensor).sum())
    points = frame.points.select(frame.points.sensor == sensor)
    away = points.xyz - sample.centre(frame)
    flat = np.hypot(away[:, 0], away[:, 1])
    elevation = np.arctan2(away[:, 2], flat)
    medians = [
        float(np.median(elevation[chosen]))
        for beam in np.unique(points.beam)
        if (chosen := (points.beam == beam) & (flat > 5)).sum() >= 5
    ]
    if len(medians) < 4:
        return None
    ranks = np.argsort(np.argsort(medians))
    return float(np.corrcoef(np.arange(len(medians)), ranks)[0, 1])


def check_ego_pose(sample: Sample) -> str:
    """Whether what stands still lies at one place of the world in consecutive frames.

    Raises:
        ValueError: it lies at two, by a distance that the sentence names.
        NotCheckedError: there is no LiDAR, one frame only, or the car stands.
    """
    sample.need_points()
    if len(sample.frames) < 2:
        raise NotCheckedError("there is one frame only")
    pairs = list(pairwise(sample.frames))
    moved = [
        disagreement(sample.still_points(one), sample.still_points(other), sample.centre(other))
        for one, other in pairs[:: -(-len(pairs) // PAIRS)]
    ]
    metres, degrees = np.median(np.array(moved), axis=0)
    told = f"still points of consecutive frames agree within {metres:.2f} m, {degrees:.2f} degrees"
    if metres > DISAGREE or degrees > DISAGREE_DEGREES:
        raise ValueError(
            f"{told.replace('agree within', 'lie apart by')}; take each frame's own ego pose, "
            "world from vehicle, of the instant of its sweep"
        )
    path = sum(
        float(np.linalg.norm(sample.centre(other) - sample.centre(one))) for one, other in pairs
    )
    if path < STANDING:
        raise NotCheckedError(f"the car stands, so any ego pose would do; {told}")
    return told


def disagreement(
    target: np.ndarray,  # [N, 3]
    source: np.ndarray,  # [M, 3]
    centre: np.ndarray,  # [3]
) -> tuple[float, float]:
    """How far points must move to lie on the surfaces of others.

    Iterated closest points, from point to plane (Chen and Medioni, 1992). Directions in which
    nothing holds the points, such as along a plain wall, are left as they are.

    Args:
        target: metres; what surfaces are fitted to.
        source: metres; what is moved.
        centre: about which turns are measured.

    Returns:
        Metres at the centre, and degrees.
    """
    target, source = _thinned(target - centre), _thinned(source - centre)
    if min(len(target), len(source)) < 100:
        return 0.0, 0.0
    tree = cKDTree(target)
    normals, flat = _normals(target, tree)
    rotation, shift = np.eye(3), np.zeros(3)
    for reach in (3.0, 3.0, 2.0, 2.0, 1.5, 1.5, 1.0, 1.0, 0.7, 0.7, 0.5, 0.5):
        moved = source @ rotation.T + shift
        distance, index = tree.query(moved, distance_upper_bound=reach)
        kept = np.flatnonzero(np.isfinite(distance))
        kept = kept[flat[index[kept]]]
        if len(kept) < 50:
            break
        plane, place = normals[index[kept]], moved[kept]
        residual = np.einsum("ij,ij->i", target[index[kept]] - place, plane)
        rows = np.hstack([np.cross(place, plane), plane])
        step = np.linalg.lstsq(rows, residual, rcond=0.02)[0]
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        rotation, shift = turn @ rotation, turn @ shift + step[3:]
    angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    return float(np.linalg.norm(shift)), float(angle)


def _thinned(points: np.ndarray) -> np.ndarray:
    """At most some thousand of the points within 50 m, one in each cube of 0.3 m."""
    near = points[np.linalg.norm(points, axis=1) < 50]
    _, first = np.unique(np.floor(near / 0.3).astype(np.int64), axis=0, return_index=True)
    kept = near[np.sort(first)]
    return kept[:: max(len(kept) // 8000, 1)]


def _normals(points: np.ndarray, tree: cKDTree) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) unit normals of the points' neighbourhoods, and (N,) bool whether those are flat."""
    around = points[tree.query(points, 12)[1]]
    away = around - around.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", away, away))
    return vectors[:, :, 0], values[:, 0] < 0.1 * values[:, 1]

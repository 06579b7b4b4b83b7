"""Checks of boxes against LiDAR points and against their own course."""

from collections.abc import Callable

import numpy as np
import pandas as pd

from geoevs.scenes.boxes import Box
from geoevs.source_check.findings import NotCheckedError, Sample

FEWEST = 200
"""Points near boxes from which their counts say anything."""

NEARBY = 1.0
"""Metres around a box in which points are looked for."""

BETTER = 1.1
"""How many times as many points boxes must hold to be taken for the right ones."""

GROUND = 0.3
"""Metres from a box's lower face up to which points may be the road's."""

OBLONG = 1.3
"""Length by width from which a box turned by 90 degrees is another one."""

DRIVEN = 2.0
"""Metres that a track moves while it is seen, from which its course is known."""

COURSE_ERROR = 20.0
"""Degrees from the yaw to the course at the median, at most; PandaSet has 1.5."""

MARGIN = 0.1
"""Metres beyond a face in which a point still counts as held."""

OTHERWISE: dict[str, Callable[[Box], Box]] = {
    "with length and width exchanged": lambda box: box._replace(length=box.width, width=box.length),
    "with yaw taken for radians": lambda box: box._replace(yaw=float(np.degrees(box.yaw))),
    "with the yaw's sign changed": lambda box: box._replace(yaw=-box.yaw),
    "raised by half their height, as if z were their lower face's": (
        lambda box: box._replace(z=box.z + box.height / 2)
    ),
}
"""What a source may have got wrong, and the boxes as they would then be right."""


def check_held(sample: Sample) -> str:
    """Whether boxes hold the points beside them, and fewer if they were otherwise.

    Raises:
        ValueError: they hold none, or hold more if a convention is changed.
        NotCheckedError: there is no LiDAR, or there are no boxes near points.
    """
    sample.need_points()
    _need_boxes(sample)
    held, near, otherwise = 0, 0, dict.fromkeys(OTHERWISE, 0)
    for frame in sample.frames:
        for box in sample.boxes(frame):
            points = _around(frame.points.xyz, box)
            near += len(points)
            held += box.holds(points, MARGIN).sum()
            for words, change in OTHERWISE.items():
                otherwise[words] += change(box).holds(points, MARGIN).sum()
    if near < FEWEST:
        raise NotCheckedError(f"{near} LiDAR points lie near boxes, too few to tell")
    told = f"boxes hold {held / near:.0%} of {near:,} points in and around them"
    best = max(otherwise, key=lambda words: otherwise[words])
    if otherwise[best] > BETTER * held:
        raise ValueError(
            f"{told}, and {otherwise[best] / near:.0%} {best}; correct it in the boxes"
        )
    if held < 0.3 * near:
        raise ValueError(
            f"{told}, where most are expected; their frame, their instant or their centre is wrong"
        )
    return f"{told}; {_oblong(sample, otherwise, near)}"


def _oblong(sample: Sample, otherwise: dict[str, int], near: int) -> str:
    tracks = sample.tracks
    if not (tracks["length"] > OBLONG * tracks["width"]).any():
        return "none is oblong, so nothing tells length from width"
    words = next(iter(OTHERWISE))
    return f"{otherwise[words] / near:.0%} {words}"


def _around(xyz: np.ndarray, box: Box) -> np.ndarray:
    """(N, 3) points in and around an upright box, the road's left out."""
    across = np.hypot(box.length, box.width) / 2 + NEARBY
    dx, dy, dz = (xyz - np.array([box.x, box.y, box.z])).T
    # One column of space for all that a box may be taken for, so that counts compare.
    high = (dz > GROUND - box.height / 2) & (dz < box.height)
    return xyz[high & (np.hypot(dx, dy) < across)].astype(np.float64)


def check_course(sample: Sample) -> str:
    """Whether tracks that drive head along their course, and are marked as moving.

    Raises:
        ValueError: they head elsewhere, or what drives is marked as standing.
        NotCheckedError: there are no boxes, or nothing drives.
    """
    _need_boxes(sample)
    ends = sample.tracks.sort_values("frame").groupby("track").agg(["first", "last"])
    way = pd.DataFrame({axis: ends[axis]["last"] - ends[axis]["first"] for axis in "xy"})
    driven = np.hypot(way["x"], way["y"]) > DRIVEN
    if not driven.any():
        raise NotCheckedError(f"no track moves {DRIVEN:g} m while it is seen")
    course = np.degrees(np.arctan2(way["y"], way["x"]))[driven]
    error = (_mean_yaw(ends)[driven] - course + 180) % 360 - 180
    typical = float(np.abs(error).median())
    told = f"{driven.sum()} tracks drive, {typical:.0f} degrees from where they head at the median"
    if typical > COURSE_ERROR:
        raise ValueError(f"{told}; {_likely(float(error.median()), typical)}")
    marked = ends["moving"]["first"].astype(bool)[driven]
    if marked.mean() < 0.5:
        raise ValueError(
            f"{told}, but {(~marked).sum()} of them are not marked as moving; call mark_moving, "
            "or the ego poses are wrong"
        )
    return told


def _mean_yaw(ends: pd.DataFrame) -> pd.Series:
    """Half-way from the first yaw to the last, for what turns."""
    first, last = ends["yaw"]["first"], ends["yaw"]["last"]
    return first + ((last - first + 180) % 360 - 180) / 2


def _likely(error: float, typical: float) -> str:
    if typical > 180 - COURSE_ERROR:
        return "yaw points backward, so turn it by 180 degrees"
    if abs(typical - 90) < COURSE_ERROR:
        return f"yaw is {error:+.0f} degrees off, so it is another axis's, or y is x"
    return "yaw may be in radians, have the other sign, or be in the vehicle's frame"


def _need_boxes(sample: Sample) -> None:
    frames = [frame.frame for frame in sample.frames]
    if not sample.tracks["frame"].isin(frames).any():
        raise NotCheckedError("there are no boxes in these frames")

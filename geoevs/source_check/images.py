"""Checks of cameras and LiDAR against the images: extrinsics, exchanged images, half a pixel."""

from itertools import combinations

import numpy as np

from geoevs.projection import zbuffer
from geoevs.scenes.scene import Rig
from geoevs.source_check.edges import Profile, measure, pooled, symmetric_shift
from geoevs.source_check.findings import NotCheckedError, Sample

FEWEST = 100
"""Outlines, at whose ends and beginnings each, from which a mean says anything."""

FARTHEST = 1 / 8
"""Widths of the image up to which another place for the outlines is looked for."""

NEAR = 0.025
"""Widths of the image within which outlines count as met: parallax and clocks move them."""

CONTRAST = 1.1
"""How much stronger the images' edges are at the LiDAR's outlines than elsewhere, at least; a wrong
pose gives 1, PandaSet 1.2 to 1.4 and streets 1.7."""

HALF_PIXEL_REACH, HALF_PIXEL_MOST = 6.0, 2.0
"""Pixels of the profile, and of shift that is tried, where half a pixel is looked for."""

SHIFT_ALLOWED = 0.25
"""Pixels: half of the error that is looked for."""

LEAST_SUPPORT = 0.001
"""Share of an image's pixels that hold a LiDAR point, at least, in the camera that sees most."""


def check_support(sample: Sample) -> str:
    """How many pixels of the images hold a point.

    Raises:
        ValueError: so few that the LiDAR and the cameras cannot stand on one car.
        NotCheckedError: there is no LiDAR.
    """
    sample.need_points()
    shares = {
        name: float(
            np.mean([zbuffer(f.points.xyz, f.cameras[name]).mask.mean() for f in sample.frames[:3]])
        )
        for name in sample.info.cameras
    }
    told = ", ".join(f"{name} {share:.3f}" for name, share in shares.items())
    if max(shares.values()) < LEAST_SUPPORT:
        raise ValueError(
            f"no image sees the LiDAR's points ({told}); the extrinsics may be inverted, or points "
            "be in the LiDAR's own frame"
        )
    return f"share of pixels with a point: {told}"


def check_edges(sample: Sample) -> str:
    """Whether LiDAR outlines lie nearer to image edges where they are than if they were moved.

    Raises:
        ValueError: other places fit better, or all places alike.
        NotCheckedError: there is no LiDAR, or too few outlines.
    """
    sample.need_points()
    said = []
    for axis, words in enumerate(("across", "down")):
        width = _width(sample)
        shifts = np.linspace(-FARTHEST, FARTHEST, 65) * width
        profile = pooled([measure(sample.frames, n, n, axis, shifts) for n in sample.info.cameras])
        if sum(profile.counts) < FEWEST:
            continue
        strength = profile.both
        here = np.abs(shifts) <= max(NEAR * width, 2)
        contrast, best = strength[here].max() / strength.mean(), shifts[strength.argmax()]
        if not here[strength.argmax()] and strength.max() > CONTRAST * strength[here].max():
            raise ValueError(
                f"{sum(profile.counts)} LiDAR outlines meet the images' edges if moved "
                f"{best:+.0f} pixels {words}; correct the extrinsics, K or the images' size, or "
                "the poses of cameras and LiDAR are of two instants"
            )
        if contrast < CONTRAST:
            raise ValueError(
                f"the images' edges are {contrast:.2f} times as strong at {sum(profile.counts)} "
                f"LiDAR outlines as elsewhere, where more than {CONTRAST:g} is expected; correct "
                "the extrinsics, the axes, or which image belongs to which camera and frame"
            )
        said.append(f"{contrast:.2f} times {words} ({sum(profile.counts)} outlines)")
    if not said:
        raise NotCheckedError("the LiDAR sees too few outlines; read more frames")
    return f"edges at the LiDAR's outlines are stronger than elsewhere: {', '.join(said)}"


def check_exchanged(sample: Sample) -> str:
    """Whether the images of a camera of the left and its twin of the right are exchanged.

    Raises:
        ValueError: exchanged they fit the LiDAR better.
        NotCheckedError: there is no LiDAR, no such pair, or too few outlines.
    """
    sample.need_points()
    said = []
    for left, right in _twins(sample.info.rig, sample.info.cameras):
        if sample.frames[0].images[left].shape != sample.frames[0].images[right].shape:
            continue
        own = _at_outlines(sample, (left, left), (right, right))
        crossed = _at_outlines(sample, (left, right), (right, left))
        if own is None or crossed is None:
            continue
        if crossed > CONTRAST * own:
            raise ValueError(
                f"the images of '{left}' fit the LiDAR as '{right}' sees it, and the other way "
                "round; exchange the images, or the calibrations"
            )
        said.append(f"{left} and {right}")
    if not said:
        raise NotCheckedError("no pair of cameras, left and right, sees enough LiDAR outlines")
    return f"each image fits its own camera: {'; '.join(said)}"


def check_half_pixel(sample: Sample) -> str:
    """Whether outlines and edges differ by half a pixel across, all cameras together.

    Raises:
        ValueError: they do, by more than twice the error of the measurement.
        NotCheckedError: there is no LiDAR, or the error is too large to tell.
    """
    sample.need_points()
    steps = round(HALF_PIXEL_REACH / 0.25)
    shifts = np.arange(-steps, steps + 1) * 0.25
    profiles = [measure(sample.frames, name, name, 0, shifts) for name in sample.info.cameras]
    seen = [profile for profile in profiles if min(profile.counts) > 0]
    if len(seen) < 2 or min(pooled(seen).counts) < FEWEST:
        raise NotCheckedError(
            "too few LiDAR outlines in two cameras or more to tell half a pixel; read more frames"
        )
    shift, error = _jackknifed(seen)
    told = f"edges lie {shift:+.2f} pixels right of the LiDAR's outlines, give or take {error:.2f}"
    if abs(shift) - 2 * error > SHIFT_ALLOWED:
        raise ValueError(
            f"{told}; the centre of the first pixel is (0.5, 0.5) here, and (0, 0) in OpenCV's K: "
            "add 0.5 to cx and cy, or leave out what was added"
        )
    if abs(shift) + 2 * error > 2 * SHIFT_ALLOWED:
        raise NotCheckedError(
            f"{told}, which cannot tell half a pixel; read more frames, or larger images"
        )
    return told


def _jackknifed(profiles: list[Profile]) -> tuple[float, float]:
    """The symmetric shift of all, and its standard error from leaving out one camera each."""
    every = symmetric_shift(pooled(profiles), HALF_PIXEL_MOST)
    left_out = [
        symmetric_shift(pooled([*profiles[:k], *profiles[k + 1 :]]), HALF_PIXEL_MOST)
        for k in range(len(profiles))
    ]
    return every, float(np.sqrt((len(profiles) - 1) * np.var(left_out)))


def _width(sample: Sample) -> int:
    return max(camera.width for camera in sample.frames[0].cameras.values())


def _twins(rig: Rig, cameras: tuple[str, ...]) -> list[tuple[str, str]]:
    """Pairs of a left and a right camera: the rig's, and those called alike."""
    called = [
        (one, other)
        for one, other in combinations(cameras, 2)
        if one.replace("left", "right") == other or one.replace("right", "left") == other
    ]
    return list(dict.fromkeys([(rig.front_left, rig.front_right), *called]))


def _at_outlines(sample: Sample, *pairs: tuple[str, str]) -> float | None:
    """Edge strength at outlines beside that further off; None of too few outlines."""
    shifts = np.linspace(-FARTHEST, FARTHEST, 33) * _width(sample)
    profile = pooled([measure(sample.frames, *pair, 0, shifts) for pair in pairs])
    if sum(profile.counts) < FEWEST:
        return None
    here = np.abs(shifts) <= max(NEAR * _width(sample), 2)
    return float(profile.both[here].max() / profile.both.mean())

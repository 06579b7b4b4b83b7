"""The conventions of a scene as named checks, run on what a source hands over; nothing is kept."""

import traceback
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.images import write_image
from geoevs.core.text import clean
from geoevs.scenes.checks import check_info, check_tracks, checked_points, frame_number
from geoevs.scenes.extras import check_extras
from geoevs.scenes.scene import Frame, SceneInfo, SceneRef, load_source
from geoevs.source_check.boxes import check_course, check_held
from geoevs.source_check.findings import (
    NOT_CHECKED,
    OK,
    WRONG,
    Finding,
    NotCheckedError,
    Sample,
)
from geoevs.source_check.images import (
    check_edges,
    check_exchanged,
    check_half_pixel,
    check_support,
)
from geoevs.source_check.pictures import overlay
from geoevs.source_check.world import (
    check_beams,
    check_cameras,
    check_ego_pose,
    check_origin,
    check_times,
)

FRAMES = 12
"""Frames of a scene that are looked at, from its first."""

CHECKS: dict[str, Callable[[Sample], str]] = {
    "cameras": check_cameras,
    "times": check_times,
    "origin": check_origin,
    "beams": check_beams,
    "support": check_support,
    "ego pose": check_ego_pose,
    "edges": check_edges,
    "sides": check_exchanged,
    "half a pixel": check_half_pixel,
    "boxes hold points": check_held,
    "boxes head along": check_course,
}
READING = "reading"
"""The check that all others need."""


def check_source(
    name: str,
    scene: str,
    options: dict[str, Any],
    height: int,
    width: int,
    frames: int = FRAMES,
) -> tuple[list[Finding], Sample | None]:
    """Run every check on the first frames of a scene, without writing anything.

    Args:
        name: the data source.
        scene: of it, as a config names it.
        options: the source's.
        height: of the images, pixels.
        width: likewise.
        frames: how many are read at most.

    Returns:
        One finding a check, and what was read; None if nothing could be.

    Raises:
        GeoEvsError: there is no such source, or an option is wrong.
    """
    source = load_source(name, height, width, options)
    ref = SceneRef.parse(scene)
    try:
        source.check(ref)
        list(source.files(ref))
        record = source.open(ref)
        check_info(record.info, "the scene")
        check_tracks(record.tracks, "the scene")
        read = list(islice(_whole(record.info, record.frames), frames))
        if not read:
            raise GeoEvsError("the scene has no frames; check its frame range")
        sizes = {camera: image.shape[:2] for camera, image in read[0].images.items()}
        check_extras(record.extras, sizes, "the scene")
    except Exception as error:  # a stranger's code fails in any way
        return [Finding(READING, WRONG, f"{reason_of(error)}{_place(error)}")], None
    sample = Sample(record.info, record.tracks, record.extras, read)
    points = np.mean([len(frame.points) for frame in read])
    told = f"{len(read)} frames of {len(record.info.cameras)} cameras, {points:,.0f} points each"
    findings = [_run(title, check, sample) for title, check in CHECKS.items()]
    return [Finding(READING, OK, told), *findings], sample


def _whole(info: SceneInfo, frames: Iterable[Frame]) -> Iterable[Frame]:
    """The frames, each after a look at whether all is there and of the right type."""
    for frame in frames:
        where = f"frame {frame_number(frame.frame, 'the scene')}"
        for name in info.cameras:
            if name not in frame.cameras or name not in frame.images:
                raise GeoEvsError(f"{where} has no camera '{name}'; supply it")
            camera, image = frame.cameras[name], frame.images[name]
            if image.shape != (camera.height, camera.width, 3) or image.dtype != np.uint8:
                raise GeoEvsError(
                    f"{where}: the image of camera '{name}' is {image.dtype} of shape "
                    f"{image.shape}; give uint8 of shape {(camera.height, camera.width, 3)}"
                )
        checked_points(frame.points, len(info.cameras), where)
        yield frame


def _run(title: str, check: Callable[[Sample], str], sample: Sample) -> Finding:
    try:
        return Finding(title, OK, check(sample))
    except NotCheckedError as reason:
        return Finding(title, NOT_CHECKED, str(reason))
    except (ValueError, GeoEvsError) as wrong:
        return Finding(title, WRONG, str(wrong))


def _place(error: Exception) -> str:
    """Where a source's own code failed; nothing for a sentence, which says so itself."""
    if isinstance(error, GeoEvsError):
        return ""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f" (at {clean(Path(last.filename).name, 60)}:{last.lineno})"


def write_overlays(sample: Sample, folder: Path) -> list[Path]:
    """Draw points and boxes of the first frame over each of its images, as `<camera>.png`."""
    frame = sample.frames[0]
    paths = []
    for name in sample.info.cameras:
        picture = overlay(
            frame.images[name], frame.cameras[name], frame.points.xyz, sample.boxes(frame)
        )
        paths.append(folder / f"{name}.png")
        write_image(paths[-1], picture)
    return paths

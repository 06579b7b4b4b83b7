"""What detectors are shown besides recorded views: poses between cameras, and the rig moved aside.

Entrants render them from a store without boxes, since boxes are the labels.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path
from typing import Annotated

import pandas as pd

from geoevs.core.files import link_file, new_folder, write_bytes
from geoevs.core.settings import Within
from geoevs.protocol.targets import ALL_CAMERAS, SHIFTS, Target, check_distinct
from geoevs.scenes.camera import Camera, angle_between
from geoevs.scenes.extras import SYNCED
from geoevs.scenes.scene import TRACK_COLUMNS
from geoevs.scenes.store import Scene
from geoevs.scenes.virtual import left_of, virtual_camera, yaw_gap

BETWEEN, OFFSET = "detection", "rig-offset"
"""Splits: views between neighbouring cameras, and those of the whole rig moved aside."""

WIDEST_GAP = 120.0
"""Degrees of yaw between neighbours that have views between them. The open end of a rig that looks
ahead alone is wider: 180 degrees of Waymo's."""

Shift = Annotated[float, Within(*SHIFTS)]


@dataclass(frozen=True)
class ViewSettings:
    """Which views are generated for detectors; the config's section `detection.views`.

    Args:
        shares: of the way between neighbouring cameras, at each of which there are views.
        lateral: their shifts across the ego heading, metres, left positive.
    """

    shares: tuple[Annotated[float, Within(0.001, 0.999)], ...] = (0.167, 0.333, 0.5, 0.667, 0.833)
    lateral: tuple[Shift, ...] = (-1.0, 1.0)


def views_between(scene: Scene, settings: ViewSettings) -> list[Target]:
    """The targets of split BETWEEN: each gap between neighbours, each share, each shift.

    Paper section 4.6 has 40 generated views for the five cameras of Waymo, and does not say where.
    The four gaps between neighbours, five shares and two shifts make as many. All cameras of a rig
    count, by yaw: a full ring of six has six gaps, and so 60 views. Intrinsics, pitch and roll are
    those of the neighbour nearer to the front.

    Raises:
        GeoEvsError: two neighbours look the same way, or two targets have one name.
    """
    targets = []
    for frame in scene.frames:
        front = scene.camera(scene.info.rig.front, frame)
        cameras = [scene.camera(name, frame) for name in scene.cameras]
        for near, far in _neighbours(front, cameras):
            gap = abs(yaw_gap(near, far))
            for share, shift in product(settings.shares, settings.lateral):
                name = f"{near.name}-{far.name}-{share:g}{shift:+g}m"
                camera = virtual_camera(near, far, share * gap, shift, name, front)
                targets.append(_target(BETWEEN, frame, camera, front, shift))
    check_distinct([target.key for target in targets], f"scene '{scene.info.name}'")
    return targets


def _neighbours(front: Camera, cameras: Sequence[Camera]) -> Iterator[tuple[Camera, Camera]]:
    """Pairs of cameras next to each other by yaw, the one nearer to the front first."""
    ordered = sorted(cameras, key=lambda camera: yaw_gap(front, camera))
    for right, left in [*pairwise(ordered), (ordered[-1], ordered[0])]:
        gap = (yaw_gap(front, left) - yaw_gap(front, right)) % 360
        if len(ordered) > 1 and gap <= WIDEST_GAP:
            pair = sorted((left, right), key=lambda camera: abs(yaw_gap(front, camera)))
            yield pair[0], pair[1]


def moved_rig(scene: Scene, offsets: Sequence[float]) -> list[Target]:
    """The targets of split OFFSET: all recorded cameras, moved across the ego heading.

    Args:
        scene: the store.
        offsets: metres to the left.
    """
    targets = []
    for frame in scene.frames:
        front = scene.camera(scene.info.rig.front, frame)
        for offset, name in product(offsets, scene.cameras):
            recorded = scene.camera(name, frame)
            pose = recorded.world_from_camera.copy()
            pose[:3, 3] += offset * left_of(front)
            camera = replace(recorded, world_from_camera=pose, name=moved_name(name, offset))
            targets.append(_target(OFFSET, frame, camera, front, offset))
    check_distinct([target.key for target in targets], f"scene '{scene.info.name}'")
    return targets


def moved_name(camera: str, offset: float) -> str:
    """What a recorded camera is called when the rig is moved aside.

    >>> moved_name("front", -2.0)
    'front-2m'
    """
    return f"{camera}{offset:+g}m"


def _target(split: str, frame: int, camera: Camera, front: Camera, shift: float) -> Target:
    offset = angle_between(camera.optical_axis, front.optical_axis)
    return Target(split, frame, camera, ALL_CAMERAS, offset, shift)


def write_without_boxes(folder: Path, scene: Scene) -> None:
    """Write the store of a scene without its boxes, whole or not at all; files are linked.

    Raises:
        GeoEvsError: nothing can be written.
    """
    tracks = "tracks.parquet"
    with new_folder(folder) as partial:
        for path in sorted(scene.folder.rglob("*")):
            if path.is_file() and path.name not in (tracks, SYNCED):
                link_file(path, partial / path.relative_to(scene.folder))
        none: pd.DataFrame = scene.tracks[list(TRACK_COLUMNS)][:0]
        write_bytes(partial / tracks, none.to_parquet(index=False))

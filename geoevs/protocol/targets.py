"""Target poses of every split, and the sources each one allows (paper sections 4.1 to 4.4)."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from geoevs.errors import GeoEvsError, did_you_mean
from geoevs.io import read_json, write_json
from geoevs.scenes.camera import Camera, angle_between
from geoevs.scenes.store import Scene, camera_from_json, camera_to_json
from geoevs.scenes.virtual import virtual_camera, yaw_gap

ALL_CAMERAS = "all-cameras"
FRONT_SIDE = "front-side"
RECORDED_SPLITS = ("observed", "interpolation")
"""Splits whose targets a camera recorded, so that its image is dense truth."""


@dataclass(frozen=True)
class Target:
    """One view to synthesise.

    Args:
        split: `observed`, `interpolation`, `extrapolation` or `pose-sweep`.
        frame: the instant.
        camera: its calibration; `camera.name` names the target within the frame.
        sources: the set of source cameras, ALL_CAMERAS or FRONT_SIDE.
        pose_offset: angle in degrees between its optical axis and the front camera's.
        lateral_shift: metres to the left, along the horizontal normal of the ego heading.
    """

    split: str
    frame: int
    camera: Camera
    sources: str
    pose_offset: float
    lateral_shift: float

    @property
    def key(self) -> str:
        """Name of the target within its scene, usable as a path: `<camera>/<frame>`."""
        return f"{self.camera.name}/{self.frame:06d}"

    @property
    def recorded(self) -> bool:
        """Whether a camera recorded this view (see RECORDED_SPLITS)."""
        return self.split in RECORDED_SPLITS


def source_cameras(scene: Scene, sources: str) -> tuple[str, ...]:
    """The cameras in a set of sources, in the scene's order.

    Raises:
        GeoEvsError: there is no such set; a misspelt one must not show a method every camera.
    """
    if sources == ALL_CAMERAS:
        return scene.cameras
    if sources == FRONT_SIDE:
        sides = (scene.info.rig.front_left, scene.info.rig.front_right)
        return tuple(name for name in scene.cameras if name in sides)
    hint = did_you_mean(sources, (ALL_CAMERAS, FRONT_SIDE))
    raise GeoEvsError(f"there is no set of sources '{sources}'; {hint}")


def make_targets(scene: Scene, protocol: dict) -> list[Target]:
    """Every target of a scene under the config's `protocol` section, in a fixed order."""
    rig = scene.info.rig
    targets: list[Target] = []
    for position, frame in enumerate(scene.frames):
        front = scene.camera(rig.front, frame)
        sides = {
            "left": scene.camera(rig.front_left, frame),
            "right": scene.camera(rig.front_right, frame),
        }
        for name in scene.cameras:
            camera = scene.camera(name, frame)
            offset = angle_between(camera.optical_axis, front.optical_axis)
            targets.append(Target("observed", frame, camera, ALL_CAMERAS, offset, 0.0))
        targets.append(Target("interpolation", frame, _renamed(front), FRONT_SIDE, 0.0, 0.0))
        targets += _extrapolation(front, sides, frame, protocol["lateral"])
        if position % protocol["pose_sweep"]["every"] == 0:
            targets += _pose_sweep(front, sides, frame, protocol)
    return targets


def _renamed(front: Camera) -> Camera:
    return Camera(
        front.K, front.world_from_camera, front.height, front.width, f"interpolation-{front.name}"
    )


def _extrapolation(
    front: Camera, sides: dict[str, Camera], frame: int, shifts: list[float]
) -> Iterator[Target]:
    for side, camera in sides.items():
        half = abs(yaw_gap(front, camera)) / 2
        for shift in shifts:
            name = f"extrapolation-{side}{shift:+g}m"
            virtual = virtual_camera(front, camera, half, shift, name)
            yield _virtual_target("extrapolation", frame, virtual, front, shift)


def _pose_sweep(
    front: Camera, sides: dict[str, Camera], frame: int, protocol: dict
) -> Iterator[Target]:
    for angle in protocol["pose_sweep"]["angles"]:
        for side, camera in sides.items():
            for shift in protocol["lateral"]:
                name = f"pose-sweep-{side}{angle:g}deg{shift:+g}m"
                virtual = virtual_camera(front, camera, angle, shift, name)
                yield _virtual_target("pose-sweep", frame, virtual, front, shift)


def _virtual_target(split: str, frame: int, camera: Camera, front: Camera, shift: float) -> Target:
    offset = angle_between(camera.optical_axis, front.optical_axis)
    return Target(split, frame, camera, ALL_CAMERAS, offset, shift)


def write_targets(path: Path, targets: list[Target]) -> None:
    """Write targets as JSON, cameras in nerfstudio's fields, whole or not at all."""
    entries = [
        {
            "split": target.split,
            "frame": target.frame,
            "name": target.camera.name,
            "sources": target.sources,
            "pose_offset": target.pose_offset,
            "lateral_shift": target.lateral_shift,
            **camera_to_json(target.camera),
        }
        for target in targets
    ]
    write_json(path, entries)


def read_targets(path: Path) -> list[Target]:
    """Read what `write_targets` wrote.

    Raises:
        GeoEvsError: the file is missing or not a target list.
    """
    try:
        return [
            Target(
                entry["split"],
                entry["frame"],
                camera_from_json(entry, entry["name"], path),
                entry["sources"],
                entry["pose_offset"],
                entry["lateral_shift"],
            )
            for entry in read_json(path)
        ]
    except (KeyError, TypeError) as error:
        raise GeoEvsError(
            f"{path} is no target list ({error}); delete it and make it again"
        ) from error

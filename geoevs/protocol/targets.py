"""Target poses of every split, and the sources each one allows (paper sections 4.1 to 4.4)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.files import read_json, write_json
from geoevs.core.randomness import Rng
from geoevs.core.stamps import MADE_WITH, NOTHING, Stamp
from geoevs.scenes.camera import Camera, angle_between, view_key
from geoevs.scenes.store import Scene, camera_from_json, camera_to_json
from geoevs.scenes.virtual import virtual_camera, yaw_gap

ALL_CAMERAS = "all-cameras"
FRONT_SIDE = "front-side"
MASKED = "masked-"
"""Prefix of the split and of the camera name of a masked target. Behind it stand those of the
target whose view it shares."""

RECORDED_SPLITS = ("observed", "interpolation", f"{MASKED}observed")
"""Splits whose targets a camera recorded, so that its image is dense truth."""


@dataclass(frozen=True)
class Target:
    """One view to synthesise.

    Args:
        split: `observed`, `interpolation`, `extrapolation`, `pose-sweep`, `masked-observed` or
            `masked-extrapolation`.
        frame: the instant.
        camera: its calibration; `camera.name` names the target within the frame.
        sources: the set of source cameras, ALL_CAMERAS or FRONT_SIDE.
        pose_offset: angle in degrees between its optical axis and the front camera's.
        lateral_shift: metres to the left, along the horizontal normal of the ego heading.
        mask_camera: of masked targets, the virtual camera whose validity mask degrades the
            condition map (section 3.4); its name says the pose.
    """

    split: str
    frame: int
    camera: Camera
    sources: str
    pose_offset: float
    lateral_shift: float
    mask_camera: Camera | None = None

    @property
    def key(self) -> str:
        """Name of the target within its scene, usable as a path (see `view_key`)."""
        return view_key(self.camera.name, self.frame)

    @property
    def recorded(self) -> bool:
        """Whether a camera recorded this view (see RECORDED_SPLITS)."""
        return self.split in RECORDED_SPLITS

    @property
    def masked(self) -> bool:
        """Whether methods render it from a degraded condition map."""
        return self.mask_camera is not None

    @property
    def unmasked(self) -> "Target":
        """The target whose view, truth and reference this one shares; itself if not masked."""
        if not self.masked:
            return self
        camera = replace(self.camera, name=self.camera.name.removeprefix(MASKED))
        split = self.split.removeprefix(MASKED)
        return replace(self, split=split, camera=camera, mask_camera=None)


def virtual_targets(targets: Sequence[Target]) -> list[Target]:
    """The targets that no camera recorded; masked ones share the view of another and are left out.

    These are the ones that have a sparse reference, and truth that must be rendered.
    """
    return [target for target in targets if not target.recorded and not target.masked]


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


def make_targets(scene: Scene, protocol: dict, seed: int) -> list[Target]:
    """Every target of a scene under the config's `protocol` section, in a fixed order.

    The seed draws which virtual pose masks which target.
    """
    rig = scene.info.rig
    targets: list[Target] = []
    for position, frame in enumerate(scene.frames):
        front = scene.camera(rig.front, frame)
        sides = {
            "left": scene.camera(rig.front_left, frame),
            "right": scene.camera(rig.front_right, frame),
        }
        cameras = [scene.camera(name, frame) for name in scene.cameras]
        observed = [_target("observed", frame, camera, front, 0.0) for camera in cameras]
        renamed = replace(front, name=f"interpolation-{front.name}")
        interpolation = Target("interpolation", frame, renamed, FRONT_SIDE, 0.0, 0.0)
        extrapolation = list(_extrapolation(front, sides, frame, protocol["lateral"]))
        targets += [*observed, interpolation, *extrapolation]
        if position % protocol["pose_sweep"]["every"] == 0:
            targets += _pose_sweep(front, sides, frame, protocol)
        if position % protocol["masked"]["every"] == 0:
            poses = list(_mask_poses(front, sides, protocol["masked"]))
            for target in (*observed, *extrapolation):
                rng = Rng(seed, "mask", scene.info.name, target.key).numpy
                targets.append(_masked(target, poses[rng.integers(len(poses))]))
    return targets


def _extrapolation(
    front: Camera, sides: dict[str, Camera], frame: int, shifts: list[float]
) -> Iterator[Target]:
    for side, camera in sides.items():
        half = abs(yaw_gap(front, camera)) / 2
        for shift in shifts:
            name = f"extrapolation-{side}{shift:+g}m"
            virtual = virtual_camera(front, camera, half, shift, name)
            yield _target("extrapolation", frame, virtual, front, shift)


def _pose_sweep(
    front: Camera, sides: dict[str, Camera], frame: int, protocol: dict
) -> Iterator[Target]:
    for angle in protocol["pose_sweep"]["angles"]:
        for side, camera in sides.items():
            for shift in protocol["lateral"]:
                name = f"pose-sweep-{side}{angle:g}deg{shift:+g}m"
                virtual = virtual_camera(front, camera, angle, shift, name)
                yield _target("pose-sweep", frame, virtual, front, shift)


def _mask_poses(front: Camera, sides: dict[str, Camera], masked: dict) -> Iterator[Camera]:
    for angle in masked["yaw"]:
        for side, camera in sides.items():
            for shift in masked["lateral"]:
                name = f"mask-{side}{angle:g}deg{shift:+g}m"
                yield virtual_camera(front, camera, angle, shift, name)


def _masked(target: Target, mask_camera: Camera) -> Target:
    camera = replace(target.camera, name=f"{MASKED}{target.camera.name}")
    return replace(target, split=f"{MASKED}{target.split}", camera=camera, mask_camera=mask_camera)


def _target(split: str, frame: int, camera: Camera, front: Camera, shift: float) -> Target:
    offset = angle_between(camera.optical_axis, front.optical_axis)
    return Target(split, frame, camera, ALL_CAMERAS, offset, shift)


def write_targets(path: Path, targets: list[Target], made_with: Stamp = NOTHING) -> None:
    """Write targets as JSON, cameras in nerfstudio's fields, whole or not at all.

    Each says what the list was made with.
    """
    entries = [
        {
            "split": target.split,
            "frame": target.frame,
            "name": target.camera.name,
            "sources": target.sources,
            "pose_offset": target.pose_offset,
            "lateral_shift": target.lateral_shift,
            "mask_camera": _optional_to_json(target.mask_camera),
            **camera_to_json(target.camera),
            MADE_WITH: dict(made_with),
        }
        for target in targets
    ]
    write_json(path, entries)


def _optional_to_json(camera: Camera | None) -> dict | None:
    return None if camera is None else {"name": camera.name, **camera_to_json(camera)}


def _optional_from_json(entry: dict | None, path: Path) -> Camera | None:
    return None if entry is None else camera_from_json(entry, entry["name"], path)


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
                _optional_from_json(entry["mask_camera"], path),
            )
            for entry in read_json(path)
        ]
    except (KeyError, TypeError) as error:
        raise GeoEvsError(
            f"{path} is no target list ({error}); delete it and make it again"
        ) from error

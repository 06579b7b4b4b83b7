"""Target poses of every split, and the sources each one allows (paper sections 4.1 to 4.4)."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.files import read_json, write_json
from geoevs.core.names import check_name
from geoevs.core.randomness import Rng
from geoevs.core.splits import PLAIN_SPLITS
from geoevs.core.stamps import MADE_WITH, NOTHING, Stamp
from geoevs.core.text import clean
from geoevs.scenes.camera import Camera, angle_between, view_key
from geoevs.scenes.camera_json import camera_from_json, camera_to_json
from geoevs.scenes.checks import frame_number, number
from geoevs.scenes.store import Scene
from geoevs.scenes.virtual import virtual_camera, yaw_gap

ALL_CAMERAS = "all-cameras"
FRONT_SIDE = "front-side"
MASKED = "masked-"
"""Prefix of the split and of the camera name of a masked target. Behind it stand those of the
target whose view it shares."""

RECORDED_SPLITS = ("observed", "interpolation", f"{MASKED}observed")
"""Splits whose targets a camera recorded, so that its image is dense truth."""

SPLITS = (*PLAIN_SPLITS, f"{MASKED}observed", f"{MASKED}extrapolation")
TARGET_FIELDS = (
    *("split", "frame", "name", "sources", "pose_offset", "lateral_shift"),
    "mask_camera",
)
"""What stands in a file of a target besides its camera's calibration."""


SHIFTS = (-1000.0, 1000.0)
"""Metres that a view may lie beside its camera; configs may name no others."""


@dataclass(frozen=True)
class Target:
    """One view to synthesise.

    Args:
        split: one of SPLITS.
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
    """The targets of a scene under the config's `protocol` section, in a fixed order.

    Masked targets are of the observed and extrapolation targets that there are.

    The seed draws which virtual pose masks which target.

    Raises:
        GeoEvsError: two targets of a frame have one name, or a pose cannot be made.
    """
    rig = scene.info.rig
    targets: list[Target] = []
    for position, frame in enumerate(scene.frames):
        front = scene.camera(rig.front, frame)
        sides = {
            "left": scene.camera(rig.front_left, frame),
            "right": scene.camera(rig.front_right, frame),
        }
        observed: list[Target] = []
        if position % _every(protocol, "observed") == 0:
            cameras = [scene.camera(name, frame) for name in scene.cameras]
            observed = [_target("observed", frame, camera, front, 0.0) for camera in cameras]
        renamed = replace(front, name=f"interpolation-{front.name}")
        interpolation = Target("interpolation", frame, renamed, FRONT_SIDE, 0.0, 0.0)
        extrapolation: list[Target] = []
        if position % _every(protocol, "extrapolation") == 0:
            extrapolation = list(_extrapolation(front, sides, frame, protocol["lateral"]))
        targets += [*observed, interpolation, *extrapolation]
        if position % protocol["pose_sweep"]["every"] == 0:
            targets += _pose_sweep(front, sides, frame, protocol)
        if position % protocol["masked"]["every"] == 0:
            poses = list(_mask_poses(front, sides, protocol["masked"]))
            check_distinct([pose.name for pose in poses], f"scene '{scene.info.name}'")
            for target in (*observed, *extrapolation):
                rng = Rng(seed, "mask", scene.info.name, target.key).numpy
                targets.append(_masked(target, poses[rng.integers(len(poses))]))
    check_distinct([target.key for target in targets], f"scene '{scene.info.name}'")
    return targets


def _every(protocol: Mapping[str, Any], split: str) -> int:
    """Of how many frames one has targets of a split; of every one where the config does not say."""
    return protocol.get("every", {}).get(split, 1)


def without_usual(protocol: Mapping[str, Any]) -> dict[str, Any]:
    """A protocol section as hashes take it: without `every` where that leaves out no frame."""
    usual = all(step == 1 for step in protocol.get("every", {}).values())
    return {key: value for key, value in protocol.items() if key != "every" or not usual}


def check_distinct(names: Iterable[str], where: Path | str) -> None:
    """Check the names of targets, or of their masks, which say their pose and name their files.

    Raises:
        GeoEvsError: two are the same.
    """
    counts = Counter(names)
    name, count = max(counts.items(), key=lambda item: item[1], default=("", 0))
    if count > 1:
        raise GeoEvsError(
            f"{where} has {count} targets or masks called '{clean(name, 80)}', whose files would "
            "overwrite each other; choose shifts and angles that differ in their first six digits"
        )


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


def read_targets(path: Path) -> list[Target]:
    """Read what `write_targets` wrote.

    Raises:
        GeoEvsError: the file is missing, not a target list, or has a target that cannot be: see
            `camera_from_json`, and a name that is no path's part or that another one has.
    """
    entries = read_json(path)
    if not isinstance(entries, list):
        raise GeoEvsError(f"{path} is no target list (no list at all); delete it and make it again")
    targets = [_target_from_json(entry, path) for entry in entries]
    check_distinct([target.key for target in targets], path)
    return targets


def _target_from_json(entry: Any, path: Path) -> Target:
    _check_fields(entry, TARGET_FIELDS, path)
    for field, words in (("split", SPLITS), ("sources", (ALL_CAMERAS, FRONT_SIDE))):
        if entry[field] not in words:
            hint = did_you_mean(clean(str(entry[field]), 40), words)
            raise GeoEvsError(
                f"{path}: there is no {field} '{clean(str(entry[field]), 40)}'; {hint}"
            )
    name = check_name(entry["name"], "target", path)
    masking = entry["mask_camera"]
    if (masking is not None) != entry["split"].startswith(MASKED):
        raise GeoEvsError(
            f"{path}: target '{name}' must have a mask_camera if its split begins with {MASKED}, "
            "and else null; make the file again"
        )
    if masking is not None:
        _check_fields(masking, ("name",), path)
        masking = camera_from_json(masking, check_name(masking["name"], "mask camera", path), path)
    return Target(
        split=entry["split"],
        frame=frame_number(entry["frame"], path),
        camera=camera_from_json(entry, name, path),
        sources=entry["sources"],
        pose_offset=_within(entry["pose_offset"], 0, 180, "a pose_offset", path),
        lateral_shift=_within(entry["lateral_shift"], *SHIFTS, "a lateral_shift", path),
        mask_camera=masking,
    )


def _within(value: Any, low: float, high: float, what: str, path: Path) -> float:
    found = number(value, what, path)
    if not low <= found <= high:
        raise GeoEvsError(
            f"{path}: {what} is {found:g}, not from {low:g} to {high:g}; make the file again"
        )
    return found


def _check_fields(entry: Any, fields: Sequence[str], path: Path) -> None:
    for field in fields:
        if not isinstance(entry, dict) or field not in entry:
            raise GeoEvsError(
                f"{path} is no target list (one lacks '{field}'); delete it and make it again"
            )

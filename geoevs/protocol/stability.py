"""The stability suite: its targets, its stresses, and rendering one method under all of them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geoevs.core.attempts import attempt_after
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import new_folder, read_json, write_json
from geoevs.core.isolate import (
    MACHINE,
    MethodFailedError,
    absolute_paths,
    lent_folder,
    run_isolated,
)
from geoevs.core.text import clean
from geoevs.protocol.entries import (
    FAILED,
    FINE,
    OK,
    SPLITS,
    MethodEntry,
    checked_splits,
    failed,
)
from geoevs.protocol.pictures import PICTURES, seal_pictures
from geoevs.protocol.stressors import STRESSORS, stressor_named
from geoevs.protocol.targets import ALL_CAMERAS, Target, check_distinct, read_targets
from geoevs.scenes.camera import Camera, angle_between
from geoevs.scenes.store import Scene
from geoevs.scenes.virtual import virtual_camera, yaw_gap

CLEAN = "clean"
"""Name of the group without stress, and of its kind. Stressors of the kinds `targets` and `pixels`
are scored on its renders."""

WORLD = "~"
"""Separator of a scene's name and the option of its source that makes it another world."""

OUTCOME_FILE = "outcome.json"

STABILITY_STEP = "geoevs.protocol.stability_step:stability_step"


@dataclass(frozen=True)
class Stress:
    """A stressor at a level, and the draw of all that is random in it.

    The draw also seeds the method's own randomness.
    """

    stressor: str
    level: float = 0.0
    draw: int = 0

    @property
    def key(self) -> str:
        """Its name within the stressor, usable as a path."""
        return f"{self.level:g}.seed{self.draw}"

    @property
    def kind(self) -> str:
        """The stressor's kind, or CLEAN."""
        return CLEAN if self.stressor == CLEAN else stressor_named(self.stressor).kind

    def world(self, scene: str) -> str:
        """The scene in the world that methods are given, as scenes are called in paths.

        >>> Stress("motion", 5.0).world("junction-103")
        'junction-103~traffic_speed=5'
        >>> Stress("support", 0.1).world("junction-103")
        'junction-103'
        """
        if self.kind != "world":
            return scene
        return f"{scene}{WORLD}{STRESSORS[self.stressor].option}={self.level:g}"


def levels_of(stressor: str, settings: dict[str, Any]) -> list[float]:
    """The levels of a stressor: the config's, or its own where the config leaves it out.

    Args:
        stressor: one of STRESSORS.
        settings: the config's `stability` section.
    """
    return list(settings["levels"].get(stressor, STRESSORS[stressor].levels))


def groups(settings: dict[str, Any]) -> list[str]:
    """The stressors whose stresses must be rendered, CLEAN first.

    Args:
        settings: the config's `stability` section.
    """
    rendered = [
        name
        for name, stressor in STRESSORS.items()
        if stressor.kind in ("store", "world") and levels_of(name, settings)
    ]
    return [CLEAN, *rendered]


def stresses(group: str, settings: dict[str, Any]) -> list[Stress]:
    """The stresses of a group: every level and draw.

    In CLEAN and in worlds, draws are given the same scene, and seed the method alone.
    """
    draws = range(settings["seeds"])
    levels = [0.0] if group == CLEAN else levels_of(group, settings)
    return [Stress(group, level, draw) for level in levels for draw in draws]


def world_options(scene: str) -> tuple[str, dict[str, Any]]:
    """A scene's own name, and the options of its source that make its world.

    >>> world_options("junction-103~traffic_speed=5")
    ('junction-103', {'traffic_speed': 5})
    """
    name, *changes = scene.split(WORLD)
    pairs = (change.split("=", 1) for change in changes)
    return name, {option: json.loads(value) for option, value in pairs}


def stability_targets(scene: Scene, settings: dict[str, Any]) -> list[Target]:
    """The views that stability is tested on, all of them virtual.

    Half-way targets as in the protocol, split `extrapolation`; those of the stressors `lateral` and
    `yaw`, splits of these names, are front cameras moved or turned to both sides.

    Args:
        scene: the clean scene.
        settings: `lateral`, shifts of the half-way targets in metres, and `levels` of both.
    """
    rig = scene.info.rig
    targets = []
    for frame in scene.frames:
        front = scene.camera(rig.front, frame)
        sides = {
            "left": scene.camera(rig.front_left, frame),
            "right": scene.camera(rig.front_right, frame),
        }
        for side, camera in sides.items():
            outwards = 1 if side == "left" else -1
            half = abs(yaw_gap(front, camera)) / 2
            for shift in settings["lateral"]:
                name = f"extrapolation-{side}{shift:+g}m"
                virtual = virtual_camera(front, camera, half, shift, name)
                targets.append(_target("extrapolation", frame, virtual, front, shift))
            for shift in levels_of("lateral", settings):
                moved = virtual_camera(front, camera, 0.0, outwards * shift, f"{side}-{shift:g}m")
                targets.append(_target("lateral", frame, moved, front, outwards * shift))
            for angle in levels_of("yaw", settings):
                turned = virtual_camera(front, camera, angle, 0.0, f"{side}-{angle:g}deg")
                targets.append(_target("yaw", frame, turned, front, 0.0))
    check_distinct([target.key for target in targets], f"scene '{scene.info.name}'")
    return targets


def _target(split: str, frame: int, camera: Camera, front: Camera, shift: float) -> Target:
    offset = angle_between(camera.optical_axis, front.optical_axis)
    return Target(split, frame, camera, ALL_CAMERAS, offset, shift)


def render_stresses(
    entry: MethodEntry,
    scenes: Sequence[tuple[Stress, Path]],
    targets: Path,
    masks: Path,
    folder: Path,
    log: Path,
    limits: Mapping[str, float | None] | None = None,
    attempt: int = 0,
) -> None:
    """Fit and render a method under every stress of one group.

    One isolated process does them all, since starting one costs more than most fits; draws of one
    scene that a method has no randomness for share one result. Leaves
    `<stress key>/<target key>.png` and `<stress key>/outcome.json`, which says at which stage
    and why one failed; the others go on.

    Args:
        entry: the method.
        scenes: the group's stresses, and the scene stores that methods are given.
        targets: the scene's target list; what is not CLEAN renders its extrapolation split alone.
        masks: the scene's condition masks.
        folder: what to write, whole or not at all.
        log: where the method's own output goes.
        limits: seconds after which a `fit` or a `render` is ended, and all stresses that are left
            fail with it; None: never.
        attempt: the number of this attempt (see `core.attempts`).
    """
    log.unlink(missing_ok=True)
    limits = {"fit": None, "render": None, **(limits or {})}
    splits = None if scenes[0][0].stressor == CLEAN else ["extrapolation"]
    try:
        with lent_folder(folder) as partial:
            _render_stresses(entry, scenes, targets, splits, masks, partial, log, limits, attempt)
    except MethodFailedError as failure:
        outcome = failed("fit or render", str(failure), log)
        outcome["attempt"] = attempt_after(attempt, False)
        with new_folder(folder) as partial:
            for stress, _ in scenes:
                write_json(partial / stress.key / OUTCOME_FILE, outcome)


def _render_stresses(
    entry: MethodEntry,
    scenes: Sequence[tuple[Stress, Path]],
    targets: Path,
    splits: list[str] | None,
    masks: Path,
    folder: Path,
    log: Path,
    limits: Mapping[str, float | None],
    attempt: int,
) -> None:
    """Fill the folder that a group's renders are to lie in."""
    arguments = {
        "method": entry.method,
        "options": absolute_paths(entry.options),
        "stresses": [
            {
                "key": stress.key,
                "scene": str(scene.absolute()),
                "seed": entry.seed + stress.draw,
            }
            for stress, scene in scenes
        ],
        "targets": str(targets.absolute()),
        "splits": splits,
        "masks": str(masks.absolute()),
        "folder": str(folder.absolute()),
        "log": str(log),
        "limits": {stage: limits[stage] for stage in ("fit", "render")},
        "attempt": attempt,
    }
    rest = failed("fit or render", "its process said nothing of it", log)
    rest["attempt"] = attempt_after(attempt, False)
    try:
        run_isolated(STABILITY_STEP, arguments, 1, log, limits["fit"])
    except MethodFailedError as failure:  # the process died in one of them
        rest = failed("fit or render", str(failure), log)
        rest["attempt"] = attempt_after(attempt, failure.kind == MACHINE)
        if failure.limit is not None:
            stage = next((n for n in ("fit", "render") if limits[n] == failure.limit), "fit")
            rest |= {"stage": stage, "limit": failure.limit}
    views = [t for t in read_targets(targets) if splits is None or t.split in splits]
    for stress, _ in scenes:
        place = folder / stress.key
        outcome = _outcome(place / OUTCOME_FILE) or rest
        if outcome["status"] == OK:
            outcome = {**outcome, PICTURES: seal_pictures(place, views)}
        write_json(place / OUTCOME_FILE, outcome)


def _outcome(path: Path) -> dict[str, Any] | None:
    """What the step wrote down of one stress; None if it did not come so far."""
    if not path.is_file():
        return None
    try:
        told = read_json(path)
    except GeoEvsError:
        return None
    shape = isinstance(told, dict) and told.keys() >= {*FINE, "attempt"}
    if not shape or told["status"] not in (OK, FAILED) or type(told["attempt"]) is not int:
        return None
    said = {key: clean(str(told[key])) for key in FINE}
    return {**said, "attempt": told["attempt"], SPLITS: checked_splits(told.get(SPLITS))}


def clean_settings(settings: dict[str, Any], scene: str) -> dict[str, Any]:
    """The part of the section that decides `stability_targets`.

    Scenes of other worlds have no poses of their own, so their lists of levels are empty.
    """
    poses = {
        name: [] if WORLD in scene else levels_of(name, settings) for name in ("lateral", "yaw")
    }
    return {"lateral": settings["lateral"], "levels": poses}

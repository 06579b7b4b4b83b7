"""The stability suite: its targets, its conditions, and rendering one method under all of them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geoevs.core.files import new_folder, write_json
from geoevs.protocol.entries import MethodEntry, failed
from geoevs.protocol.isolate import MethodFailedError, run_isolated
from geoevs.protocol.stressors import MOTION_OPTION, STRESSORS
from geoevs.protocol.targets import ALL_CAMERAS, Target
from geoevs.scenes.camera import Camera, angle_between
from geoevs.scenes.store import Scene
from geoevs.scenes.virtual import virtual_camera, yaw_gap

CLEAN = "clean"
"""The group of conditions without stress; poses and pixels are chosen from its renders."""

WORLD = "~"
"""Stands between a scene's name and the option of its source that makes it another world."""

OUTCOME_FILE = "outcome.json"


@dataclass(frozen=True)
class Condition:
    """What a method is given: a stressor at a level, and the draw of whatever is random in it.

    The draw also seeds the method's own randomness.
    """

    stressor: str
    level: float = 0.0
    draw: int = 0

    @property
    def key(self) -> str:
        """Its name within the stressor, usable as a path."""
        return f"{self.level:g}.seed{self.draw}"


def groups(settings: dict[str, Any]) -> list[str]:
    """The stressors whose conditions must be rendered, CLEAN first.

    Args:
        settings: the config's `stability` section.
    """
    rendered = [
        name
        for name, stressor in STRESSORS.items()
        if stressor.acts_on in ("store", "world") and settings["levels"][name]
    ]
    return [CLEAN, *rendered]


def conditions(stressor: str, settings: dict[str, Any]) -> list[Condition]:
    """The conditions of a group: every level and draw.

    In CLEAN and in worlds, draws are given the same scene, and seed the method alone.
    """
    draws = range(settings["seeds"])
    if stressor == CLEAN:
        return [Condition(CLEAN, draw=draw) for draw in draws]
    return [
        Condition(stressor, level, draw) for level in settings["levels"][stressor] for draw in draws
    ]


def world_name(scene: str, level: float) -> str:
    """The scene in the world where traffic has this speed, as scenes are called in paths.

    >>> world_name("junction-103", 5.0)
    'junction-103~traffic_speed=5'
    """
    return f"{scene}{WORLD}{MOTION_OPTION}={level:g}"


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
            for shift in settings["levels"]["lateral"]:
                moved = virtual_camera(front, camera, 0.0, outwards * shift, f"{side}-{shift:g}m")
                targets.append(_target("lateral", frame, moved, front, outwards * shift))
            for angle in settings["levels"]["yaw"]:
                turned = virtual_camera(front, camera, angle, 0.0, f"{side}-{angle:g}deg")
                targets.append(_target("yaw", frame, turned, front, 0.0))
    return targets


def _target(split: str, frame: int, camera: Camera, front: Camera, shift: float) -> Target:
    offset = angle_between(camera.optical_axis, front.optical_axis)
    return Target(split, frame, camera, ALL_CAMERAS, offset, shift)


def render_conditions(
    entry: MethodEntry,
    scenes: Sequence[tuple[Condition, Path]],
    targets: Path,
    masks: Path,
    folder: Path,
    log: Path,
) -> None:
    """Fit and render a method under every condition of one group.

    One isolated process does them all, since starting one costs more than most fits; draws of one
    scene that a method has no randomness for share one result. Leaves
    `<condition key>/<target key>.png` and `<condition key>/outcome.json`, which says at which
    stage and why a condition failed; the others go on.

    Args:
        entry: the method.
        scenes: the group's conditions, and the scene stores that methods are given.
        targets: the scene's target list; what is not CLEAN renders its extrapolation split alone.
        masks: the scene's condition masks.
        folder: what to write, whole or not at all.
        log: where the method's own output goes.
    """
    log.unlink(missing_ok=True)
    with new_folder(folder) as partial:
        arguments = {
            "method": entry.method,
            "options": entry.options,
            "conditions": [
                {"key": condition.key, "scene": str(scene), "seed": entry.seed + condition.draw}
                for condition, scene in scenes
            ],
            "targets": str(targets),
            "splits": None if scenes[0][0].stressor == CLEAN else ["extrapolation"],
            "masks": str(masks),
            "folder": str(partial),
            "log": str(log),
        }
        try:
            run_isolated("geoevs.protocol.stability_step:stability_step", arguments, 1, log)
        except MethodFailedError as failure:  # the process died in one of them
            for condition, _ in scenes:
                path = partial / condition.key / OUTCOME_FILE
                if not path.exists():
                    path.parent.mkdir(exist_ok=True)
                    write_json(path, failed("fit or render", str(failure), log))


def clean_settings(settings: dict[str, Any], scene: str) -> dict[str, Any]:
    """What `stability_targets` needs of the section; other worlds have no poses of their own."""
    levels = {} if WORLD in scene else settings["levels"]
    poses = {name: levels.get(name, []) for name in ("lateral", "yaw")}
    return {"lateral": settings["lateral"], "levels": poses}

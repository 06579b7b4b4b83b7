"""What each answer of a scene was made with, and whether all of them belong together."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from geoevs import layout
from geoevs.core.files import read_json
from geoevs.core.hashes import file_hash
from geoevs.core.stamps import MADE_WITH, Stamp, check_stamp, settings_hash
from geoevs.protocol.condition_masks import ConditionMasks
from geoevs.protocol.entries import read_outcomes
from geoevs.protocol.reference import References
from geoevs.protocol.targets import without_usual
from geoevs.run import Answers
from geoevs.scenes.store import Scene

TARGET_SETTINGS = (
    *("lateral", "every", "pose_sweep", "masked", "levels"),
    *("views", "offsets"),  # of detection
)
"""The keys of the config's protocol, stability and detection sections that targets are made with.
"""


def scene_stamp(
    source: str, name: str, size: tuple[int, int], options: Mapping[str, Any], data: str
) -> Stamp:
    """What a scene store was made with.

    Args:
        source: the data source.
        name: the scene's name in the config.
        size: height and width in pixels.
        options: of the source.
        data: hash of the files that it was read from (see `outside_hash`).
    """
    return {"settings": settings_hash([source, name, *size, options]), "data": data}


def targets_stamp(scene: Scene, settings: Mapping[str, Any], seed: int) -> Stamp:
    """What a target list was made with: a scene, and settings of a protocol."""
    return {"settings": target_settings(settings, seed), "scene": scene.stamp}


def target_settings(settings: Mapping[str, Any], seed: int) -> str:
    """Hash of what a config says of targets.

    Args:
        settings: the config's protocol section, or the stability section's part of it.
        seed: of the run.
    """
    asked = without_usual(settings)
    kept = {name: value for name, value in asked.items() if name in TARGET_SETTINGS}
    return settings_hash([kept, seed])


def references_stamp(scene: Scene, targets: Path, seed: int) -> Stamp:
    """What references and masks were made with: a scene, its target list, a seed."""
    return {"seed": str(seed), "targets": file_hash(targets), "scene": scene.stamp}


def made_with(path: Path) -> Any:
    """The stamp of scene.json, of a target list, or of a fit's or a render's outcomes, if any."""
    found = read_json(path)
    if isinstance(found, dict) and MADE_WITH in found:
        return found[MADE_WITH]
    parts = found if isinstance(found, list) else getattr(found, "values", list)()
    first = next(iter(parts), None)  # all have the same
    return first.get(MADE_WITH) if isinstance(first, dict) else None


def check_answers(answers: Answers, seed: int, settings: Mapping[str, Any] | None = None) -> None:
    """Check that a scene's targets, references and masks are of each other and of the config.

    Args:
        answers: the scene's.
        seed: of the run.
        settings: the config's protocol section; None where the targets are not made with it.

    Raises:
        GeoEvsError: one was made with something else; the sentence names the file.
    """
    targets = answers.path(layout.TARGETS)
    asked = {} if settings is None else {"settings": target_settings(settings, seed)}
    check_stamp(targets, made_with(targets), {"scene": answers.scene.stamp, **asked})
    expected = references_stamp(answers.scene, targets, seed)
    for pattern, kind in ((layout.REFERENCES, References), (layout.MASKS, ConditionMasks)):
        path = answers.path(pattern)
        check_stamp(path, kind(path).made_with, expected)


def renders_stamp(answers: Answers) -> Stamp:
    """What an entrant's renders were made with, whoever it is."""
    return {
        "scene": answers.scene.stamp,
        "targets": file_hash(answers.path(layout.TARGETS)),
        "masks": file_hash(answers.path(layout.MASKS)),
    }


def check_renders(answers: Answers, label: str) -> None:
    """Check that an entrant was fitted to the scene, and rendered its targets with its masks.

    Raises:
        GeoEvsError: it was not; the sentence names the file.
    """
    expected = renders_stamp(answers)
    path = answers.renders(label) / "render.json"
    for outcome in read_outcomes(path).values():
        check_stamp(path, outcome.get(MADE_WITH), expected)

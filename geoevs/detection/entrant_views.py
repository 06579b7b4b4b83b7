"""What an entrant renders for detectors: fitted and rendered by the protocol's own steps."""

import tempfile
from collections.abc import Mapping
from pathlib import Path

from geoevs.methods.contract import Budget
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.records import write_records
from geoevs.protocol.runs import fit_method, render_method


def render_views(
    entry: MethodEntry,
    scene: Path,
    targets: Path,
    model: Path,
    folder: Path,
    logs: tuple[Path, Path],
    limits: Mapping[str, float | None],
    attempt: int = 0,
    budget: Budget | None = None,
) -> None:
    """Fit a method to a scene without boxes, and render the targets; failures are written down.

    Args:
        entry: the method; no oracle.
        scene: the store, without boxes (see `write_without_boxes`).
        targets: of the scene; no split of them is masked.
        model: where the fit goes, whole or not at all.
        folder: where the pictures go, likewise.
        logs: where the method's own output goes, while it is fitted and while it renders.
        limits: seconds after which a `fit` or a `render` is ended; None: never.
        attempt: the number of this attempt (see `core.attempts`).
        budget: what the fit is asked to keep to.
    """
    budget = budget or Budget()
    fit_method(entry, scene, targets, budget, model, logs[0], limits["fit"], attempt)
    with tempfile.TemporaryDirectory() as scratch:
        masks = Path(scratch) / "masks.npz"
        write_records(masks, {})
        render_method(
            entry, model, targets, masks, folder, logs[1], None, limits["render"], attempt
        )

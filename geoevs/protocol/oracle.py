"""Controls that copy what scores a method, outside the adapter contract on purpose."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.methods.contract import Rendering
from geoevs.protocol.entries import TRUTH
from geoevs.protocol.render_step import render_targets
from geoevs.protocol.targets import Target
from geoevs.run import Answers


def oracle_step(
    method: str, run: str, dataset: str, scene: str, sources: str, folder: str
) -> dict[str, Any]:
    """Render targets by one of ORACLES, as `render_step` does by methods; only oracles see answers.

    Masked targets show the view without the mask.

    Args:
        method: which one.
        run: the run's folder.
        dataset: the scene's data set in the config.
        scene: its name there.
        sources: the set of sources whose targets to render.
        folder: where `<target key>.png` go.

    Returns:
        What `render_targets` returns; nothing is loaded.
    """
    answers = Answers(Path(run), dataset, scene)

    def render(targets: Sequence[Target]) -> list[Rendering]:
        return [Rendering(oracle_picture(method, answers, target)) for target in targets]

    wanted = [[target] for target in answers.targets if target.sources == sources]
    return {"load_seconds": 0.0, **render_targets(render, wanted, Path(folder))}


def oracle_picture(name: str, answers: Answers, target: Target) -> np.ndarray:
    """(H, W, 3) float32 in [0, 1]: the answer to a target, copied.

    `reference` shows the sparse reference over the dense truth where there is one, else over
    black: the ceiling of every sparse metric. `truth` shows the dense truth alone: what a perfect
    method scores against a reference that has errors of its own.

    Raises:
        GeoEvsError: `truth` is asked for a target whose truth nobody knows.
    """
    truth = answers.truth(target)
    if name == TRUTH and truth is None:
        raise GeoEvsError(
            f"nobody knows the truth of {target.key}; set the control '{TRUTH}' to null under "
            "methods for recorded data"
        )
    reference = None if name == TRUTH else answers.reference(target)
    if reference is None:
        return truth
    if truth is None:
        return reference.image()
    return np.where(reference.mask()[..., None], reference.image(), truth)

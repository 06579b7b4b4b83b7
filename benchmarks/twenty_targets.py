"""What Geo-EVS is given and what it makes of it, beside truth and inpainting, at random targets.

python -m benchmarks.twenty_targets results/default twenty.png

Twenty targets of the extrapolation split of a finished run, the same ones every time. A condition
map's holes are black.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.shifted_views import DATASET, fitted
from geoevs.core.images import read_image, to_uint8, write_image
from geoevs.protocol.targets import Target
from geoevs.results.figures import Row, draw_grid
from geoevs.run import Answers

SCENES, COUNT = ("straight-101", "curve-102", "junction-103"), 20
INPAINTED = ("reproject-inpaint", "reproject-inpaint.navier-stokes")
GENERATED = ("geo-evs", "geo-evs-support")
COLUMNS = [
    "truth",
    *INPAINTED,
    *(name for label in GENERATED for name in (f"condition of {label}", label)),
]


def rows_of_scene(answers: Answers, targets: list[Target]) -> list[Row]:
    """One row a target: pictures of COLUMNS."""
    methods = {label: fitted(answers, label) for label in GENERATED}

    def rendered(label: str, target: Target) -> np.ndarray:
        return read_image(answers.renders(label) / f"{target.key}.png")

    rows = []
    for target in targets:
        pictures = [to_uint8(answers.truth(target))]
        pictures += [rendered(label, target) for label in INPAINTED]
        for label, method in methods.items():
            condition = method.condition(target.camera, target.frame)
            pictures += [to_uint8(condition.image), rendered(label, target)]
        rows.append(Row(f"{answers.name}, frame {target.frame}, {target.camera.name}", pictures))
    return rows


def main() -> None:
    """Write the picture."""
    run, out = map(Path, sys.argv[1:])
    scenes = [Answers(run, DATASET, name) for name in SCENES]
    views = [
        (answers, target)
        for answers in scenes
        for target in answers.targets
        if target.split == "extrapolation"
    ]
    drawn = sorted(np.random.default_rng(0).permutation(len(views))[:COUNT])
    rows = []
    for answers in scenes:
        rows += rows_of_scene(answers, [views[k][1] for k in drawn if views[k][0] is answers])
    write_image(out, draw_grid(COLUMNS, rows))


if __name__ == "__main__":
    main()

"""What Geo-EVS is given and what it makes of it, beside truth and inpainting, at random targets.

python -m benchmarks.twenty_targets results/default twenty.png

Twenty targets of the extrapolation split of a finished run, the same ones every time. A condition
map's holes are black.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.shifted_views import DATASET, fitted
from geoevs import layout
from geoevs.core.files import read_image, to_uint8, write_image
from geoevs.protocol.targets import Target, read_targets
from geoevs.protocol.truth import dense_truth
from geoevs.results.figures import Row, draw_grid
from geoevs.scenes.store import Scene

SCENES, COUNT = ("straight-101", "curve-102", "junction-103"), 20
INPAINTED = ("reproject-inpaint", "reproject-inpaint.navier-stokes")
GENERATED = ("geo-evs", "geo-evs-support")
COLUMNS = [
    "truth",
    *INPAINTED,
    *(name for label in GENERATED for name in (f"condition of {label}", label)),
]


def rows_of_scene(run: Path, name: str, targets: list[Target]) -> list[Row]:
    """One row a target: pictures of COLUMNS."""
    place = {"dataset": DATASET, "scene": name}
    scene, truth = (run / path.format(**place) for path in (layout.SCENE, layout.TRUTH))
    store, methods = Scene(scene), {label: fitted(run, place, label) for label in GENERATED}

    def rendered(label: str, target: Target) -> np.ndarray:
        return read_image(run / layout.RENDERS.format(**place, label=label) / f"{target.key}.png")

    rows = []
    for target in targets:
        pictures = [to_uint8(dense_truth(store, truth, target))]
        pictures += [rendered(label, target) for label in INPAINTED]
        for label, method in methods.items():
            condition = method.condition(target.camera, target.frame)
            pictures += [to_uint8(condition.image), rendered(label, target)]
        rows.append(Row(f"{name}, frame {target.frame}, {target.camera.name}", pictures))
    return rows


def main() -> None:
    """Write the picture."""
    run, out = map(Path, sys.argv[1:])
    places = [
        (name, target)
        for name in SCENES
        for target in read_targets(run / layout.TARGETS.format(dataset=DATASET, scene=name))
        if target.split == "extrapolation"
    ]
    drawn = sorted(np.random.default_rng(0).permutation(len(places))[:COUNT])
    rows = []
    for name in SCENES:
        chosen = [places[k][1] for k in drawn if places[k][0] == name]
        rows += rows_of_scene(run, name, chosen)
    write_image(out, draw_grid(COLUMNS, rows))


if __name__ == "__main__":
    main()

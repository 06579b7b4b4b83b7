"""What the Gaussian methods of a finished run draw from the front camera's place, and beside it.

python -m benchmarks.shifted_views results/default shifted.png

Rows: the truth, then each method, of each scene; columns: 0, 1 and 2 metres to the left.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from geoevs import layout
from geoevs.core.files import read_json
from geoevs.core.images import to_uint8, write_image
from geoevs.methods.contract import Adapter
from geoevs.methods.finding import method_class
from geoevs.protocol.targets import ALL_CAMERAS
from geoevs.run import Answers
from geoevs.scenes.scene import SceneRef, load_source
from geoevs.scenes.virtual import virtual_camera

DATASET, SCENES, FRAME = "street", ("straight-101", "junction-103"), 4
METHODS = ("three-dgs", "street-gaussians")
SHIFTS = (0.0, 1.0, 2.0)
ENLARGED = 2


def fitted(answers: Answers, label: str) -> Adapter:
    """A method as the run fitted it to all cameras of a scene."""
    return method_class(label).load(answers.path(layout.MODEL, label=label) / ALL_CAMERAS / "model")


def shifted_views(run: Path, name: str) -> list[np.ndarray]:
    """Rows of one scene, each (H, 3 W, 3) uint8."""
    config = read_json(run / layout.MANIFEST)["config"]
    answers = Answers(run, DATASET, name)
    scene = answers.scene
    front, side = (
        scene.camera(camera, FRAME) for camera in (scene.info.rig.front, scene.info.rig.front_left)
    )
    cameras = [virtual_camera(front, side, 0.0, shift, f"{shift:g}m") for shift in SHIFTS]
    source = load_source(DATASET, *config["resolution"], config["datasets"][DATASET]["options"])
    truths = source.truth(SceneRef.parse(name), [(camera, FRAME) for camera in cameras])
    rows = [[to_uint8(truth.rgb) for truth in truths]]
    for label in METHODS:
        method = fitted(answers, label)
        rows.append([to_uint8(method.render(camera, FRAME).rgb) for camera in cameras])
    return [np.hstack(row) for row in rows]


def main() -> None:
    """Write the picture."""
    run, out = map(Path, sys.argv[1:])
    picture = np.vstack([row for name in SCENES for row in shifted_views(run, name)])
    size = picture.shape[1] * ENLARGED, picture.shape[0] * ENLARGED
    write_image(out, cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST))


if __name__ == "__main__":
    main()

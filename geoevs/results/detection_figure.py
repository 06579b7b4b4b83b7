"""What detectors of every setting find in one frame."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from PIL import Image, ImageDraw, ImageFont

from geoevs.core.images import to_uint8
from geoevs.detection.bevformer.pictures import draw_frame
from geoevs.detection.labels import Bounds
from geoevs.detection.rigs import DetectionScene
from geoevs.detection.rows import BOX
from geoevs.detection.training_settings import NATIVE
from geoevs.results.figures import BACKGROUND, HEADER, INK, MARGIN


def detection_figure(
    scene: DetectionScene, frame: int, predictions: Mapping[str, pd.DataFrame], bounds: Bounds
) -> np.ndarray:
    """(H, W, 3) uint8: for every setting the recorded views and the scene from above, with boxes.

    As many predictions are drawn as there are labels, those of highest score.

    Args:
        scene: a test scene.
        frame: one of it.
        predictions: rows of PREDICTION_TYPES by setting, of all scenes.
        bounds: what is shown from above.
    """
    shown = next(one for one in scene.frames(NATIVE) if one.frame == frame)
    pictures = {
        name: draw_frame(shown, _best(found, scene.name, frame, len(shown.boxes)), bounds)
        for name, found in predictions.items()
    }
    return labelled(pictures) if pictures else labelled({"every setting failed": shown.images[0]})


def _best(found: pd.DataFrame, scene: str, frame: int, count: int) -> np.ndarray:
    """(N, 7) the boxes of highest score in a frame."""
    mine = found[(found["scene"] == scene) & (found["frame"] == frame)]
    mine = mine.sort_values("score", ascending=False, kind="stable").head(count)
    return mine[list(BOX)].to_numpy(np.float64)


def labelled(pictures: Mapping[str, np.ndarray]) -> np.ndarray:
    """(H, W, 3) uint8: pictures one below the other, each under its name."""
    tiles = {name: Image.fromarray(_bytes(picture)) for name, picture in pictures.items()}
    width = max(tile.width for tile in tiles.values()) + 2 * MARGIN
    height = sum(tile.height + HEADER for tile in tiles.values()) + MARGIN
    canvas = Image.new("RGB", (width, height), BACKGROUND)
    draw, font, top = ImageDraw.Draw(canvas), ImageFont.load_default(size=13), 0
    for name, tile in tiles.items():
        draw.text((MARGIN, top + 3), name, fill=INK, font=font)
        canvas.paste(tile, (MARGIN, top + HEADER))
        top += tile.height + HEADER
    return np.asarray(canvas)


def _bytes(picture: np.ndarray) -> np.ndarray:
    return picture if picture.dtype == np.uint8 else to_uint8(picture)

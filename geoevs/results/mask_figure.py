"""A picture of the artifact-mask library: some of its masks, and how far it covers the test."""

import io
from collections.abc import Sequence
from pathlib import Path

import altair as alt
import cv2
import numpy as np
import pandas as pd
from PIL import Image, ImageDraw, ImageFont

from geoevs.conditions.artifact_masks import MaskLibrary
from geoevs.core.images import encode_png
from geoevs.results.figures import BACKGROUND, HEADER, INK, MARGIN, UNSUPPORTED
from geoevs.run import Answers

COLUMNS, ROWS = 6, 4
TILE_WIDTH = 192
CHART_HEIGHT = 260
BIN = 0.02
SUPPORTED = (228, 224, 232)
LIBRARY_COLOUR, TEST_COLOUR = "#5a1e5a", "#e8743b"


def target_support(run: Path, scenes: Sequence[tuple[str, str]]) -> np.ndarray:
    """(N,) support ratios of raw reprojection at every extrapolation target of the test scenes.

    Args:
        run: the run's folder.
        scenes: (dataset, scene) pairs.
    """
    support = [
        answers.reference(target).reprojected.mean()
        for answers in (Answers(run, *place) for place in scenes)
        for target in answers.targets
        if target.split == "extrapolation"
    ]
    return np.array(support)


def library_picture(
    library: MaskLibrary,
    test: np.ndarray,  # [N] support ratios
) -> bytes:
    """Masks of the library above the histograms of its support and of the test's, as PNG bytes.

    The masks stand at equal steps between the least support and the most; purple is hidden.
    """
    order = np.argsort(library.support, kind="stable")
    steps = np.linspace(0, len(library) - 1, min(len(library), COLUMNS * ROWS))
    grid = _draw_masks(library, order[np.rint(steps).astype(int)])
    chart = _draw_histograms({"mask library": library.support, "test targets": test})
    canvas = Image.new("RGB", (grid.width, grid.height + HEADER + chart.height), BACKGROUND)
    canvas.paste(grid, (0, 0))
    canvas.paste(chart, (0, grid.height + HEADER))
    return encode_png(np.asarray(canvas))


def _draw_masks(library: MaskLibrary, chosen: np.ndarray) -> Image.Image:  # chosen: [M] int
    """The chosen masks in rows, each over its pose and support ratio."""
    tile = (TILE_WIDTH, round(TILE_WIDTH * library.height / library.width))
    step = (tile[0] + MARGIN, tile[1] + HEADER)
    rows = -(-len(chosen) // COLUMNS)
    canvas = Image.new("RGB", (COLUMNS * step[0] + MARGIN, rows * step[1] + MARGIN), BACKGROUND)
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(size=12)
    for place, (number, mask) in enumerate(zip(chosen, library.masks(chosen), strict=True)):
        row, column = divmod(place, COLUMNS)
        left, top = MARGIN + column * step[0], MARGIN + row * step[1]
        picture = np.where(mask[..., None], SUPPORTED, UNSUPPORTED).astype(np.uint8)
        how = Image.Resampling.NEAREST if library.width < TILE_WIDTH else Image.Resampling.BOX
        canvas.paste(Image.fromarray(picture).resize(tile, how), (left, top))
        label = (
            f"{library.support[number]:.0%} support, {library.yaw[number]:+.3g}°, "
            f"{library.lateral[number]:+.3g} m"
        )
        draw.text((left, top + tile[1] + 3), label, fill=INK, font=font)
    return canvas


def support_shares(supports: dict[str, np.ndarray]) -> pd.DataFrame:  # each [N]
    """The share of each name's masks in bins of BIN, from the least support of all to 1."""
    least = min(support.min() for support in supports.values())
    edges = np.arange(np.floor(least / BIN), np.rint(1 / BIN) + 1) * BIN
    parts = []
    for name, support in supports.items():
        count, _ = np.histogram(support, edges)
        columns = {"low": edges[:-1], "high": edges[1:], "share": count / len(support)}
        parts.append(pd.DataFrame({"of": f"{name} (mean {support.mean():.2f})", **columns}))
    return pd.concat(parts, ignore_index=True)


def _draw_histograms(supports: dict[str, np.ndarray]) -> Image.Image:  # each [N]
    """One translucent histogram of support ratios for each name, over one another."""
    shares = support_shares(supports)
    colour = alt.Scale(domain=list(shares["of"].unique()), range=[LIBRARY_COLOUR, TEST_COLOUR])
    chart = (
        alt.Chart(shares)
        .mark_bar(opacity=0.55, binSpacing=0)
        .encode(
            x=alt.X("low:Q", bin="binned", title="support ratio"),
            x2="high:Q",
            y=alt.Y("share:Q", stack=None, title="share of masks", axis=alt.Axis(format="%")),
            color=alt.Color("of:N", scale=colour, legend=alt.Legend(title=None, orient="top")),
        )
        .properties(width=COLUMNS * (TILE_WIDTH + MARGIN) - 90, height=CHART_HEIGHT)
        .configure_axis(labelFontSize=13, titleFontSize=13, titleFontWeight="normal", grid=False)
        .configure_legend(labelFontSize=13, labelLimit=400)
        .configure_view(stroke=None)
    )
    picture = io.BytesIO()
    chart.save(picture, format="png")
    drawn = cv2.imdecode(np.frombuffer(picture.getvalue(), np.uint8), cv2.IMREAD_COLOR_RGB)
    return Image.fromarray(drawn)

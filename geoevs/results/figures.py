"""Pictures of a run: for every table a grid of targets against methods, with what scored them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from geoevs import layout
from geoevs.core.images import encode_png, read_image, to_uint8
from geoevs.protocol.condition_masks import ConditionMask
from geoevs.protocol.reference import SparseReference
from geoevs.protocol.targets import MASKED, RECORDED_SPLITS, Target
from geoevs.results.run_folder import refuse_links_out
from geoevs.results.table_specs import TableSpec, table_spec
from geoevs.run import Answers

TILE_WIDTH = 256
MARGIN = 4
HEADER = 22
DROPPED = "renders: dropped when scored"
"""The heading over what would be renders."""
BACKGROUND = (255, 255, 255)
INK = (20, 20, 20)
UNSUPPORTED = (90, 30, 90)
SUPPORTED = (45, 45, 45)
VALID = (120, 220, 120)
NEW = (255, 90, 60)
REMOVED = NEW  # what reprojection has and the mask hides

SHOWN = (layout.SCENE, layout.TARGETS, layout.REFERENCES, layout.MASKS, layout.TRUTH)
"""What a grid reads of a scene, besides renders."""


@dataclass(frozen=True)
class Row:
    """One line of a grid: its label and a picture, or nothing, for each column."""

    label: str
    pictures: list[np.ndarray | None]


def table_grid(
    table: str,
    run: Path,
    scenes: Sequence[tuple[str, str]],
    labels: Sequence[str],
    keeps: list,
    count: int | None = None,
) -> bytes:
    """The grid picture of a table as PNG bytes.

    Args:
        table: one of TABLES.
        run: the run's folder.
        scenes: (dataset, scene) pairs to show.
        labels: the entrants' labels, one column each; none where renders were dropped, which a
            column then says.
        keeps: the shares of the reference, for the sparsity table's rows.
        count: show this many random targets, the same ones every time, in place of a few telling.

    Raises:
        GeoEvsError: there is no such table, a link leads out of the run, or a file is damaged.
    """
    spec = table_spec(table)
    places = [Answers(run, *place) for place in scenes]
    for answers in places:
        shown_files = [answers.path(pattern) for pattern in SHOWN]
        refuse_links_out(run, [*shown_files, *map(answers.renders, labels)])
    targets = [
        [target for target in answers.targets if target.split in spec.splits] for answers in places
    ]
    if count is None:
        shown = [_pick(table, candidates, keeps) for candidates in targets]
    else:
        shown = [[(target, keeps[0]) for target in some] for some in _sample(targets, count)]
    rows = []
    for answers, picked in zip(places, shown, strict=True):
        for target, keep in picked:
            pictures = [truth_picture(answers, target)]
            if target.masked:
                pictures.append(mask_picture(answers.mask(target)))
            elif not target.recorded:
                reference = answers.reference(target)
                image = reference.image() * reference.mask(keep)[..., None]
                pictures += [_thicken(to_uint8(image)), validity_picture(reference, keep)]
            renders = [_read_render(answers.renders(label), target) for label in labels]
            share = "" if table != "sparsity" else f", {keep:.0%} of reference"
            name = f"{answers.name}, frame {target.frame}, {target.camera.name}{share}"
            rows.append(Row(name, [*pictures, *renders]))
    columns = [*_evidence_names(spec), *labels]
    used = [k for k in range(len(columns)) if any(row.pictures[k] is not None for row in rows)]
    more = [] if labels else [DROPPED]
    rows = [Row(row.label, [row.pictures[k] for k in used] + [None for _ in more]) for row in rows]
    return encode_png(draw_grid([columns[k] for k in used] + more, rows))


def truth_picture(answers: Answers, target: Target) -> np.ndarray | None:
    """(H, W, 3) uint8: the target's true pixels, or None where nobody knows them."""
    truth = answers.truth(target)
    return None if truth is None else to_uint8(truth)


def validity_picture(reference: SparseReference, keep: float = 1.0) -> np.ndarray:
    """(H, W, 3) uint8: where a target is scored, and what raw reprojection supports.

    Grey is supported by reprojection, purple is not; green pixels score, orange ones score and
    are new (not supported).
    """
    supported = reference.reprojected[..., None]
    picture = np.where(supported, SUPPORTED, UNSUPPORTED).astype(np.uint8)
    mask = reference.mask(keep)
    picture[mask & reference.reprojected] = VALID
    picture[mask & ~reference.reprojected] = NEW
    return picture


def mask_picture(mask: ConditionMask) -> np.ndarray:
    """(H, W, 3) uint8: how a masked target's condition was degraded.

    Grey is left to it, orange was hidden by the mask, purple had no support before.
    """
    supported = mask.supported[..., None]
    picture = np.where(supported, SUPPORTED, UNSUPPORTED).astype(np.uint8)
    picture[mask.removed] = REMOVED
    return picture


def draw_grid(columns: Sequence[str], rows: Sequence[Row]) -> np.ndarray:
    """Lay pictures out under column headings, each row under its own label; (H, W, 3) uint8.

    All take the shape of the first picture; without any, rows have their labels alone.
    """
    pictures = [picture for row in rows for picture in row.pictures if picture is not None]
    height = round(TILE_WIDTH * pictures[0].shape[0] / pictures[0].shape[1]) if pictures else 0
    size = (
        len(columns) * (TILE_WIDTH + MARGIN) + MARGIN,
        HEADER + len(rows) * (height + HEADER) + MARGIN,
    )
    canvas = Image.new("RGB", size, BACKGROUND)
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(size=13)
    for column, name in enumerate(columns):
        draw.text((MARGIN + column * (TILE_WIDTH + MARGIN), 3), name, fill=INK, font=font)
    for line, row in enumerate(rows):
        top = HEADER + line * (height + HEADER)
        draw.text((MARGIN, top + 3), row.label, fill=INK, font=font)
        for column, picture in enumerate(row.pictures):
            left = MARGIN + column * (TILE_WIDTH + MARGIN)
            if picture is None:
                draw.text((left + 8, top + HEADER + 8), "none", fill=INK, font=font)
                continue
            # Enlarged pixels stay sharp, so that sparse references can be read.
            grow = picture.shape[1] < TILE_WIDTH
            how = Image.Resampling.NEAREST if grow else Image.Resampling.BOX
            tile = Image.fromarray(picture).resize((TILE_WIDTH, height), how)
            canvas.paste(tile, (left, top + HEADER))
    return np.asarray(canvas)


def _evidence_names(spec: TableSpec) -> list[str]:
    if any(split.startswith(MASKED) for split in spec.splits):
        return ["truth", "mask"]
    if set(spec.splits) <= set(RECORDED_SPLITS):
        return ["recorded"]
    return ["truth", "sparse reference", "validity"]


def _thicken(picture: np.ndarray) -> np.ndarray:
    """Let single pixels survive when a picture is shrunk to a tile."""
    side = -(-picture.shape[1] // TILE_WIDTH)
    return cv2.dilate(picture, np.ones((side, side), np.uint8))


def _read_render(renders: Path, target: Target) -> np.ndarray | None:
    path = renders / f"{target.key}.png"
    return read_image(path) if path.is_file() else None


def _sample(targets: list[list[Target]], count: int) -> list[list[Target]]:
    """As many random ones of all scenes' targets, in their order."""
    places = [(scene, k) for scene, some in enumerate(targets) for k in range(len(some))]
    drawn = np.random.default_rng(0).permutation(len(places))[:count]
    kept = {places[number] for number in drawn}
    return [
        [target for k, target in enumerate(some) if (scene, k) in kept]
        for scene, some in enumerate(targets)
    ]


def _pick(table: str, targets: list[Target], keeps: list[float]) -> list[tuple[Target, float]]:
    """A few telling ones of a scene's targets, each with the share of its reference to show."""
    if not targets:  # a sweep without angles
        return []
    frames = sorted({target.frame for target in targets})
    middle = [target for target in targets if target.frame == frames[len(frames) // 2]]
    if table == "pose_offset":
        one_side = [target for target in middle if "left" in target.camera.name]
        farthest = max((target.lateral_shift for target in one_side), default=0.0)
        return [(target, keeps[0]) for target in one_side if target.lateral_shift == farthest]
    if table == "sparsity":
        return [(target, keep) for target in middle[:1] for keep in keeps]
    if table == "interpolation":
        return [(target, keeps[0]) for target in middle[:1]]
    splits = dict.fromkeys(target.split for target in middle)
    two_each = ([t for t in middle if t.split == split][:2] for split in splits)
    return [(target, keeps[0]) for target in itertools.chain.from_iterable(two_each)]

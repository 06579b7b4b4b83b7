"""Score rows of the stability suite: every stress, pose, and group of pixels of one method."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd

from geoevs import layout
from geoevs.core.files import read_json
from geoevs.geometry.moving import pixels_in_boxes
from geoevs.protocol.entries import FAILED, FINE, MethodEntry, cause, takes_part
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.pictures import read_view
from geoevs.protocol.regions import Answer
from geoevs.protocol.rows import protocol_fingerprint, score_frame
from geoevs.protocol.scoring import describe, score_regions
from geoevs.protocol.stability import CLEAN, OUTCOME_FILE, Stress, levels_of, stresses
from geoevs.protocol.stressors import STRESSORS, USUAL_METRICS
from geoevs.protocol.targets import Target
from geoevs.run import Answers
from geoevs.scenes.boxes import Box

MOVING, STILL = "dense-moving", "dense-still"
"""Regions inside boxes of the cars that drive, and outside of them."""

SPREADS = ("seed_spread_supported", "seed_spread_new")
"""Metrics of the spread: the standard deviation over draws of a pixel's channels in [0, 1], where
raw reprojection supports it and where not. Only generative methods have one without stress."""

EDGE = 0.1  # of the farther one's inverse depth: the least break between two surfaces
SKY = 1e-6  # its inverse depth, 1 / metres
BOX_MARGIN = 0.1  # metres around a car's box that still are its own, such as mirrors


def score_stresses(
    entry: MethodEntry, group: str, clean: Answers, settings: dict[str, Any]
) -> pd.DataFrame:
    """Score what `render_stresses` left of one group, as SCORE_TYPES says.

    In these rows `seed` is the draw. CLEAN gives the rows of `lateral`, `yaw` and `edges` as well,
    and how far the draws lie apart (SPREADS). Levels and draws are columns, so that the fingerprint
    holds of the settings only what scores of two scenes must share: the shifts of the targets.

    Args:
        entry: who rendered.
        group: a stressor, or CLEAN.
        clean: of the clean scene.
        settings: the config's `stability` section.
    """
    fingerprint = protocol_fingerprint(clean.scene, {"lateral": settings["lateral"]})
    common = {**clean.place, "fingerprint": fingerprint}
    renders = clean.path(layout.STABILITY_RENDERS, group=group, label=entry.label)
    rows = []
    for stress in stresses(group, settings):
        world = clean
        if stress.kind == "world":
            world = Answers(clean.run, clean.dataset, stress.world(clean.name))
        folder = renders / stress.key
        outcome = read_json(folder / OUTCOME_FILE)
        for target in world.targets:
            if group != CLEAN and target.split != "extrapolation":
                continue
            if not takes_part(outcome, target):
                continue
            preds, ending = read_view(folder, target, outcome)
            shared = {**common, **describe(entry, target), **cause(ending), "seed": stress.draw}
            for columns, names, regions in _questions(stress, world, clean, target, settings):
                scores = score_regions(names, preds, regions)
                rows += [{**shared, **columns, **score} for score in scores]
    if group == CLEAN:
        rows += _spread_rows(entry, clean, renders, settings, common)
    return score_frame(rows)


def _questions(
    stress: Stress, world: Answers, clean: Answers, target: Target, settings: dict[str, Any]
) -> Iterator[tuple[dict[str, Any], tuple[str, ...], dict[str, Answer]]]:
    """What is asked of one picture: columns `stressor` and `level`, metrics, and their regions."""
    regions = world.regions(target)
    columns = {"stressor": stress.stressor, "level": stress.level}
    if target.split == "lateral":
        columns = {"stressor": "lateral", "level": abs(target.lateral_shift)}
    if target.split == "yaw":
        columns = {"stressor": "yaw", "level": round(target.pose_offset, 6)}
    stressor = STRESSORS.get(columns["stressor"])  # none: CLEAN
    names = stressor.metrics if stressor else USUAL_METRICS
    depth = world.depth(target)
    if depth is not None and {MOVING, STILL} & {METRICS[name].region for name in names}:
        regions |= _by_motion(world, clean, target, depth, regions["dense"])
    yield columns, _known(names, regions) or _known(USUAL_METRICS, regions), regions
    if stress.kind == CLEAN and target.split == "extrapolation" and depth is not None:
        distance = edge_distance(depth)
        dense = regions["dense"]
        for level in levels_of("edges", settings):
            band = {"dense": Answer(dense.target, distance <= level, dense.support_ratio)}
            yield {"stressor": "edges", "level": level}, STRESSORS["edges"].metrics, band


def _known(names: tuple[str, ...], regions: dict[str, Answer]) -> tuple[str, ...]:
    """The metrics whose regions have an answer."""
    return tuple(name for name in names if METRICS[name].region in regions)


def _by_motion(
    world: Answers, clean: Answers, target: Target, depth: np.ndarray, dense: Answer
) -> dict[str, Answer]:
    """Every pixel's answer, split by whether a car that drives in the clean scene fills it."""
    tracks = clean.scene.tracks
    cars = tracks[tracks["moving"] & (tracks["label"] == "car")]["track"].unique()
    tracks = world.scene.tracks
    boxes = Box.rows(tracks[tracks["track"].isin(cars) & (tracks["frame"] == target.frame)])
    inside = pixels_in_boxes(depth, target.camera, boxes, BOX_MARGIN)
    return {
        MOVING: Answer(dense.target, inside, dense.support_ratio),
        STILL: Answer(dense.target, ~inside, dense.support_ratio),
    }


def edge_distance(depth: np.ndarray) -> np.ndarray:
    """(H, W) float32 distance of every pixel to the nearest one at a depth edge, in pixels.

    Args:
        depth: (H, W) metres, 0 = none (the sky, infinitely far away).

    >>> edge_distance(np.array([[5.0, 5.0, 9.0, 9.0, 9.1]])).tolist()
    [[1.0, 0.0, 0.0, 1.0, 2.0]]
    """
    across, down = depth_edges(depth)
    edge = np.zeros(depth.shape, bool)
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    return cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


def depth_edges(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mask the outlines between neighbours: (H, W - 1) across and (H - 1, W) down, bool.

    Inverse depth is linear on a plane, so that a road seen at a grazing angle has no edges however
    fast its depth rises: only what is no continuation of either side counts.
    """
    with np.errstate(divide="ignore"):
        inverse = np.where(depth > 0, 1.0 / depth.astype(np.float64), SKY)
    return _edges_down(inverse.T).T, _edges_down(inverse)


def _edges_down(inverse: np.ndarray) -> np.ndarray:
    """(H - 1, W) bool from (H, W): whether each two rows break apart."""
    step = np.diff(inverse, axis=0)
    bend = np.pad(np.abs(np.diff(step, axis=0)), ((1, 1), (0, 0)), constant_values=np.inf)
    least = EDGE * np.minimum(inverse[1:], inverse[:-1])
    return (np.abs(step) > least) & (np.minimum(bend[1:], bend[:-1]) > least)


def _spread_rows(
    entry: MethodEntry,
    clean: Answers,
    renders: Path,
    settings: dict[str, Any],
    common: dict[str, str],
) -> list[dict[str, Any]]:
    """SPREADS of the half-way targets; none where a draw failed or there is one draw alone."""
    folders = [renders / stress.key for stress in stresses(CLEAN, settings)]
    endings = [read_json(folder / OUTCOME_FILE) for folder in folders]
    if len(folders) < 2 or any(ending["status"] == FAILED for ending in endings):
        return []
    rows = []
    for target in clean.targets:
        if target.split != "extrapolation":
            continue
        drawn = zip(folders, endings, strict=True)
        pictures = [read_view(folder, target, ending)[0] for folder, ending in drawn]
        if any(picture is None for picture in pictures):
            continue
        spread = np.std(pictures, axis=0, ddof=1).mean(axis=2)
        supported = clean.reference(target).reprojected
        for name, region in zip(SPREADS, (supported, ~supported), strict=True):
            rows.append(
                {
                    **common,
                    **describe(entry, target),
                    **FINE,
                    "seed": 0,
                    "metric": name,
                    "stressor": CLEAN,
                    "level": 0.0,
                    "support_ratio": supported.mean(),
                    "valid_pixels": int(region.sum()),
                    "value": float(spread[region].mean()) if region.any() else np.nan,
                }
            )
    return rows

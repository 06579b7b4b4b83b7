"""The metric on trial: what the sparse reference says, against dense truth that only streets have.

Rows of six parts, one scene at a time:

- `agreement`: every sparse metric (`value`) beside its dense twin (`dense`), at shares of the
  reference;
- `random-support`: the same metrics over random pixels of the truth itself, so that nothing but
  support differs;
- `reference`: shares of reference pixels that are wrong, and why, under both visibility rules;
- `ceiling`: LiDAR coloured by the other cameras, against the photo of a recorded camera;
- `conditioning`: the metric on points that methods may read (`value`) and on those that they may
  not (`dense`);
- `harm`: distances of pictures, and of sets of them, under known harm (see
  `geoevs.protocol.harm`).
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from geoevs import layout
from geoevs.core.randomness import Rng
from geoevs.methods.contract import ORACLES
from geoevs.projection import colour_points, project_points, zbuffer
from geoevs.protocol.entries import OK, MethodEntry, read_outcomes
from geoevs.protocol.harm import harm_rows
from geoevs.protocol.masked_means import MaskedMean
from geoevs.protocol.metrics import MAE, METRICS, PSNR, RMSE, SSIM
from geoevs.protocol.pictures import read_view
from geoevs.protocol.stability_scoring import depth_edges
from geoevs.protocol.targets import ALL_CAMERAS, Target
from geoevs.run import Answers
from geoevs.scenes.camera import Camera
from geoevs.scenes.depths import read_depths
from geoevs.scenes.scene import PointCloud
from geoevs.scenes.store import Scene

AUDIT_TYPES = {
    **dict.fromkeys(("dataset", "scene", "target", "part", "method", "variant"), "string"),
    "metric": "string",
    "frame": "int64",
    "share": "float64",
    "support_ratio": "float64",
    "value": "float64",
    "dense": "float64",
    "pixels": "int64",
}
TWINS: dict[str, tuple[type[MaskedMean], str]] = {
    "sparse_psnr": (PSNR, "dense"),
    "sparse_psnr_footprint": (PSNR, "dense"),
    "sparse_psnr_new": (PSNR, "dense-new"),
    "sparse_mae": (MAE, "dense"),
    "sparse_rmse": (RMSE, "dense"),
    "sparse_ssim": (SSIM, "dense"),
    "sparse_ssim_zero_fill": (SSIM, "dense"),
}
"""The kind and region of each sparse metric's dense twin; `sparse_psnr_sum` is `sparse_psnr` less a
constant."""

SHARES = (1.0, 0.5, 0.2, 0.1, 0.05)
"""Shares of the reference's pixels, nested."""
SUPPORTS = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005)
"""Shares of a picture's pixels, nested, drawn at random."""

CELL = ((0, 0), (0, 1), (1, 0), (1, 1))
SURFACE = 0.05
"""Relative difference in depth up to which two pixels show one surface."""


def audit_rows(answers: Answers, entries: Sequence[MethodEntry], seed: int) -> pd.DataFrame:
    """All rows of one scene, as AUDIT_TYPES says; without dense truth, of the ceiling and harm.

    Args:
        answers: the scene's.
        entries: whose renders to judge; failed ones, and views, are passed over.
        seed: draws the random pixels, and the random harm.
    """
    folders = [(entry, answers.renders(entry.label)) for entry in entries]
    endings = [read_outcomes(folder / "render.json").get(ALL_CAMERAS, {}) for _, folder in folders]
    rendered = [
        (entry, folder, ending)
        for (entry, folder), ending in zip(folders, endings, strict=True)
        if ending.get("status") == OK
    ]
    rows = [*_ceiling(answers.scene), *harm_rows(answers, seed)]
    for target in answers.targets:
        if target.split != "extrapolation" or answers.depth(target) is None:
            continue
        rows += _reference_errors(answers, target)
        scores, reads = _halves(answers.scene, target)
        for entry, folder, ending in rendered:
            preds, _ = read_view(folder, target, ending)
            if preds is None:
                continue
            judged = [
                *_agreement(answers, target, preds),
                *_random_support(answers, target, preds, seed),
            ]
            if entry.method not in ORACLES:
                judged.append(_conditioning(preds, scores, reads))
            who = {"method": entry.method, "variant": entry.variant}
            which = {"target": target.camera.name, "frame": target.frame}
            rows += [{**who, **which, **row} for row in judged]
    blank = {"method": "", "variant": "", "share": 1.0, "dense": np.nan}
    filled = [{**answers.place, **blank, **row} for row in rows]
    return pd.DataFrame(filled, columns=list(AUDIT_TYPES)).astype(AUDIT_TYPES)


def _value(
    kind: type[MaskedMean], preds: np.ndarray, target: np.ndarray, mask: np.ndarray
) -> float:
    metric = kind()
    metric.update(preds, target, mask)
    return metric.compute()


def _agreement(answers: Answers, target: Target, preds: np.ndarray) -> Iterator[dict[str, Any]]:
    """Every sparse metric beside its twin, at all SHARES."""
    for share in SHARES:
        regions = answers.regions(target, share)
        for name, (kind, region) in TWINS.items():
            sparse, dense = regions[METRICS[name].region], regions[region]
            if sparse.mask.any():
                yield {
                    "part": "agreement",
                    "metric": name,
                    "share": share,
                    "support_ratio": sparse.mask.mean(),
                    "pixels": int(sparse.mask.sum()),
                    "value": _value(METRICS[name].kind, preds, sparse.target, sparse.mask),
                    "dense": _value(kind, preds, dense.target, dense.mask),
                }


def _random_support(
    answers: Answers, target: Target, preds: np.ndarray, seed: int
) -> Iterator[dict[str, Any]]:
    """The metrics over random pixels of the dense truth: what support alone does to them."""
    dense = answers.regions(target)["dense"]
    rank = Rng(seed, "support", answers.scene.info.name, target.key).numpy.random(dense.mask.shape)
    for name in ("sparse_psnr", "sparse_ssim", "sparse_ssim_zero_fill"):
        whole = _value(TWINS[name][0], preds, dense.target, dense.mask)
        for share in SUPPORTS:
            mask = rank < share
            yield {
                "part": "random-support",
                "metric": name,
                "share": share,
                "support_ratio": mask.mean(),
                "pixels": int(mask.sum()),
                "value": _value(METRICS[name].kind, preds, dense.target, mask),
                "dense": whole,
            }


def _reference_errors(answers: Answers, target: Target) -> Iterator[dict[str, Any]]:
    """Shares of reference pixels that are wrong, under either visibility rule, and what it costs.

    `leak`: the point lies behind everything that the truth shows in the 3 x 3 pixels around.
    `colour`: the image that gave the colour shows another surface in one of the four pixels that
    the colour was mixed of. `wrong` is either. `psnr` is the reference against the truth, and
    `psnr_right` that of the pixels that are not wrong: what a perfect method would score.
    """
    points = _scoring(answers.scene, target.frame)
    truth, depth = answers.truth(target), answers.depth(target)
    farthest = np.where(depth > 0, depth, np.inf)
    farthest = np.lib.stride_tricks.sliding_window_view(
        np.pad(farthest, 1, mode="edge"), (3, 3)
    ).max(axis=(2, 3))
    depths = read_depths(answers.path(layout.DEPTHS), target.frame)
    mixed = _mixed_colours(answers.scene, points, target.frame, depths)
    for visibility in ("pixel", "footprint"):
        buffer = zbuffer(points.xyz, target.camera, visibility)
        valid = buffer.mask.copy()
        valid[valid] = points.camera[buffer.index[valid]] >= 0
        if not valid.any():
            continue
        chosen = buffer.index[valid]
        leak = buffer.depth[valid] > farthest[valid] * (1 + SURFACE)
        wrong = leak | mixed[chosen]
        error = np.square(points.rgb[chosen] - truth[valid]).mean(axis=1)
        values = {
            "leak": leak.mean(),
            "colour": mixed[chosen].mean(),
            "wrong": wrong.mean(),
            "psnr": -10 * np.log10(error.mean()),
            "psnr_right": -10 * np.log10(error[~wrong].mean()) if (~wrong).any() else np.nan,
        }
        for name, value in values.items():
            yield {
                "part": "reference",
                "metric": f"{visibility}_{name}",
                "target": target.camera.name,
                "frame": target.frame,
                "support_ratio": valid.mean(),
                "pixels": int(valid.sum()),
                "value": float(value),
            }


def _mixed_colours(
    scene: Scene, points: PointCloud, frame: int, depths: dict[str, np.ndarray]
) -> np.ndarray:
    """(N,) bool: points whose colour was mixed of a pixel that shows another surface.

    `depths` are those of the recorded views, (H, W) metres by camera, 0 = none.
    """
    mixed = np.zeros(len(points), bool)
    for number, name in enumerate(scene.cameras):
        of_camera = np.flatnonzero(points.camera == number)
        camera = scene.camera(name, frame)
        uv, depth = project_points(points.xyz[of_camera], camera)
        last = np.array([camera.width, camera.height]) - 2
        column, row = np.clip(np.floor(uv - 0.5), 0, last).astype(int).T
        cell = np.stack([depths[name][row + down, column + right] for down, right in CELL])
        cell[cell == 0] = np.inf
        beyond = depth < cell.min(axis=0) * (1 - SURFACE)
        hidden = depth > cell.max(axis=0) * (1 + SURFACE)
        across, down = depth_edges(depths[name])
        torn = across[row, column] | across[row + 1, column] | down[row, column]
        mixed[of_camera] = hidden | beyond | torn | down[row, column + 1]
    return mixed


def _scoring(scene: Scene, frame: int) -> PointCloud:
    points = scene.points(frame)
    return points.select(scene.info.rig.scores(points))


def _ceiling(scene: Scene) -> Iterator[dict[str, Any]]:
    """What the photo of a recorded camera itself scores, on points that the others coloured."""
    for frame in scene.frames:
        points = _scoring(scene, frame)
        for name in scene.cameras:
            camera, photo = scene.camera(name, frame), scene.image(name, frame)
            others = {other: scene.camera(other, frame) for other in scene.cameras if other != name}
            images = {other: scene.image(other, frame) for other in others}
            coloured = colour_points(points, others, images, scene.ego_masks)
            image, mask = _shown(coloured, camera)
            row = {
                "part": "ceiling",
                "target": name,
                "frame": frame,
                "support_ratio": mask.mean(),
                "pixels": int(mask.sum()),
            }
            for metric, kind in (("sparse_psnr", PSNR), ("sparse_ssim", SSIM)):
                if mask.any():
                    yield {**row, "metric": metric, "value": _value(kind, photo, image, mask)}


def _shown(points: PointCloud, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The reference that coloured points make: (H, W, 3) image and (H, W) mask."""
    index = zbuffer(points.xyz, camera).index
    mask = index >= 0
    mask[mask] = points.camera[index[mask]] >= 0
    image = np.zeros((*mask.shape, 3), np.float32)
    image[mask] = points.rgb[index[mask]]
    return image, mask


def _halves(scene: Scene, target: Target) -> tuple[tuple, tuple]:
    """The references of the points that score, and of those that methods may read."""
    points = scene.points(target.frame)
    scores = scene.info.rig.scores(points)
    return tuple(_shown(points.select(half), target.camera) for half in (scores, ~scores))


def _conditioning(preds: np.ndarray, scores: tuple, reads: tuple) -> dict[str, Any]:
    return {
        "part": "conditioning",
        "metric": "sparse_psnr",
        "support_ratio": reads[1].mean(),
        "pixels": int(reads[1].sum()),
        "value": _value(PSNR, preds, *reads),
        "dense": _value(PSNR, preds, *scores),
    }

"""Whether a run's targets, answers and renders are there, and give the scores that rows have."""

import math
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.hashes import hash_path
from geoevs.core.images import read_image, to_float
from geoevs.core.names import inside
from geoevs.protocol.entries import EMPTY_MASK, FAILED, OK, label_of, read_outcomes
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.pictures import PICTURES
from geoevs.protocol.provenance import check_answers, check_renders
from geoevs.protocol.rows import protocol_fingerprint
from geoevs.protocol.scoring import THINNING, score_regions
from geoevs.protocol.targets import Target
from geoevs.results.verify_files import png_size
from geoevs.results.why_lookup import Record, chosen, terms_of
from geoevs.run import Answers

CLOSE = 1e-4
"""Relative difference up to which two machines' scores are the same."""

DROPPED = "renders were dropped when they were scored, as the config says"

SCENE = ["dataset", "scene"]
ENTRANT = ["method", "variant", "seed"]
VIEW = ["frame", "target"]


def check_scenes(record: Record, problems: list[str]) -> str:
    """Every scene has its store, targets and answers, and its rows are of its targets."""
    count, protocol = 0, record.config.get("protocol", {})
    for place, rows in record.scores.groupby(SCENE):
        answers = Answers(record.run, *place)
        targets = answers.targets
        count += len(targets)
        try:
            check_answers(answers, record.manifest["seed"], protocol)
        except GeoEvsError as error:
            problems.append(str(error))
        problems += _absent(answers)
        measured = set(rows["fingerprint"].unique())
        expected = protocol_fingerprint(answers.scene, protocol)
        if measured != {expected}:
            problems.append(
                f"{record.run / layout.SCORES}: rows of {'/'.join(place)} have the fingerprint "
                f"{', '.join(sorted(measured))}, but scene and manifest give {expected}"
            )
        known = {(target.frame, target.camera.name) for target in targets}
        asked = {(target.frame, target.camera.name) for target in targets if not target.masked}
        for entrant, mine in rows.groupby(ENTRANT):
            if not record.dropped:
                try:
                    check_renders(answers, label_of(*entrant))
                except GeoEvsError as error:
                    problems.append(str(error))
            have = set(mine[VIEW].itertuples(index=False, name=None))
            for views, what in ((have - known, "no targets"), (asked - have, "targets without")):
                if views:
                    problems.append(
                        f"{record.run / layout.SCORES}: {label_of(*entrant)} on {'/'.join(place)}: "
                        f"{len(views)} views are {what} rows, such as {min(views)}"
                    )
    return f"{count} targets"


def _absent(answers: Answers) -> Iterator[str]:
    """What a scene's targets lack of the answers that score them, or what has another size."""
    truths = answers.path(layout.TRUTH)
    dense = truths.is_dir() and any(truths.rglob("*.png"))
    for target in answers.targets:
        size = target.camera.height, target.camera.width
        shapes = {}
        if not target.recorded:
            shapes["reference"] = answers.reference(target).reprojected.shape
            if dense:
                shapes["truth"] = png_size(truths / f"{target.unmasked.key}.png")
        if target.masked:
            shapes["mask"] = answers.mask(target).keep.shape
        for what, shape in shapes.items():
            if shape != size:
                yield f"the {what} of {answers.path(layout.TARGETS)}: {target.key} is {shape}"


def check_pictures(record: Record, problems: list[str]) -> str:
    """Every render that rows score is there, a PNG of its target's size, and as it was sealed."""
    if record.dropped:
        return DROPPED
    count = 0
    for place, rows in record.scores.groupby(SCENE):
        answers = Answers(record.run, *place)
        targets = {(target.frame, target.camera.name): target for target in answers.targets}
        for entrant, mine in rows.groupby(ENTRANT):
            folder = answers.renders(label_of(*entrant))
            seals = _seals(folder)
            rendered = mine.loc[mine["status"] != FAILED, VIEW].drop_duplicates()
            for view in rendered.itertuples(index=False, name=None):
                if view in targets:
                    count += 1
                    problems += _picture_faults(folder, targets[view], seals)
            there = {path.relative_to(folder).as_posix() for path in folder.rglob("*.png")}
            for name in sorted(there - {f"{target.key}.png" for target in answers.targets}):
                problems.append(f"{folder / name} is a picture that no row scores")
    return f"{count} renders"


def _seals(folder: Path) -> dict[str, str]:
    """SHA-256 of pictures, by target key, as far as they were written down."""
    outcomes = read_outcomes(folder / "render.json")
    seals: dict[str, str] = {}
    for outcome in outcomes.values():
        seals |= outcome.get(PICTURES) or {}
    return seals


def _picture_faults(folder: Path, target: Target, seals: dict[str, str]) -> Iterator[str]:
    path = inside(folder, f"{target.key}.png", folder)
    size = png_size(path)
    if size is None:
        yield f"{path} is missing or no PNG"
    elif size != (target.camera.height, target.camera.width):
        yield f"{path} is {size}, its target {target.camera.height} x {target.camera.width}"
    elif target.key in seals and hash_path(path) != seals[target.key]:
        yield f"{path} is not the picture that was rendered"


def check_scores(record: Record, problems: list[str], count: int) -> str:
    """Some renders, the same ones every time, are scored again.

    Args:
        record: the run.
        problems: what is wrong is added to these.
        count: how many renders.
    """
    if record.dropped:
        return f"{DROPPED}, so no score can be made again"
    scores = record.scores[record.scores["status"].isin([OK, EMPTY_MASK])]
    views = scores[[*SCENE, *ENTRANT, *VIEW]].drop_duplicates()
    drawn = np.random.default_rng(0).permutation(len(views))[:count]
    compared = 0
    for view in views.iloc[sorted(drawn)].to_dict("records"):
        rows = chosen(scores, terms_of(**view))
        answers = Answers(record.run, view["dataset"], view["scene"])
        target = next(
            target
            for target in answers.targets
            if (target.frame, target.camera.name) == (view["frame"], view["target"])
        )
        label = label_of(*(view[name] for name in ENTRANT))
        for row, value in _again(rows, answers, answers.renders(label), target, record):
            compared += 1
            if value is not None:
                problems.append(
                    f"{label} on {view['dataset']}/{view['scene']}, {target.key}: {row.metric} is "
                    f"{value:.6g} by its picture, and {row.value:.6g} in {layout.SCORES}"
                )
    return f"{compared} scores of {len(drawn)} renders made again"


def _again(
    rows: pd.DataFrame, answers: Answers, renders: Path, target: Target, record: Record
) -> Iterator[tuple[Any, float | None]]:
    """A render's rows, each with its value by the picture where that is another."""
    preds = to_float(read_image(renders / f"{target.key}.png"))
    main = record.config["protocol"]["reference_keep"][0]
    regions = cache(partial(answers.regions, target))
    for row in rows.itertuples():
        if METRICS[row.metric].kind.missing():
            continue
        keep = row.level if row.stressor == THINNING else main
        (score,) = score_regions([row.metric], preds, regions(keep))
        yield row, None if _agree(row, score) else score["value"]


def _agree(row: Any, score: dict[str, Any]) -> bool:
    pair = row.value, score["value"]
    same = math.isclose(*pair, rel_tol=CLOSE, abs_tol=CLOSE) or all(map(math.isnan, pair))
    return same and row.valid_pixels == score["valid_pixels"]

"""No more than a scene needs: the size that a method chose, against the best of fixed sizes."""

import math
import re
from pathlib import Path
from typing import Any

import pandas as pd

from geoevs.methods.contract import DEFAULT
from geoevs.protocol.entries import FAILED
from geoevs.protocol.rows import check_fingerprints
from geoevs.protocol.targets import ALL_CAMERAS
from geoevs.results.bootstrap import summarise
from geoevs.results.entrants import INFO, Entrants
from geoevs.results.escaping import markdown_text
from geoevs.results.formats import markdown_grid, write_formats
from geoevs.results.machines import timed_on
from geoevs.results.settings import TableSettings
from geoevs.results.views import lacking

SPLIT, METRIC = "extrapolation", "sparse_psnr"
"""What a size is judged by, in dB; a method chooses by its sources alone."""

CHARTED = (METRIC, "psnr")
"""What the chart shows over sizes; the second where dense truth exists."""

ROWS_NEEDED = {"split": [SPLIT], "metric": CHARTED}
"""What the score rows of the table and the chart have in these columns (see `read_scores`)."""

CHOSEN, FIXED = DEFAULT, re.compile(r"\d+k")
"""The variant that chooses its size, and the names of those whose size is fixed, such as `8k`."""

ADDS_SIZES = (
    "snakemake --cores 2 --configfile config.yaml workflow/scales/complexity.yaml -- tables charts"
)
"""The command that adds fixed sizes to the default run."""

MEAN = "mean"
TITLE = "Sizes: chosen per scene, against fixed ones"
LEGEND = f"""{METRIC} in dB on the {SPLIT} split; sizes are primitives; seconds are of the fit from
all cameras. Regret: what the chosen size lacks of the best fixed one's dB, and takes more of its
seconds; negative is better. The best fixed size is found per scene, after the fact. Empty = not
run, or failed. A size that lacks a view that others of its scene have is left out there.
"""
_KEY = ["dataset", "method", "scene"]
_SIZE = [*_KEY, "variant"]


def make_complexity_table(
    scores: pd.DataFrame, costs: pd.DataFrame, entrants: Entrants
) -> pd.DataFrame:
    """A row for every scene of each method that was run with fixed sizes, and one of their means.

    A method's scenes are sorted by how much they hold: by the size that it chose there, the
    smallest first. Scenes without one come last.

    Args:
        scores: score rows.
        costs: cost rows.
        entrants: who plays.

    Returns:
        Columns `dataset`, `method`, `scene`, of the chosen size `chosen` (primitives), `psnr` and
        `seconds`, of the best fixed one `best`, `best_variant`, `best_psnr` and `best_seconds`,
        `regret_db`, `regret_seconds`, `note`, `timed_on`, a sentence on the machines of the data
        set's fits where they are several, and the method's `name`, `paradigm`, `extra_prior`,
        `needs` and `sees`. A data set without fixed sizes has one row that says so.

    Raises:
        GeoEvsError: the rows come from different protocols.
    """
    check_fingerprints(scores)
    fits = _fits(scores, costs)
    table: list[dict[str, Any]] = []
    for dataset in scores["dataset"].unique():
        here = fits[fits["dataset"] == dataset]
        methods = here.loc[_is_fixed(here), "method"].unique()
        for method in methods:
            of_method = here[here["method"] == method]
            rows = [
                {"dataset": dataset, "method": method, "scene": scene} | _row(of_scene)
                for scene, of_scene in of_method.groupby("scene", sort=False)
            ]
            rows.sort(key=lambda row: (row.get("chosen", math.inf), row["scene"]))
            about = entrants.columns(method, CHOSEN)
            table += [row | about for row in (*rows, _mean(rows))]
        if not len(methods):
            table.append({"dataset": dataset, "note": "no fixed size was run"})
    numbers = ["chosen", "psnr", "seconds", "best", "best_psnr", "best_seconds"]
    numbers += ["regret_db", "regret_seconds"]
    columns = [*_KEY, *numbers[:4], "best_variant", *numbers[4:], "note", "timed_on", *INFO]
    made = pd.DataFrame(table, columns=columns)
    made["timed_on"] = made["dataset"].map(timed_on(costs)).fillna("").astype("str")
    return made.astype(dict.fromkeys(numbers, "float64"))


def write_complexity_table(
    stem: Path, scores: pd.DataFrame, costs: pd.DataFrame, entrants: Entrants
) -> None:
    """Write `make_complexity_table` as CSV and Markdown; `stem` is the path without suffix."""
    write_formats(stem, make_complexity_table(scores, costs, entrants), complexity_markdown)


def _fits(scores: pd.DataFrame, costs: pd.DataFrame) -> pd.DataFrame:
    """Mean score, size and seconds by scene and entrant; seeds and then frames are averaged.

    A fit that lacks views that other sizes of its scene have has its number of them in `lacking`.
    """
    rows = scores[(scores["split"] == SPLIT) & (scores["metric"] == METRIC)]
    rows = rows[rows["stressor"] == ""]
    missing = lacking(rows[_is_size(rows)], _SIZE, ["variant"]).set_index(_SIZE)
    rows = rows[rows["value"].notna()]
    frames = rows.groupby([*_SIZE, "frame"], sort=False)["value"].mean()
    psnr = frames.groupby(_SIZE, sort=False).mean().rename("psnr")
    asked = costs.loc[costs["sources"] == ALL_CAMERAS, _SIZE].drop_duplicates().set_index(_SIZE)
    return asked.join(missing, how="inner").join(_spent(costs)).join(psnr).reset_index()


def _spent(costs: pd.DataFrame) -> pd.DataFrame:
    """Mean `primitives` and `fit_seconds` by scene and entrant, of fits from all cameras."""
    fits = costs[(costs["sources"] == ALL_CAMERAS) & (costs["status"] != FAILED)]
    return fits.groupby(_SIZE, sort=False)[["primitives", "fit_seconds"]].mean()


def _is_fixed(rows: pd.DataFrame) -> pd.Series:
    return rows["variant"].map(lambda name: bool(FIXED.fullmatch(name))).astype(bool)


def _is_size(rows: pd.DataFrame) -> pd.Series:
    return _is_fixed(rows) | (rows["variant"] == CHOSEN)


def _row(of_scene: pd.DataFrame) -> dict[str, Any]:
    partial = of_scene["lacking"] > 0
    here = of_scene[~partial & of_scene["psnr"].notna()]
    chosen = here[here["variant"] == CHOSEN]
    fixed = here[_is_fixed(here)]
    row: dict[str, Any] = {}
    if len(chosen):
        (fit,) = chosen.to_dict("records")
        row |= dict(zip(("chosen", "psnr", "seconds"), _numbers(fit), strict=True))
    if len(fixed):
        best = fixed.loc[fixed["psnr"].idxmax()].to_dict()
        names = ("best", "best_psnr", "best_seconds")
        row |= dict(zip(names, _numbers(best), strict=True)) | {"best_variant": best["variant"]}
    if len(chosen) and len(fixed):
        row["regret_db"] = row["best_psnr"] - row["psnr"]
        row["regret_seconds"] = row["seconds"] - row["best_seconds"]
    said = {
        "no chosen size here": chosen.empty,
        "no fixed size here": fixed.empty,
        f"views are missing of {', '.join(of_scene.loc[partial, 'variant'])}": partial.any(),
    }
    row["note"] = "; ".join(text for text, holds in said.items() if holds)
    return row


def _numbers(fit: dict[str, Any]) -> tuple[float, float, float]:
    return fit["primitives"], fit["psnr"], fit["fit_seconds"]


def _mean(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The means over scenes that have both, so that all columns are of the same ones."""
    whole = pd.DataFrame([row for row in rows if "regret_db" in row])
    means = whole.select_dtypes("number").mean().to_dict() if len(whole) else {}
    note = f"of {len(whole)} scenes" + (f", not all {len(rows)}" if len(whole) < len(rows) else "")
    return {**{key: rows[0][key] for key in _KEY}, "scene": MEAN, **means, "note": note}


def complexity_markdown(table: pd.DataFrame) -> str:
    """A heading, one table for every data set, and a legend."""
    header = [
        "method",
        "scene",
        "chosen",
        "dB",
        "s",
        "best fixed",
        "dB",
        "s",
        "regret dB",
        "regret s",
        "note",
    ]
    forms = {
        "chosen": ",.0f",
        "psnr": ".2f",
        "seconds": ".1f",
        "best": ",.0f",
        "best_psnr": ".2f",
        "best_seconds": ".1f",
        "regret_db": "+.2f",
        "regret_seconds": "+.1f",
    }
    parts = [f"# {TITLE}\n"]
    for dataset, rows in table.groupby("dataset", sort=False):
        body = []
        for row in rows.to_dict("records"):
            named = isinstance(row["method"], str)
            line = [row["name"], row["scene"]] if named else ["", ""]
            line += [
                "" if math.isnan(row[name]) else format(row[name], form)
                for name, form in forms.items()
            ]
            body.append([*line, row["note"]])
        parts.append(f"## {dataset}\n\n{markdown_grid(header, body)}\n")
        if said := rows["timed_on"].iloc[0]:
            parts.append(f"**{markdown_text(said)}**\n")
    parts.append(LEGEND)
    return "\n".join(parts)


def size_curves(
    scores: pd.DataFrame, costs: pd.DataFrame, settings: TableSettings, entrants: Entrants
) -> pd.DataFrame:
    """Accuracy over size, for every scene of each method that was run with fixed sizes.

    Args:
        scores: score rows.
        costs: cost rows.
        settings: the config's `tables` section.
        entrants: who plays.

    Returns:
        A row for every fit and metric of CHARTED: `dataset`, `method`, `scene`, `variant` (CHOSEN,
        or a fixed size), `metric`, `mean` with its interval `low` and `high` over frames, `n`,
        `primitives`, `fit_seconds`, `chosen`, the primitives that the method chose for the scene,
        its `name`, and `lacking`, how many views it lacks that other sizes have. Scenes as in the
        table, sizes rising. Empty where no fixed size was run.

    Raises:
        GeoEvsError: the rows come from different protocols.
    """
    check_fingerprints(scores)
    rows = scores[(scores["split"] == SPLIT) & scores["metric"].isin(CHARTED)]
    rows = rows[rows["stressor"] == ""]
    by = [*_SIZE, "metric"]
    means = summarise(rows, by, *settings.bootstrap)
    means = means.drop(columns="failed").dropna(subset="mean")
    fits = means.merge(_spent(costs).reset_index(), on=[*_KEY, "variant"])
    fits = fits.assign(chosen=math.nan, name=fits["method"].map(entrants.name))
    fits = fits[_is_size(fits)].merge(lacking(rows[_is_size(rows)], by, ["variant"]), on=by)
    sized = [fits[:0]]
    for _, curve in fits.groupby(["dataset", "method"], sort=False):
        if _is_fixed(curve).any():
            sizes = curve[curve["variant"] == CHOSEN].drop_duplicates("scene").set_index("scene")
            curve = curve.assign(chosen=curve["scene"].map(sizes["primitives"]))
            sized.append(curve.sort_values(["chosen", "scene", "primitives"], kind="stable"))
    return pd.concat(sized, ignore_index=True)

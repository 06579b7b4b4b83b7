"""What the parts of a method are worth: the full model against its variants (paper table 4)."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from geoevs.methods.contract import DEFAULT
from geoevs.protocol.entries import FAILED
from geoevs.protocol.rows import check_fingerprints
from geoevs.results.bootstrap import PAIR, paired_difference, summarise
from geoevs.results.entrants import ENTRANT, Entrants
from geoevs.results.formats import latex_tabular, markdown_grid, with_interval, write_formats
from geoevs.results.paper import paper_values
from geoevs.results.settings import TableSettings
from geoevs.results.views import MARK, MARKED, VIEW, lacking

FULL = DEFAULT
"""The variant that is the full model."""

PARTS = ("psnr_supported", "psnr_removed", "psnr_never", "psnr_unsupported")
MEASURES = (
    ("extrapolation", "sparse_psnr"),
    ("observed", "psnr"),
    *(("masked-observed", metric) for metric in PARTS),
    *(("masked-extrapolation", metric) for metric in (*PARTS, "sparse_psnr_removed")),
)
"""Split and metric of every column; the paper has the first alone. All are in dB."""

TITLE = "Ablation: masks in training (paper table 4)"
LEGEND = f"""First table: mean [bootstrap interval over frames within scenes], dB. Second table: the
full model minus the variant, paired by scene, frame, target and training seed [bootstrap interval
over frames within scenes and over seeds]; bold where the interval leaves out zero. Third table:
standard deviation over training seeds of a seed's mean. `paper` = printed in the paper, measured
there on Waymo. Masked views: `supported` pixels are left in the degraded condition, `removed` ones
were hidden by the mask, `never` ones had no support before it, and `unsupported` are those two
together. Empty = not run, or not measurable here.
{MARKED}
Differences
and spreads are of the views that all compared delivered.
"""


def rows_needed(settings: TableSettings) -> dict[str, Sequence[str]]:
    """What the score rows of the ablation have in their columns of text (see `read_scores`)."""
    return {"method": [settings.ablation]}


def make_ablation_table(
    scores: pd.DataFrame, settings: TableSettings, entrants: Entrants
) -> pd.DataFrame:
    """A row for every data set and variant of the ablated method, the full model last.

    Args:
        scores: score rows.
        settings: the config's `tables` section, which names the method.
        entrants: who plays.

    Returns:
        Columns `dataset`, `variant`, `seeds` (how many), and for every measure (see `column_name`)
        its mean, `_low` and `_high`, of the paired difference full model minus variant `_diff`,
        `_diff_low` and `_diff_high`, and `_seed_sd`, the standard deviation of the seeds' means
        over the views that all of them delivered;
        `_paper` where the paper has it; `failed` views, `partial` (measures whose mean lacks views
        that other variants have), `note`, `method`, and the entrant's `name`, `paradigm`,
        `extra_prior`, `needs` and `sees`.
        A data set without any variant has one row that says so.

    Raises:
        GeoEvsError: the rows come from different protocols.
    """
    check_fingerprints(scores)
    ours = scores[(scores["method"] == settings.ablation) & (scores["stressor"] == "")]
    table = []
    for dataset in scores["dataset"].unique():
        rows = ours[ours["dataset"] == dataset]
        variants = sorted(rows["variant"].unique(), key=lambda variant: variant == FULL)
        table += [
            {"dataset": dataset, **_row(rows, variant, settings)} for variant in variants or [""]
        ]
    return entrants.describe(pd.DataFrame(table).assign(method=settings.ablation))


def write_ablation_table(
    stem: Path, scores: pd.DataFrame, settings: TableSettings, entrants: Entrants
) -> None:
    """Write `make_ablation_table` as CSV, Markdown and LaTeX; `stem` is the path without suffix."""
    table = make_ablation_table(scores, settings, entrants)
    write_formats(stem, table, ablation_markdown, ablation_latex)


def column_name(split: str, metric: str) -> str:
    """A measure's column.

    >>> column_name("masked-observed", "psnr_never")
    'masked_observed_psnr_never'
    """
    return f"{split.replace('-', '_')}_{metric}"


def _row(rows: pd.DataFrame, variant: str, settings: TableSettings) -> dict[str, Any]:
    of_variant, full = (rows[rows["variant"] == name] for name in (variant, FULL))
    summary = summarise(of_variant, ["split", "metric"], *settings.bootstrap)
    summary = summary.set_index(["split", "metric"])
    missing = lacking(rows, [*ENTRANT, "split", "metric"])
    missing = missing[(missing["variant"] == variant) & (missing["lacking"] > 0)]
    missing = set(missing[["split", "metric"]].itertuples(index=False, name=None))
    row: dict[str, Any] = {"variant": variant, "seeds": of_variant["seed"].nunique()}
    partial = []
    pairs = 0
    printed = paper_values("ablation").get(settings.ablation)
    for split, metric in MEASURES:
        name = column_name(split, metric)
        if printed and (split, metric) == MEASURES[0]:
            row[f"{name}_paper"] = printed.get(variant, {}).get(metric, math.nan)
        for suffix, column in (("", "mean"), ("_low", "low"), ("_high", "high")):
            row[name + suffix] = summary[column].get((split, metric), math.nan)
        if (split, metric) in missing and not math.isnan(row[name]):
            partial.append(name)
        others = _of(of_variant, split, metric) if variant != FULL else of_variant[:0]
        difference = paired_difference(_of(full, split, metric), others, *settings.bootstrap)
        row[f"{name}_diff"] = difference.mean
        row[f"{name}_diff_low"], row[f"{name}_diff_high"] = difference.low, difference.high
        row[f"{name}_seed_sd"] = _seed_spread(_of(of_variant, split, metric))
        pairs += difference.pairs
    row["failed"] = len(of_variant[of_variant["status"] == FAILED].drop_duplicates(PAIR))
    row["partial"] = " ".join(partial)
    row["note"] = _note(settings.ablation, variant, row["failed"], pairs)
    return row


def _seed_spread(rows: pd.DataFrame) -> float:
    """The standard deviation of the seeds' means over the views that all seeds have a value of."""
    rows = rows[rows["value"].notna()]
    views = [rows[name] for name in VIEW]
    whole = rows.groupby(views, dropna=False)["seed"].transform("nunique") == rows["seed"].nunique()
    return float(rows[whole].groupby("seed")["value"].mean().std())


def _of(rows: pd.DataFrame, split: str, metric: str) -> pd.DataFrame:
    return rows[(rows["split"] == split) & (rows["metric"] == metric)]


def _note(method: str, variant: str, failed: int, pairs: int) -> str:
    if not variant:
        return f"no variant of {method} was run"
    if failed:
        return f"failed on {failed} views"
    return "no pair with the full model" if variant != FULL and not pairs else ""


def ablation_markdown(table: pd.DataFrame) -> str:
    """Scores, then differences, one column a variant, for every data set."""
    parts = [f"# {TITLE}\n"]
    for dataset, rows in table.groupby("dataset", sort=False):
        parts.append(f"## {dataset}\n")
        if not rows["variant"].any():
            parts.append(f"{rows['note'].iloc[0].capitalize()}.\n")
        parts += [f"{markdown_grid(header, body)}\n" for header, body in _grids(rows)]
    return "\n".join([*parts, LEGEND])


def ablation_latex(table: pd.DataFrame) -> str:
    """The same as booktabs tabulars, with a rule between splits."""
    parts = [f"% {TITLE}"]
    for dataset, rows in table.groupby("dataset", sort=False):
        if not rows["variant"].any():
            parts.append(f"% {dataset}: {rows['note'].iloc[0]}")
        for header, body in _grids(rows):
            groups = [line[0].split()[0] for line in body]
            parts.append(f"% {dataset}\n{latex_tabular(header, body, groups)}")
    return "\n\n".join(parts) + "\n"


Grid = tuple[list[str], list[list[str]]]


def _grids(rows: pd.DataFrame) -> Iterator[Grid]:
    """Header and lines of the scores, and of the differences where there is anything to compare."""
    variants = [row for row in rows.to_dict("records") if row["variant"]]
    if not variants:
        return
    notes = ["note", *(row["note"] for row in variants)]
    seeds = ["seeds", *(str(row["seeds"]) for row in variants)]
    yield _grid("dB ↑", variants, _score, _paper_score, [seeds, notes])
    others = [row for row in variants if row["variant"] != FULL]
    if others and len(others) < len(variants):
        yield _grid("full model minus, dB", others, _difference, _paper_difference, [])
    if any(row["seeds"] > 1 for row in variants):
        yield _grid("over seeds, dB", variants, _spread, lambda row, name: "", [])


def _grid(
    corner: str,
    variants: list[dict[str, Any]],
    cell: Callable[[dict[str, Any], str], str],
    paper_cell: Callable[[dict[str, Any], str], str],
    more: list[list[str]],
) -> Grid:
    header = [corner, *(row["name"] for row in variants)]
    body = []
    for split, metric in MEASURES:
        name = column_name(split, metric)
        if f"{name}_paper" in variants[0]:
            printed = (paper_cell(row, name) for row in variants)
            body.append([f"{split} {metric} paper", *printed])
        body.append([f"{split} {metric}", *(cell(row, name) for row in variants)])
    return header, [*body, *(line for line in more if any(line[1:]))]


def _score(row: dict[str, Any], name: str) -> str:
    text = with_interval("{:.2f}", row[name], row[f"{name}_low"], row[f"{name}_high"])
    return f"{text} {MARK}" if name in row["partial"].split() else text


def _paper_score(row: dict[str, Any], name: str) -> str:
    return with_interval("{:.2f}", row[f"{name}_paper"], math.nan, math.nan)


def _difference(row: dict[str, Any], name: str) -> str:
    low, high = row[f"{name}_diff_low"], row[f"{name}_diff_high"]
    text = with_interval("{:+.2f}", row[f"{name}_diff"], low, high)
    return f"**{text}**" if low > 0 or high < 0 else text


def _spread(row: dict[str, Any], name: str) -> str:
    return with_interval("{:.2f}", row[f"{name}_seed_sd"], math.nan, math.nan)


def _paper_difference(row: dict[str, Any], name: str) -> str:
    metric = MEASURES[0][1]
    full = paper_values("ablation")[row["method"]][FULL][metric]
    return with_interval("{:+.2f}", full - row[f"{name}_paper"], math.nan, math.nan)

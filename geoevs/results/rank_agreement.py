"""Whether methods come in the paper's order here: Kendall's tau for every table of methods."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import kendalltau

from geoevs.methods.contract import DEFAULT
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.rows import check_fingerprints
from geoevs.results.bootstrap import redraw
from geoevs.results.entrants import ENTRANT
from geoevs.results.formats import markdown_grid, write_formats
from geoevs.results.paper import paper_method, paper_values
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import table_spec
from geoevs.results.views import with_lacking

RANKED_TABLES = ("extrapolation", "interpolation")
"""Those in which the paper sets methods side by side that this suite runs (tables 2 and 5)."""

RANKED = {
    table: [
        metric
        for metric in table_spec(table).metrics
        if any(metric in printed for printed in paper_values(table).values())
    ]
    for table in RANKED_TABLES
}
"""Metrics of each of them that are both printed and measured."""

ROWS_NEEDED = {
    "split": [split for table in RANKED for split in table_spec(table).splits],
    "metric": list(dict.fromkeys(metric for metrics in RANKED.values() for metric in metrics)),
}
"""What the score rows that are ranked have in these columns (see `read_scores`)."""

TITLE = "Does the paper's order of methods hold here?"
LEGEND = """Kendall's tau between the paper's means and ours [bootstrap interval: frames redrawn
within scenes, the same for all methods]; 1 = the same order, -1 = reversed, 0 = unrelated. With
five methods even a chance order has a tau of 0.6 or more in 12 % of cases. Orders are from best to
worst. Left out = methods of the paper's table that this run has no values of, or that lack views
that others have: their means are of other views, and no order holds them.
"""


def make_rank_agreement(scores: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """A row for every data set, table of the paper and metric that is both printed and measured.

    Args:
        scores: score rows.
        settings: the config's `tables` section.

    Returns:
        Columns `dataset`, `table`, `metric`, `tau`, its interval's ends `tau_low` and `tau_high`
        (NaN with fewer than two methods, and the ends with one frame a scene), `methods` (how many
        are ranked: those that lack no view that any entrant has), `left_out` (how many of the
        paper's are not), and the orders `paper` and `here`.

    Raises:
        GeoEvsError: the rows come from different protocols.
    """
    check_fingerprints(scores)
    whole = scores[scores["stressor"] == ""]
    whole = with_lacking(whole, [*ENTRANT, "split", "metric"])
    whole = whole[(whole["lacking"] == 0) & (whole["variant"] == DEFAULT)]
    return pd.DataFrame(
        [
            {"dataset": dataset, "table": table, "metric": metric}
            | _agreement(whole[whole["dataset"] == dataset], table, metric, settings)
            for dataset in scores["dataset"].unique()
            for table, metrics in RANKED.items()
            for metric in metrics
        ]
    )


def write_rank_agreement(stem: Path, scores: pd.DataFrame, settings: TableSettings) -> None:
    """Write `make_rank_agreement` as CSV and Markdown; `stem` is the path without suffix."""
    write_formats(stem, make_rank_agreement(scores, settings), rank_agreement_markdown)


def rank_agreement_markdown(table: pd.DataFrame) -> str:
    """A heading, one table for every data set, and a legend."""
    parts = [f"# {TITLE}\n"]
    header = ["table", "metric", "tau", "methods", "left out", "paper", "here"]
    for dataset, rows in table.groupby("dataset", sort=False):
        body = []
        for row in rows.to_dict("records"):
            tau = "" if np.isnan(row["tau"]) else f"{row['tau']:.2f}"
            if not np.isnan(row["tau_low"]):
                tau += f" [{row['tau_low']:.2f}, {row['tau_high']:.2f}]"
            counts = [str(row["methods"]), str(row["left_out"])]
            body.append([row["table"], row["metric"], tau, *counts, row["paper"], row["here"]])
        parts.append(f"## {dataset}\n\n{markdown_grid(header, body)}\n")
    return "\n".join([*parts, LEGEND])


def _agreement(
    scores: pd.DataFrame, table: str, metric: str, settings: TableSettings
) -> dict[str, Any]:
    """One row but for its key; `scores` are of one data set."""
    printed = {name: row[metric] for name, row in paper_values(table).items() if metric in row}
    rows = scores[scores["split"].isin(table_spec(table).splits) & (scores["metric"] == metric)]
    rows = rows[rows["method"].isin(list(printed)) & np.isfinite(rows["value"])]
    # Frames by methods; a frame that some method copied exactly ranks nobody.
    cells = rows.pivot_table("value", ["scene", "frame"], "method").dropna()
    methods = [name for name in printed if name in cells.columns]
    row = {"tau": np.nan, "tau_low": np.nan, "tau_high": np.nan, "methods": len(methods)}
    row["left_out"] = len(printed) - len(methods)
    paper = np.array([printed[name] for name in methods])
    row["paper"] = row["here"] = ""
    if cells.empty:
        return row
    values = cells[methods].to_numpy()
    means = values.mean(axis=0)
    sign = 1 if METRICS[metric].higher_is_better else -1
    row["paper"], row["here"] = _order(methods, sign * paper), _order(methods, sign * means)
    if len(methods) < 2:
        return row
    row["tau"] = kendalltau(paper, means).statistic
    scenes = cells.index.get_level_values("scene").to_numpy(object)
    if len(set(scenes)) == len(scenes):  # one frame each: nothing can be redrawn
        return row
    frames = redraw(scenes, settings.resamples, np.random.default_rng(0))
    taus = [kendalltau(paper, drawn).statistic for drawn in frames @ values]
    row["tau_low"], row["tau_high"] = np.nanquantile(taus, settings.tails, method="inverted_cdf")
    return row


def _order(methods: list[str], values: np.ndarray) -> str:
    """The paper's names from the highest value to the lowest."""
    return " > ".join(paper_method(methods[n])["name"] for n in np.argsort(-values))

"""By how much one entrant is better than another on the same views, and how surely."""

from dataclasses import astuple
from pathlib import Path

import pandas as pd

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.results.bootstrap import PairedDifference, paired_difference, summarise
from geoevs.results.formats import arrow, decimals, number, with_interval
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import TABLES, bin_names, table_rows
from geoevs.results.why_lookup import Record, known

COLUMNS = ["bin", "metric", "first", "second", "difference", "low", "high", "pairs"]


def compare_entrants(
    table: str, first: str, second: str, run: Path, dataset: str = ""
) -> pd.DataFrame:
    """Two entrants' means and paired difference in every bin and metric of a table.

    Args:
        table: one of TABLES.
        first: an entrant, METHOD or METHOD.VARIANT as in the config.
        second: the one that is subtracted from it.
        run: the run's folder.
        dataset: the data set; the run's first where it is empty.

    Returns:
        COLUMNS, a row for every bin and metric in which any view gives a pair: the entrants' means
        as in the table, then first minus second over pairs (see `paired_of`) with its interval.

    Raises:
        GeoEvsError: there is no such table, data set or entrant (the sentence names the nearest),
            or no view has a finite value of both.
    """
    spec = TABLES[known("table", table, TABLES)]
    record = Record(run)
    dataset = record.dataset(dataset)
    entrants = [record.entrant(name, dataset) for name in (first, second)]
    settings = record.settings
    rows = table_rows(spec, record.scores[record.scores["dataset"] == dataset], settings)
    found = []
    for label in bin_names(spec, settings):
        for metric in spec.metrics:
            here = rows[(rows["bin"] == label) & (rows["metric"] == metric)]
            both = [rows_of(here, entrant.method, entrant.variant) for entrant in entrants]
            difference = paired_of(*both, settings)
            if difference.pairs:
                means = [_mean(mine, settings) for mine in both]
                found.append((label, metric, *means, *astuple(difference)))
    if not found:
        raise GeoEvsError(
            f"no view of table {table} has a finite value of both {first} and {second} on "
            f"{dataset}; {run / layout.SCORES} says what failed"
        )
    return pd.DataFrame(found, columns=COLUMNS)


def rows_of(rows: pd.DataFrame, method: str, variant: str) -> pd.DataFrame:
    """The score rows of one entrant, of all its seeds."""
    return rows[(rows["method"] == method) & (rows["variant"] == variant)]


def paired_of(
    rows: pd.DataFrame, others: pd.DataFrame, settings: TableSettings
) -> PairedDifference:
    """`paired_difference` of two entrants whatever their seeds and levels of stress.

    An entrant of one seed, as controls are, meets every seed of the other. Views that were scored
    at several levels meet at the same level.

    Args:
        rows: score rows of one entrant, of one data set, bin and metric.
        others: the same of the other entrant.
        settings: the config's `tables` section.
    """
    rows = _at_seeds_of(others, rows)
    others = _at_seeds_of(rows, others)
    levelled = (
        some.assign(target=some["target"] + "@" + some["level"].astype(str))
        for some in (rows, others)
    )
    return paired_difference(*levelled, *settings.bootstrap)


def _at_seeds_of(others: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    if rows["seed"].nunique() != 1:
        return rows
    seeds = others[["seed"]].drop_duplicates()
    return rows.drop(columns="seed").merge(seeds, how="cross")


def _mean(rows: pd.DataFrame, settings: TableSettings) -> float:
    return summarise(rows, ["metric"], *settings.bootstrap)["mean"].item()


def comparison_text(table: pd.DataFrame, first: str, second: str) -> str:
    """What `compare_entrants` found, in aligned columns."""
    lines = [
        (
            row.bin,
            f"{row.metric} {arrow(row.metric)}",
            number(row.metric, row.first),
            number(row.metric, row.second),
            with_interval(f"{{:+.{decimals(row.metric)}f}}", row.difference, row.low, row.high),
            row.pairs,
        )
        for row in table.itertuples()
    ]
    shown = pd.DataFrame(lines, columns=["bin", "metric", first, second, "difference", "pairs"])
    return shown.loc[:, shown.ne("").any()].to_string(index=False)

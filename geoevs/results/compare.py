"""By how much one entrant is better than another on the same views, and how surely."""

from pathlib import Path

import pandas as pd

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.results.formats import arrow, decimals, number, with_interval
from geoevs.results.table_specs import TABLES, bin_names, rows_needed, table_rows
from geoevs.results.views import paired_of, rows_of
from geoevs.results.why_lookup import Record, known

COLUMNS = ["bin", "metric", "first", "second", "difference", "low", "high", "pairs", "left_out"]
LEFT_OUT = (
    "All numbers are of the pairs. Left out: views that one of the two failed on, has no value of, "
    "or copied exactly; means in tables may hold them."
)


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
        COLUMNS, a row for every bin and metric in which any view gives a pair: the entrants' means,
        then first minus second with its interval, all over the pairs alone (see `paired_of`); how
        many they are, and how many views give none because one of the two has no finite value.

    Raises:
        GeoEvsError: there is no such table, data set or entrant (the sentence names the nearest),
            or no view has a finite value of both.
    """
    spec = TABLES[known("table", table, TABLES)]
    record = Record(run)
    record.needed = rows_needed(spec)
    dataset = record.dataset(dataset)
    entrants = [record.entrant(name, dataset) for name in (first, second)]
    settings = record.settings
    rows = table_rows(spec, record.scores[record.scores["dataset"] == dataset], settings)
    found = []
    for label in bin_names(spec, settings):
        for metric in spec.metrics:
            here = rows[(rows["bin"] == label) & (rows["metric"] == metric)]
            both = [rows_of(here, entrant.method, entrant.variant) for entrant in entrants]
            gap = paired_of(*both, settings)
            if gap.pairs:
                numbers = (gap.first, gap.second, gap.mean, gap.low, gap.high)
                found.append((label, metric, *numbers, gap.pairs, gap.left_out))
    if not found:
        raise GeoEvsError(
            f"no view of table {table} has a finite value of both {first} and {second} on "
            f"{dataset}; {run / layout.SCORES} says what failed"
        )
    return pd.DataFrame(found, columns=COLUMNS)


def comparison_text(table: pd.DataFrame, first: str, second: str) -> str:
    """What `compare_entrants` found, in aligned columns, and what its means are of."""
    lines = [
        (
            row.bin,
            f"{row.metric} {arrow(row.metric)}",
            number(row.metric, row.first),
            number(row.metric, row.second),
            with_interval(f"{{:+.{decimals(row.metric)}f}}", row.difference, row.low, row.high),
            row.pairs,
            row.left_out or "",
        )
        for row in table.itertuples()
    ]
    header = ["bin", "metric", first, second, "difference", "pairs", "left out"]
    shown = pd.DataFrame(lines, columns=header)
    text = shown.loc[:, shown.ne("").any()].to_string(index=False)
    return f"{text}\n{LEFT_OUT}" if table["left_out"].any() else text

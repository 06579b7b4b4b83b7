"""Which views entrants delivered: only means over the same views are ranked.

Whoever fails on the hard views has a mean of the easy ones. Such a mean is shown, with a mark, but
it is never called the best, never on a frontier and never part of an order. Two entrants are
compared on the views that both delivered.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from geoevs.protocol.entries import FAILED
from geoevs.results.bootstrap import PairedDifference, paired_difference
from geoevs.results.entrants import ENTRANT
from geoevs.results.settings import TableSettings

VIEW = ["scene", "frame", "target", "stressor", "level"]
"""Columns that tell which view a score row is of."""

MARK = "†"
"""Stands behind a mean of fewer views than others have."""

MARKED = f"{MARK} = mean of the views that were delivered; others have more, so it is not ranked."
"""What the mark says, as legends have it."""


def lacking(
    rows: pd.DataFrame,
    by: Sequence[str],
    rivals: Sequence[str] = ("method", "variant"),
    view: Sequence[str] = VIEW,
) -> pd.DataFrame:
    """How many views each entrant lacks for a mean over the same views as others.

    A view is due where any rival has a value of it, once for every seed of the entrant. A failed
    view is lacking even where nobody has a value.

    Args:
        rows: score rows.
        by: the columns that make a mean, ENTRANT among them.
        rivals: those of them that tell rivals apart; the others say where they meet.
        view: the columns that tell views apart. If `seed` is among them, a seed is no training but
            a draw that all rivals share.

    Returns:
        Columns `by` and `lacking`, a row for every group of the rows.
    """
    by, view = list(by), list(view)
    place = [name for name in by if name not in rivals]
    scored = rows[rows["value"].notna()]
    once = list(dict.fromkeys([*by, *view, "seed"]))
    groups = {"sort": False, "dropna": False, "observed": True}
    found = rows[by].drop_duplicates()
    for name, some in (("had", scored), ("failed", rows[rows["status"] == FAILED])):
        counts = some.drop_duplicates(once).groupby(by, **groups).size()
        found = found.merge(counts.rename(name).reset_index(), on=by, how="left")
    due = scored.drop_duplicates([*place, *view]).groupby(place, **groups).size()
    found = found.merge(due.rename("due").reset_index(), on=place, how="left")
    found = found.fillna({"had": 0, "failed": 0, "due": 0})
    if "seed" not in view:
        seeds = rows.groupby(ENTRANT, **groups)["seed"].nunique()
        found["due"] *= found.merge(seeds.rename("seeds"), on=ENTRANT, how="left")[
            "seeds"
        ].to_numpy()
    missing = np.maximum(found["due"] - found["had"], found["failed"])
    return found[by].assign(lacking=missing.astype(int))


def with_lacking(rows: pd.DataFrame, by: Sequence[str], view: Sequence[str] = VIEW) -> pd.DataFrame:
    """Score rows, in their order, each with what its entrant lacks in its group (see `lacking`)."""
    return rows.merge(lacking(rows, by, view=view), on=list(by), how="left")


def lacking_of_sets(sets: pd.DataFrame) -> pd.Series:
    """How many views each row of distances between sets lacks (see `lacking`)."""
    asked = sets["views"] + sets["failed"]
    return (
        asked.groupby([sets[name] for name in ("dataset", "split")]).transform("max")
        - sets["views"]
    )


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
    # Without stress there is no level, whose text is missing too: all targets would be one.
    levelled = (
        some.assign(target=some["target"].astype("string") + "@" + _level(some))
        for some in (rows, others)
    )
    return paired_difference(*levelled, *settings.bootstrap)


def _level(rows: pd.DataFrame) -> pd.Series:
    return rows["level"].astype(str).fillna("none")


def _at_seeds_of(others: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    if rows["seed"].nunique() != 1:
        return rows
    seeds = others[["seed"]].drop_duplicates()
    return rows.drop(columns="seed").merge(seeds, how="cross")

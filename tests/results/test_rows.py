"""What a table reads of a run's rows is all that it needs of them."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.results import cost_rows, score_rows
from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.parquet import read_parquet, write_parquet
from geoevs.protocol.entries import FAILED
from geoevs.protocol.scoring import THINNING
from geoevs.protocol.weights import UNAVAILABLE
from geoevs.results import ablation, complexity, rank_agreement
from geoevs.results.charts import speed_accuracy
from geoevs.results.entrants import Entrants, Info
from geoevs.results.rows import FIT, TABLE_COLUMNS, read_rows, read_scores
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import TABLES, rows_needed
from geoevs.results.tables import make_table

SETTINGS = TableSettings([0, 5, 15, 30], [0, 0.05, 0.1], 20, 0.95, "geo-evs")
ENTRANTS = ["mean-colour", "nearest-view", "geo-evs", "geo-evs.8k", "geo-evs.16k", "three-dgs"]
ENTRANTS += ["emernerf", "freevs"]
WHO = Entrants({name: Info(name) for name in ENTRANTS})


@pytest.fixture(scope="module")
def scores(tmp_path_factory):
    """A file of rows with two data sets, seeds, stress, failures, copies and metrics without value.

    Gives its path and the same rows as plain texts.
    """
    rng = np.random.default_rng(3)
    rows = score_rows(20_000, ENTRANTS)
    again = rows[rows["method"].isin(["geo-evs", "freevs"])].assign(seed=1)
    rows = pd.concat([rows, again.assign(value=again["value"] + 0.1)], ignore_index=True)
    other = rows[rows["method"] != "emernerf"].assign(dataset="alpha")
    rows = pd.concat([rows.assign(dataset="zeta"), other], ignore_index=True)
    sparse = (rows["split"] == "extrapolation") & rows["metric"].str.startswith("sparse")
    thinned = rows[sparse].assign(stressor=THINNING, level=0.5)
    rows = pd.concat([rows, thinned], ignore_index=True)
    drawn = rng.random(len(rows))
    rows.loc[drawn < 0.01, "value"] = np.inf
    failed = {"value": np.nan, "status": FAILED, "reason": "it broke"}
    rows.loc[drawn > 0.98, list(failed)] = failed.values()
    missing = {"value": np.nan, "status": UNAVAILABLE, "reason": "no weights"}
    rows.loc[rows["metric"] == "lpips", list(missing)] = missing.values()
    rows = rows[rng.random(len(rows)) < 0.97].reset_index(drop=True)
    path = tmp_path_factory.mktemp("rows") / "scores.parquet"
    write_parquet(path, rows)
    return path, rows


def test_rows_are_those_that_were_asked_for(scores, monkeypatch):
    monkeypatch.setattr("geoevs.core.parquet.GROUP_ROWS", 1000)
    path, rows = scores
    needed = {"split": ["extrapolation"], "metric": ["psnr", "sparse_psnr"]}
    wanted = rows["split"].isin(needed["split"]) & rows["metric"].isin(needed["metric"])
    expected = rows[wanted | ~rows.duplicated(list(FIT))]
    assert 0 < wanted.sum() < len(expected) < len(rows) / 5
    found = read_scores(path, needed)
    assert list(found) == list(TABLE_COLUMNS)
    for column in found:
        values = found[column].astype(rows[column].dtype).to_list()
        np.testing.assert_array_equal(values, expected[column].to_list())


def test_texts_are_categories_in_the_order_of_the_alphabet(scores):
    path, rows = scores
    found = read_rows(path, layout.SCORES)
    assert list(found["metric"].cat.categories) == sorted(rows["metric"].unique())
    assert not found["metric"].cat.ordered
    assert found.memory_usage(deep=True).sum() < 90 * len(found)


TABLE_MAKERS = {
    **{
        name: (rows_needed(spec), lambda rows, name=name: make_table(name, rows, SETTINGS, WHO))
        for name, spec in TABLES.items()
    },
    "ablation": (
        ablation.rows_needed(SETTINGS),
        lambda rows: ablation.make_ablation_table(rows, SETTINGS, WHO),
    ),
    "complexity": (
        complexity.ROWS_NEEDED,
        lambda rows: complexity.make_complexity_table(rows, sizes(), WHO),
    ),
    "size curves": (
        complexity.ROWS_NEEDED,
        lambda rows: complexity.size_curves(rows, sizes(), SETTINGS, WHO),
    ),
    "rank agreement": (
        rank_agreement.ROWS_NEEDED,
        lambda rows: rank_agreement.make_rank_agreement(rows, SETTINGS),
    ),
    "chart": (
        rows_needed(TABLES["pose_offset"]),
        lambda rows: speed_accuracy("pose_offset", rows, sizes(), SETTINGS, WHO),
    ),
}


def sizes():
    """Cost rows of the entrants on both data sets, with as many primitives as they cost bytes."""
    rows = cost_rows(ENTRANTS)
    rows = rows.assign(primitives=rows["bytes"])
    return pd.concat([rows.assign(dataset=name) for name in ("zeta", "alpha")], ignore_index=True)


@pytest.mark.filterwarnings("ignore:invalid value encountered in subtract")
@pytest.mark.parametrize("name", TABLE_MAKERS)
def test_a_table_of_what_it_needs_is_that_of_all_rows(scores, name):
    path, rows = scores
    needed, make = TABLE_MAKERS[name]
    whole, part = make(rows), make(read_scores(path, needed))
    assert len(whole) > 0
    assert list(part) == list(whole)
    for column in whole:  # bit for bit
        np.testing.assert_array_equal(part[column].to_list(), whole[column].to_list())


def test_rows_are_chosen_by_texts_or_as_the_first_of_their_kind(tmp_path):
    write_parquet(tmp_path / "a", pd.DataFrame({"a": ["x", "y", "x"], "b": [1, 2, 3]}))
    types = {"a": "string", "b": "int64"}
    found = read_parquet(tmp_path / "a", types, where={"a": ["x"]})
    assert found["b"].tolist() == [1, 3]
    assert read_parquet(tmp_path / "a", types, where={"a": []}).empty
    firsts = read_parquet(tmp_path / "a", types, where={"a": []}, and_first_of=["a"])
    assert firsts["b"].tolist() == [1, 2]


def test_no_rows_are_refused_where_who_took_part_is_asked_for(tmp_path):
    write_parquet(tmp_path / "s", score_rows(20_000)[:0])
    with pytest.raises(GeoEvsError, match=r"^.*/s has no rows; make it again$"):
        read_scores(tmp_path / "s", {"split": ["observed"]})

import math

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.parquet import SEAL, join_parquet, write_parquet


def test_files_are_joined_in_the_order_given(tmp_path):
    parts = [tmp_path / f"{number}.parquet" for number in range(3)]
    for part, values in zip(parts, ([1, 2], [], [0]), strict=True):
        write_parquet(part, pd.DataFrame({"a": pd.array(values, "int64")}, index=[*values]))
    join_parquet(tmp_path / "all.parquet", parts)
    assert pd.read_parquet(tmp_path / "all.parquet").to_dict("list") == {"a": [1, 2, 0]}
    assert SEAL not in pq.read_schema(tmp_path / "all.parquet").metadata  # the first part's


def test_groups_of_rows_are_full_whatever_the_files(tmp_path, monkeypatch):
    monkeypatch.setattr("geoevs.core.parquet.GROUP_ROWS", 4)
    parts = [tmp_path / f"{number}.parquet" for number in range(6)]
    first = 0
    for part, count in zip(parts, (1, 2, 0, 9, 1, 2), strict=True):
        write_parquet(part, pd.DataFrame({"a": range(first, first + count)}))
        first += count
    join_parquet(tmp_path / "all.parquet", parts)
    metadata = pq.ParquetFile(tmp_path / "all.parquet").metadata
    groups = [metadata.row_group(number).num_rows for number in range(metadata.num_row_groups)]
    assert groups == [4, 4, 4, 3]
    assert pd.read_parquet(tmp_path / "all.parquet")["a"].tolist() == [*range(15)]


def test_joining_nothing_says_so(tmp_path):
    with pytest.raises(GeoEvsError, match=r"^there are no files to make .*all.parquet from; name"):
        join_parquet(tmp_path / "all.parquet", [])


ROWS = pd.DataFrame({"a": ["x", "", "ü"], "b": [1.0, math.nan, -0.0], "c": [1, 2, 2**62]})
ROWS["d"] = ROWS["a"].astype("string")


def rewrite(path, **changed):
    """Write a part over by other rows, whose file keeps the first one's seal."""
    table = pq.read_table(path)
    rows = table.to_pandas().assign(**changed)
    other = pa.Table.from_pandas(rows, preserve_index=False)
    pq.write_table(other.replace_schema_metadata(table.schema.metadata), path)


# What is done to a part, and what its error says.
CHANGED = {
    "a value": (lambda path: rewrite(path, b=[99.0, math.nan, 0.5]), "was changed after its rows"),
    "a name": (lambda path: rewrite(path, a=["y", "", "ü"]), "was changed after its rows"),
    "no seal": (lambda path: ROWS.to_parquet(path, index=False), "carries no seal, as files of"),
}


@pytest.mark.parametrize("kind", CHANGED)
def test_rows_that_were_written_over_are_refused(tmp_path, kind):
    change, sentence = CHANGED[kind]
    parts = [tmp_path / "a.parquet", tmp_path / "b.parquet"]
    for part in parts:
        write_parquet(part, ROWS)
    join_parquet(tmp_path / "all", parts)
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "all")[:3], ROWS)
    change(parts[1])
    with pytest.raises(GeoEvsError, match=rf"^{parts[1]} {sentence}.*; delete it and make it agai"):
        join_parquet(tmp_path / "other", parts)
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("second", "sentence"),
    [
        (pd.DataFrame({"a": [1.5]}), "b.parquet has other columns than "),
        (None, "b.parquet is missing"),
    ],
)
def test_what_cannot_be_joined_is_named_and_nothing_written(tmp_path, second, sentence):
    write_parquet(tmp_path / "a.parquet", pd.DataFrame({"a": [1]}))
    if second is not None:
        write_parquet(tmp_path / "b.parquet", second)
    with pytest.raises(GeoEvsError, match=sentence):
        join_parquet(tmp_path / "all", [tmp_path / "a.parquet", tmp_path / "b.parquet"])
    assert not (tmp_path / "all").exists()

import pandas as pd
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.parquet import join_parquet, write_parquet


def test_files_are_joined_in_the_order_given(tmp_path):
    parts = [tmp_path / f"{number}.parquet" for number in range(3)]
    for part, values in zip(parts, ([1, 2], [], [0]), strict=True):
        write_parquet(part, pd.DataFrame({"a": pd.array(values, "int64")}, index=[*values]))
    join_parquet(tmp_path / "all.parquet", parts)
    assert pd.read_parquet(tmp_path / "all.parquet").to_dict("list") == {"a": [1, 2, 0]}


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

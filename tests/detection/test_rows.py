import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.core.errors import GeoEvsError
from geoevs.detection.rows import (
    BOX,
    PREDICTION_TYPES,
    TRUTH_TYPES,
    check_frames,
    read_predictions,
    read_truths,
    scored_truths,
)
from geoevs.detection.rules import LET, PLAIN
from geoevs.detection.scoring import score_files
from tests.detection.conftest import box, prediction_object, truth_object, write_objects
from tests.fuzzing import SHARE, changed, edit_bytes, edit_column, refused

CAR = box(10, -2, 0.8, 4.5, 1.9, 1.6, 0.3)


def rows_of(types, count=2):
    blank = {"string": "", "int64": 0, "float64": 0.0}
    rows = pd.DataFrame({name: [blank[kind]] * count for name, kind in types.items()})
    placed = {**dict(zip(BOX, CAR, strict=True)), "scene": "s", "frame": 7, "class": "vehicle"}
    return rows.assign(**placed)


def truth_rows(count=2, **others):
    return rows_of(TRUTH_TYPES, count).assign(points=9, camera="FRONT", **others)


def test_parquet_rows_and_objects_are_the_same(tmp_path):
    seen = write_objects(tmp_path / "p.bin", [prediction_object(CAR, score=0.5, ignored=1)])
    there = write_objects(tmp_path / "t.bin", [truth_object(CAR, points=9, top=9, level=1)])
    read_predictions(seen).to_parquet(tmp_path / "p.parquet")
    read_truths(there, LET).to_parquet(tmp_path / "t.parquet")
    pd.testing.assert_frame_equal(
        read_predictions(tmp_path / "p.parquet"), read_predictions(seen), check_dtype=False
    )
    pd.testing.assert_frame_equal(
        read_truths(tmp_path / "t.parquet", PLAIN), read_truths(there, LET), check_dtype=False
    )


@pytest.mark.parametrize("value", [-0.01, 1.01, math.nan, math.inf])
def test_scores_lie_between_0_and_1(tmp_path, value):
    given = [prediction_object(CAR), prediction_object(CAR, score=value)]
    path = write_objects(tmp_path / "p.bin", given)
    with pytest.raises(
        GeoEvsError, match=r"p\.bin: row 1 has the score .*; scores lie in \[0, 1\]"
    ):
        read_predictions(path)
    table = tmp_path / "p.parquet"
    rows_of(PREDICTION_TYPES).assign(score=[0.5, value]).to_parquet(table)
    with pytest.raises(GeoEvsError, match=r"p\.parquet: row 1 has the score"):
        read_predictions(table)


@pytest.mark.parametrize(
    ("column", "value", "sentence"),
    [
        ("class", "Vehicle", "there is no class 'Vehicle'; did you mean 'vehicle'"),
        ("x", math.nan, "row 0 has the x nan; boxes are metres .*, and 1 more rows are wrong"),
        ("height", math.inf, "row 0 has the height inf; boxes are metres"),
        ("y", 10_001.0, "row 0 has the y 10001.0; boxes .* within 10 km"),
        ("heading", 90.0, "row 0 has the heading 90.0; headings are radians, not degrees"),
        ("ignored", 2, "row 0 has the ignored 2; it is 0 or 1"),
        ("score", "high", "column 'score' holds"),
    ],
)
def test_wrong_predictions_are_refused(tmp_path, column, value, sentence):
    path = tmp_path / "p.parquet"
    rows_of(PREDICTION_TYPES).assign(**{column: value}).to_parquet(path)
    with pytest.raises(GeoEvsError, match=sentence) as error:
        read_predictions(path)
    assert str(path) in str(error.value)


def test_wrong_truths_are_refused(tmp_path):
    path = tmp_path / "t.parquet"
    truth_rows(level=[0, 3]).to_parquet(path)
    with pytest.raises(GeoEvsError, match=r"row 1 has the level 3; it is 1, 2, or 0 for unknown"):
        read_truths(path, LET)
    truth_rows(level=0).drop(columns="points").to_parquet(path)
    with pytest.raises(GeoEvsError, match="lacks the column 'points'"):
        read_truths(path, LET)
    with pytest.raises(GeoEvsError, match="none is missing"):
        read_truths(tmp_path / "none", LET)


def test_levels_are_those_annotated_or_by_points(tmp_path):
    given = truth_rows(4, level=[0, 0, 1, 2]).assign(points=[5, 6, 1, 100])
    kept, left_out = scored_truths(given, PLAIN, tmp_path)
    assert kept["level"].tolist() == [2, 1, 1, 2]
    assert left_out == {}


def test_what_does_not_count_is_counted_by_reason(tmp_path):
    given = truth_rows(5, level=0)
    given = given.assign(points=[0, -1, 9, 9, 0], camera=["", "FRONT", "", "FRONT", "FRONT"])
    given.loc[4, "class"] = ""
    kept, left_out = scored_truths(given, LET, tmp_path)
    assert list(kept.index) == [3]
    expected = {"of no known class": 1, "without LiDAR points": 2}
    assert left_out == {**expected, "seen by no camera": 1}
    kept, left_out = scored_truths(given, PLAIN, tmp_path)
    assert list(kept.index) == [2, 3]
    assert left_out == expected


def test_truths_of_which_none_counts_are_refused(tmp_path):
    path = tmp_path / "t.bin"
    with pytest.raises(GeoEvsError, match=r"none of the 2 truths of .*t\.bin counts: 2 without Li"):
        scored_truths(truth_rows(level=0).assign(points=0), LET, path)
    with pytest.raises(GeoEvsError, match=r"counts: 1 without LiDAR points and 1 seen by no cam"):
        scored_truths(truth_rows(level=0).assign(points=[0, 9], camera=""), LET, path)
    with pytest.raises(GeoEvsError, match=r"none of the 0 truths of .*t\.bin counts; fill in"):
        scored_truths(truth_rows(0, level=0), LET, path)


def test_frames_of_one_file_alone_are_said(tmp_path):
    paths = tmp_path / "p", tmp_path / "t"
    seen, there = rows_of(PREDICTION_TYPES, 3), truth_rows(3, level=0)
    assert check_frames(seen, there, paths) == []
    assert check_frames(seen.assign(frame=[7, 8, 9]), there, paths) == [
        "No truth for 2 of 3 frames: all that is predicted there is false."
    ]
    assert check_frames(seen, there.assign(scene=["s", "r", "r"]), paths) == [
        "No prediction for 1 of 2 frames: all that is there is missed."
    ]
    with pytest.raises(
        GeoEvsError, match=r"none of the 1 frames of .*p has a truth in .*t \("
    ) as e:
        check_frames(seen, there.assign(frame=8), paths)
    assert "the first are 's' at 7 and 's' at 8" in str(e.value)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Both kinds of both files."""
    folder = tmp_path_factory.mktemp("boxes")
    rng = np.random.default_rng(0)
    boxes = [CAR + rng.normal(0, 0.1, 7) for _ in range(3)]
    write_objects(folder / "p.bin", [prediction_object(each) for each in boxes])
    write_objects(folder / "t.bin", [truth_object(each, level=2) for each in boxes])
    rows_of(PREDICTION_TYPES).to_parquet(folder / "p.parquet")
    truth_rows(level=0).to_parquet(folder / "t.parquet")
    return folder


@SHARE
@given(data=st.data())
def test_broken_files_are_scored_or_refused(files, data):
    names = [data.draw(st.sampled_from([f"{name}.bin", f"{name}.parquet"])) for name in "pt"]
    with changed(files) as folder:
        path = folder / data.draw(st.sampled_from(names), "file")
        if path.suffix == ".bin" or data.draw(st.booleans(), "bytes"):
            edit_bytes(path, data)
        else:
            table = pd.read_parquet(path)
            column = data.draw(st.sampled_from(list(table)), "column")
            cells = pd.Series(edit_column(table[column].to_numpy(), data))
            try:
                table.assign(**{column: cells}).to_parquet(path)
            except Exception:  # mixed cells that no Parquet file can hold
                return
        rules = data.draw(st.sampled_from([LET, PLAIN]), "rules")
        refused(lambda: score_files(*(folder / name for name in names), rules))

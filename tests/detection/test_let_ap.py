"""The command, on files made by hand and on the sample files of Waymo's own tools."""

import os
from pathlib import Path

import numpy as np
import pytest

from geoevs.detection.metrics import MEAN, WEIGHTS, metrics_table
from geoevs.detection.rows import read_predictions, read_truths
from geoevs.detection.rules import LET, PLAIN
from geoevs.detection.scoring import read_counts, score_files
from geoevs.results.escaping import read_csv
from tests.detection.conftest import box, prediction_object, truth_object, write_objects


@pytest.fixture
def files(tmp_path, street):
    """Two scenes: all of the first is found, all of the second but turned by half."""
    boxes, names = street
    kinds = [{"vehicle": 1, "pedestrian": 2, "cyclist": 4}[name] for name in names]
    there, seen = [], []
    for scene, turn in (("a", 0), ("b", np.pi)):
        for given, kind in zip(boxes, kinds, strict=True):
            there.append(truth_object(given, kind, scene=scene))
            turned = given + np.array([0, 0, 0, 0, 0, 0, turn])
            seen.append(prediction_object(turned, kind, scene=scene))
    there.append(truth_object(boxes[0], scene="a", top=0, points=0))
    there.append(truth_object(boxes[0], scene="a", camera=None))
    return write_objects(tmp_path / "p.bin", seen), write_objects(tmp_path / "t.bin", there)


def test_a_table_its_remarks_and_counts(geoevs, files, tmp_path):
    out = tmp_path / "out"
    code, text, errors = geoevs("let-ap", *files, "--out", out)
    assert (code, errors) == (0, "")
    header, vehicle, *_ = text.splitlines()
    assert header.split()[:7] == ["breakdown", "class", "bin", "level", "APL", "AP", "APH"]
    numbers = "1.0000 [1.0000, 1.0000] 1.0000 [1.0000, 1.0000] 0.5000 [0.0000, 1.0000]"
    assert vehicle.split() == ["type", "vehicle", "all", "2", *numbers.split(), "8", "8", "50%"]
    assert text.splitlines()[-2:] == [
        "Left out: 1 truths without LiDAR points.",
        "Left out: 1 truths seen by no camera.",
    ]
    assert sorted(path.name for path in out.iterdir()) == [
        *("counts.parquet", "detection.csv", "detection.md"),
    ]
    table = metrics_table(read_counts(out / "counts.parquet"), 1000, 0.95)
    written = read_csv(out / "detection.csv")
    assert written["aph"].tolist() == pytest.approx(table["aph"].tolist(), nan_ok=True)
    markdown = (out / "detection.md").read_text(encoding="utf-8")
    assert "| type | cyclist | all | 2 | 1.0000 [1.0000, 1.0000] |" in markdown
    assert "| type | sign | all | 2 |  |  |  | 0 | 0 |  |" in markdown
    assert "Left out: 1 truths seen by no camera." in markdown


def test_parquet_rows_give_the_same(geoevs, files, tmp_path):
    seen, there = files
    read_predictions(seen).to_parquet(tmp_path / "p.parquet")
    read_truths(there, LET).to_parquet(tmp_path / "t.parquet")
    expected = geoevs("let-ap", *files)
    assert geoevs("let-ap", tmp_path / "p.parquet", tmp_path / "t.parquet") == expected


def test_plain_rules_have_two_levels_and_no_affinity(geoevs, files):
    code, text, _ = geoevs("let-ap", *files, "--plain")
    assert code == 0
    header, *lines = (line.split() for line in text.splitlines())
    assert header[:6] == ["breakdown", "class", "bin", "level", "AP", "APH"]
    assert [line[3] for line in lines[:2]] == ["1", "2"]
    assert {line[0] for line in lines} == {"type", "range", "Left"}
    assert text.splitlines()[-1] == "Left out: 1 truths without LiDAR points."


def test_predictions_in_no_frame_with_truths_are_one_sentence(geoevs, files, tmp_path):
    other = write_objects(tmp_path / "o.bin", [prediction_object(box(9), scene="c", frame=3)])
    code, text, errors = geoevs("let-ap", other, files[1], "--out", tmp_path / "out")
    assert (code, text) == (1, "")
    start = f"error: none of the 1 frames of {other} has a truth in {files[1]} (the first are 'c' "
    assert errors.startswith(start)
    assert errors.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_no_prediction_at_all_finds_nothing(geoevs, files, tmp_path):
    nothing = write_objects(tmp_path / "o.bin", [])
    code, text, _ = geoevs("let-ap", nothing, files[1])
    assert code == 0
    assert text.splitlines()[1].split()[4] == "0.0000"
    assert "No prediction for 2 of 2 frames: all that is there is missed." in text


def test_other_cameras_and_unknown_classes_are_remarked(geoevs, files, tmp_path):
    here = box(9, 0, 1, 2, 2, 2)
    there = write_objects(tmp_path / "o.bin", [truth_object(here, scene="a", camera="REAR")])
    seen = write_objects(tmp_path / "q.bin", [prediction_object(here, kind=0, scene="a")])
    text = geoevs("let-ap", seen, there)[1]
    assert "Left out: 1 predictions of no known class." in text
    assert "In no camera's rows: 1 truths that other cameras see best." in text


@pytest.fixture(scope="module")
def samples():
    if "GEOEVS_WAYMO" not in os.environ:
        pytest.skip("set GEOEVS_WAYMO to the folder that holds let/fake_predictions.bin")
    return Path(os.environ["GEOEVS_WAYMO"]) / "let"


LET_VALUES = """
    0.211287 0.23023 0.181574  0.213379 0.224676 0.170878  0.0989853 0.100288 0.0797784
    0 0 0  0.158502 0.200029 0.163429  0.231184 0.244745 0.205553
    0.232808 0.241251 0.175992  0.214398 0.228197 0.17427  0.202346 0.21114 0.158337
    0.193137 0.201656 0.158395  0.0196413 0.0196586 0.018337  0.191365 0.191489 0.150585
    0.149141 0.151854 0.125403  0 0 0  0 0 0
    0 0 0  0.333815 0.36573 0.30147  0.567318 0.736161 0.645462
    0.33577 0.352934 0.267835  0 0 0  0.125353 0.222222 0.113782
    0.367701 0.389814 0.292392  0.251196 0.260676 0.198859  0.140006 0.154568 0.119544
    0.172725 0.173382 0.161921  0.258021 0.261462 0.185914  0.240335 0.245807 0.195759
    0.123899 0.125459 0.119571  0.0708887 0.070911 0.0535817  0 0 0
    0.0312435 0.03125 0.0142438  0 0 0  0 0 0
    0 0 0  0 0 0  0 0 0
"""
"""LET-mAPL, LET-mAP and LET-mAPH of all lines of the table, as the comment at the head of Waymo's
compute_detection_let_metrics_main.cc says that it prints them for its sample files."""

PLAIN_VALUES = """
    0.208277 0.162823  0.20542 0.160523  0.129258 0.0984962  0.125136 0.0953438
    0.0926278 0.0635938  0.067927 0.0466355  0 0  0 0
    0.154727 0.129927  0.154727 0.129927  0.27302 0.230956  0.270492 0.228818
    0.218596 0.155501  0.212188 0.150963  0.19352 0.155428  0.19352 0.155428
    0.144201 0.103131  0.134931 0.0966024  0.0985548 0.0779858  0.0960544 0.075891
    0.106175 0.0716929  0.0651952 0.0439717  0.15528 0.117763  0.13587 0.103042
    0.075276 0.0507518  0.0596342 0.040206  0 0  0 0
    0 0  0 0  0 0  0 0
"""
"""mAP and mAPH of all lines, of compute_detection_metrics_main.cc."""


def waymo_table(samples, rules):
    """Waymo's lines of our table of its sample files; what has no truth is 0 there."""
    paths = samples / "fake_predictions.bin", samples / "fake_ground_truths.bin"
    table = metrics_table(score_files(*paths, rules)[0], 20, 0.95)
    table = table[table["class"] != MEAN].reset_index(drop=True)
    assert (table["truths"] > 0).equals(table["ap"].notna())
    return table.fillna(0.0)


def test_let_metrics_of_waymos_sample_files(samples):
    expected = np.array(LET_VALUES.split(), float).reshape(-1, 3)
    table = waymo_table(samples, LET)
    np.testing.assert_allclose(table[list(WEIGHTS)], expected, atol=1e-6)


def test_plain_metrics_of_waymos_sample_files(samples):
    expected = np.array(PLAIN_VALUES.split(), float).reshape(-1, 2)
    table = waymo_table(samples, PLAIN)
    # One prediction of a vehicle 30 to 50 m away is its truth turned by exactly half: Waymo's own
    # intersection of polygons finds nothing there, ours all of it.
    turned = (table["class"] == "vehicle") & table["bin"].isin(["all", "[30, 50)"])
    found = table[["ap", "aph"]]
    np.testing.assert_allclose(found[~turned], expected[~turned], atol=1e-6)
    more = found[turned].to_numpy() - expected[turned]
    assert more.shape == (4, 2)
    assert (more > 1e-5).all()
    assert (more < 3.7e-3).all()

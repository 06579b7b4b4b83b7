import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.detection import objects
from geoevs.detection.rows import BOX
from geoevs.detection.rules import LET, PLAIN
from tests.detection.conftest import (
    box,
    field,
    message,
    prediction_object,
    truth_object,
    write_objects,
)

CAR = box(10, -2, 0.8, 4.5, 1.9, 1.6, 0.3)
TIME = 1_550_083_467_346_370


def test_predictions_field_by_field(tmp_path):
    path = write_objects(
        tmp_path / "p.bin",
        [
            prediction_object(CAR, score=0.25, scene="context", frame=TIME),
            prediction_object(-CAR, kind=4, ignored=1, score=None, frame=-5),
            prediction_object(CAR, kind=0, camera=3),
            b"",  # nothing is set
        ],
    )
    rows = objects.read_predictions(path)
    np.testing.assert_array_equal(rows[list(BOX)].iloc[:2], [CAR, -CAR])
    assert rows["class"].tolist() == ["vehicle", "cyclist", "", ""]
    assert rows["score"].tolist() == pytest.approx([0.25, 1, 0.9, 1])
    assert rows["ignored"].tolist() == [0, 1, 0, 0]
    assert rows["frame"].tolist() == [TIME, -5, 7, 0]
    assert rows["scene"].tolist() == ["context", "s", "s_3", ""]


def test_truths_are_those_of_the_rules(tmp_path):
    synced = CAR + 1
    given = [truth_object(CAR, points=7, top=3, synced=synced, level=1, camera="SIDE_LEFT")]
    path = write_objects(tmp_path / "t.bin", given)
    for rules, expected, points in ((LET, synced, 3), (PLAIN, CAR, 7)):
        rows = objects.read_truths(path, rules.tolerance is not None)
        np.testing.assert_array_equal(rows[list(BOX)], [expected])
        said = rows[["points", "level", "camera", "class"]].iloc[0].tolist()
        assert said == [points, 1, "SIDE_LEFT", "vehicle"]


def test_fields_of_later_versions_are_passed_over(tmp_path):
    zone = field(2, message({1: b"zone"}))
    path = tmp_path / "p.bin"
    path.write_bytes(zone + field(1, prediction_object(CAR) + field(99, "new")) + field(7, 5))
    assert len(objects.read_predictions(path)) == 1


def test_labels_without_synchronised_boxes_are_too_old(tmp_path):
    label = message({3: 1, 7: 9, 11: "FRONT", 13: 9})
    path = write_objects(tmp_path / "t.bin", [truth_object(CAR), message({1: label})])
    with pytest.raises(GeoEvsError, match=r"^object 1 of .*t\.bin names a camera .* Waymo 1\.3\.2"):
        objects.read_truths(path, True)
    assert len(objects.read_truths(path, False)) == 2


def test_a_file_that_is_cut_off_anywhere_is_one_sentence(tmp_path):
    path = write_objects(tmp_path / "p.bin", [prediction_object(CAR)] * 2)
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        if size in (0, len(whole) // 2):  # it ends between two objects
            assert len(objects.read_predictions(path)) == (size > 0)
            continue
        with pytest.raises(GeoEvsError, match=r"p\.bin is damaged \(") as error:
            objects.read_predictions(path)
        assert "\n" not in str(error.value)
    path.write_bytes(whole[:-1])
    with pytest.raises(GeoEvsError, match="it ends within object 1"):
        objects.read_predictions(path)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"not a message", "a field in it is of the kind 6"),
        (field(1, 5), "object 0 is no message"),
        (field(1, message({1: 5})), "field 1 is a whole number"),
        (field(1, message({4: b"\xff\xfe"})), "field 4 is no text"),
        (field(1, message({1: message({1: message({1: b"short"})})})), "field 1 holds other"),
        (field(1, message({5: 0.5})), "field 5 is no whole number"),
        (bytes([0x0A, 0xFF]), "a number in it does not end"),
    ],
)
def test_what_is_no_message_of_this_kind_is_refused(tmp_path, data, reason):
    path = tmp_path / "p.bin"
    path.write_bytes(data)
    with pytest.raises(GeoEvsError, match=reason) as error:
        objects.read_predictions(path)
    assert "p.bin" in str(error.value)

"""What a method may return, and the sentence that refuses the rest."""

import fractions
import math
from types import SimpleNamespace

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.contract import FitReport, Rendering
from geoevs.methods.returned import checked_report, checked_rgb

CAMERA = SimpleNamespace(height=4, width=6)


class Mute:
    def __repr__(self):
        raise ValueError("no words")


@pytest.mark.parametrize(
    "value",
    [-1, 0.5, 3.0, 2**63, 10**30, "9", b"9", None, math.nan, [1], Mute(), np.array([1, 2]), 1j],
)
@pytest.mark.parametrize("field", ["primitives", "parameters"])
def test_counts_that_cannot_be_are_refused(field, value):
    with pytest.raises(GeoEvsError, match=rf"^FitReport.{field} is .*; give a whole number from 0"):
        checked_report(FitReport(**{field: value}))


@pytest.mark.parametrize(
    "value", [-1, math.nan, math.inf, 1e308, 10**400, "long", b"9", [1.0], 1j, Mute()]
)
def test_seconds_that_cannot_be_are_refused(value):
    with pytest.raises(GeoEvsError, match=r"^FitReport.training_seconds is .*; give seconds, or"):
        checked_report(FitReport(training_seconds=value))


def test_numbers_of_libraries_become_plain():
    report = checked_report(FitReport(np.int32(3), np.array(4), "n", np.float32(0.5)))
    assert [type(report.primitives), type(report.training_seconds)] == [int, float]
    assert (report.primitives, report.parameters, report.training_seconds) == (3, 4, 0.5)
    assert checked_report(FitReport(training_seconds=fractions.Fraction(1, 4))) == FitReport(
        training_seconds=0.25
    )
    assert checked_report(FitReport(True, 2**63 - 1)) == FitReport(1, 2**63 - 1)


def test_a_note_is_one_short_line():
    note = checked_report(FitReport(note="two\nlines\x1b[31m \udcff" + "x" * 10**6)).note
    assert note.startswith("two lines[31m x")
    assert len(note) < 600
    for value in (None, b"n", 3):
        with pytest.raises(GeoEvsError, match=r"^FitReport.note is a .*; make it a text$"):
            checked_report(FitReport(note=value))


def grey(value=0.5, kind=np.float64, shape=(4, 6, 3)):
    return np.full(shape, value).astype(kind)


GOOD = [
    *(grey(kind=kind) for kind in (np.float16, np.float32, np.longdouble)),
    grey(255, np.uint8),
    grey(1.0005),
    grey(-0.0005),
    np.ma.masked_array(grey(), mask=True),
    grey().T.copy().T,
]


@pytest.mark.parametrize("rgb", GOOD)
def test_pictures_of_any_float_type_are_taken(rgb):
    assert type(checked_rgb(Rendering(rgb), CAMERA)) is np.ndarray


BAD = {
    "spans 127.5 to 127.5": grey(127.5),
    "spans -0.5 to -0.5": grey(-0.5),
    "spans 1.002 to 1.002": grey(1.002),
    "spans nan to nan": np.where(np.arange(6)[:, None] == 3, np.nan, grey()),
    "spans 0.5 to inf": np.where(np.arange(6)[:, None] == 3, np.inf, grey()),
    "is int64": grey(kind=np.int64),
    "is bool": grey(kind=bool),
    "is object": grey(kind=object),
    "is complex128": grey(kind=np.complex128),
    "is uint16": grey(9, np.uint16),
    r"has shape \(4, 6, 4\)": grey(shape=(4, 6, 4)),
    r"has shape \(4, 6\)": grey(shape=(4, 6)),
    r"has shape \(6, 4, 3\)": grey(shape=(6, 4, 3)),
    r"has shape \(0, 6, 3\)": grey(shape=(0, 6, 3)),
    "is a list": grey().tolist(),
    "is a NoneType": None,
}


@pytest.mark.parametrize("sentence", BAD)
def test_what_is_no_picture_is_refused(sentence):
    with pytest.raises(GeoEvsError, match=f"^rgb {sentence}"):
        checked_rgb(Rendering(BAD[sentence]), CAMERA)


def test_what_is_no_rendering_is_refused():
    with pytest.raises(GeoEvsError, match=r"^render returned ndarray; return a Rendering$"):
        checked_rgb(grey(), CAMERA)

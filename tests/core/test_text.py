import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.names import check_name, inside
from geoevs.core.text import LONGEST, clean


@given(st.text(st.characters(), max_size=3000))
def test_clean_text_is_one_short_printable_line(text):
    line = clean(text)
    assert len(line) <= LONGEST + 40
    assert not any(letter != " " and not letter.isprintable() for letter in line)
    line.encode()


def test_a_lone_surrogate_and_escape_codes_vanish():
    assert clean("a\udce9b\x1b[31m\u202ec") == "ab[31mc"


def test_a_reason_survives_megabytes_and_a_broken_message():
    class OddError(Exception):
        def __str__(self):
            raise RuntimeError

    assert len(reason_of(ValueError("x" * 5_000_000))) < 2 * LONGEST
    assert reason_of(OddError()) == "OddError: no message"


@pytest.mark.parametrize(
    "name", ["front", "extrapolation-left+1m", "junction-103~traffic_speed=5", "a.b"]
)
def test_names_that_the_suite_makes_are_allowed(name):
    assert check_name(name, "camera", "x.json") == name


@pytest.mark.parametrize(
    "name",
    [
        "",
        "..",
        ".",
        "../x",
        "/etc",
        "a/b",
        "a\n",
        "a b",
        "-rf",
        ".hidden",
        "x" * 101,
        7,
        None,
        "a\0",
    ],
)
def test_names_that_could_leave_a_folder_are_refused(name):
    with pytest.raises(GeoEvsError, match=r"x\.json: camera '.*' is not an allowed name"):
        check_name(name, "camera", "x.json")


def test_paths_stay_inside(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / "out").symlink_to(tmp_path)
    assert inside(folder, "images/a.png", "t.json") == folder / "images/a.png"
    for path in ("../a.png", "/etc/passwd", "out/secret.png", 3, "a\0b"):
        with pytest.raises(GeoEvsError, match=r"t\.json: "):
            inside(folder, path, "t.json")

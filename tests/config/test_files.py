"""The syntax of config files."""

import pytest

from geoevs.config.files import check_repeats, check_syntax
from geoevs.core.errors import GeoEvsError


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (b"a: 1\nb: [1\n", r":3: this is not YAML \(expected .*\); check brackets"),
        (b"a: 1\nb: c: d\n", r":2: this is not YAML \(mapping values are not allowed here\)"),
        (b"a: 1\n\tb: 2\n", r":2: this is not YAML \(found character '\\t'"),
        (b"a: \x00", " is not plain UTF-8 text"),
        (b"a: \xff", " is not plain UTF-8 text"),
    ],
)
def test_a_file_that_is_not_yaml_is_one_sentence_with_its_line(tmp_path, text, sentence):
    path = tmp_path / "config.yaml"
    path.write_bytes(text)
    with pytest.raises(GeoEvsError, match=f"^{path}{sentence}.*$"):
        check_syntax(path)


def test_a_config_that_is_not_there_is_left_to_snakemake(tmp_path):
    check_syntax(tmp_path / "none.yaml")


def test_a_key_that_stands_twice_is_named_with_both_lines(tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text("a: 1\nb:\n- {c: 1}\n- c: 2\n  d: 3\n  c: 4\n")
    with pytest.raises(GeoEvsError, match=f"^{path}:6: 'c' stands in line 4 already; remove one$"):
        check_repeats(path)


@pytest.mark.parametrize("text", ["", "a: {b: 1}\nc: {b: 1}\nd: [{b: 1}, {b: 1}]\n"])
def test_a_key_may_stand_in_two_places(tmp_path, text):
    path = tmp_path / "config.yaml"
    path.write_text(text)
    check_repeats(path)

"""Config files: what is refused before Snakemake reads them, and in which words."""

import os
import time
from pathlib import Path

import pytest
import yaml

from geoevs.config.files import check_command_line, read_nodes
from geoevs.core.errors import GeoEvsError

PROJECT = Path(__file__).parents[2]


@pytest.fixture
def refusal(tmp_path):
    """What is said of a config file with some bytes, its name left out."""

    def run(data: bytes | str) -> str:
        path = tmp_path / "over.yaml"
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        begun = time.monotonic()
        with pytest.raises(GeoEvsError) as caught:
            read_nodes(path)
        assert time.monotonic() - begun < 8
        said = str(caught.value)
        assert "\n" not in said
        assert len(said) < 600
        return said.removeprefix(str(path))

    return run


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (b"a: 1\nb: [1\n", ":3: this is not YAML (expected ',' or ']'"),
        (b"a: 1\nb: c: d\n", ":2: this is not YAML (mapping values are not allowed here)"),
        (b"a: 1\n\tb: 2\n", ":2: this is not YAML (found character '\\t' that"),
        (b"a:\n\t- 2\n", ":2: this is not YAML (found character '\\t' that"),
        (b"a: 1\n---\nb: 2\n", ":2: this is not YAML (but found another document)"),
        (b"a: *none\n", ":1: this is not YAML (found undefined alias 'none')"),
        (b"a: 1\nb: \x00", ":2: the character U+0000 cannot stand in YAML"),
        (b"a: \x1b[31m", ":1: the character U+001B cannot stand in YAML"),
        (b"a: \xff", " is not UTF-8 text; save it as UTF-8"),
        ("a: 1".encode("utf-16"), " is not UTF-8 text; save it as UTF-8"),
        (b'a: "\\UFFFFFFFF"', " is not YAML ("),
        (b"", " holds no settings; write some as NAME: VALUE, or leave it out"),
        (b"# a: 1\n", " holds no settings"),
        (b"- a\n", ":1: a config holds settings as NAME: VALUE, and this is a list"),
        (b"\nseed 8\n", ":2: a config holds settings as NAME: VALUE, and this is a single value"),
    ],
)
def test_a_file_that_is_no_config_is_one_sentence_with_its_line(refusal, text, sentence):
    assert refusal(text).startswith(sentence)


def test_tabs_are_named(refusal):
    assert refusal("a:\n\tb: 2\n").endswith("; indent with spaces in place of tabs")


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        ("010", "YAML reads 010 as 8; write 8, or '010' in quotes if text is meant"),
        ("[002]", "YAML reads 002 as 2; write 2, or '002' in quotes"),
        ("-017", "YAML reads -017 as -15"),
        ("0x1F", "YAML reads 0x1F as 31"),
        ("0b11", "YAML reads 0b11 as 3"),
        ("1:30", "YAML reads 1:30 as 90"),
        ("[128:00, 192]", "YAML reads 128:00 as 7680"),
        ("{a: 1:30.5}", "YAML reads 1:30.5 as 90.5"),
        ("no", "YAML reads no as false; write false, or 'no' in quotes"),
        ("Yes", "YAML reads Yes as true; write true, or 'Yes' in quotes"),
        ("[on, off]", "YAML reads on as true"),
        ("OFF", "YAML reads OFF as false"),
        ("2024-05-01", "YAML takes 2024-05-01 for a date; write '2024-05-01' in quotes"),
        ("=", "YAML takes = for a sign of its own"),
        ("<<", "YAML takes << for a sign of its own"),
        ("0x_", "YAML cannot read 0x_; write '0x_' in quotes"),
        ("!!int '8'", "tags such as 'tag:yaml.org,2002:int' are not allowed"),
        ("!!python/name:os.system ''", "tags such as 'tag:yaml.org,2002:python/name:os.system' a"),
        ("!mine 8", "tags such as '!mine' are not allowed"),
        ("9" * 5000, "this number has 5000 digits"),
    ],
)
def test_a_value_that_yaml_misreads_is_named_with_what_to_write(refusal, value, sentence):
    assert refusal(f"seed: 1\na:\n  b: {value}\n").startswith(f":3: {sentence}")


@pytest.mark.parametrize(
    "value",
    [
        *("0", "-8", "1_000", "0.5", "1.0e-3", ".5", "true", "False", "null", "~", "'010'", '"no"'),
        *("'2024-05-01'", "no-inpaint", "1e-3", "1.2.3", "008", "~/renders", "[]", "{}"),
    ],
)
def test_values_that_everybody_reads_alike_pass(tmp_path, value):
    path = tmp_path / "over.yaml"
    path.write_text(f"a: {value}\n")
    read_nodes(path)


LAUGHS = "a0: &a0 [x, x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 60))
MERGED_LAUGHS = "a0: &a0 {k: [x, x]}\n" + "".join(
    f"a{n}: &a{n} {{<<: *a{n - 1}, k{n}: *a{n - 1}}}\n" for n in range(1, 60)
)
CHAIN = "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}]\n" for n in range(1, 2000))
BOMBS = {
    "an anchor in itself": ("a: &a [*a]\n", ":1: this anchor stands within itself"),
    "a section in itself": ("b: &b\n  c: {d: *b}\n", ":1: this anchor stands within itself"),
    "aliases of aliases": (LAUGHS, ":15: aliases make this 65,535 values"),
    "sections of sections": (MERGED_LAUGHS, ": aliases make this"),
    "a chain of aliases": (CHAIN, ":60: aliases make this 61 values, 61 deep"),
    "brackets": ("a: " + "[" * 3000, ":1: sections and lists lie 31 deep here"),
    "braces": ("{a: " * 3000, ":1: sections and lists lie 31 deep here"),
    "steps": ("".join(f"{' ' * n}a:\n" for n in range(300)), ":31: sections and lists lie 31 d"),
    "a long file": ("a: 1\n" * 100_000, " has 500,000 bytes; a config has 300,000 at most"),
    "many values": (f"b: 1\na: [{'x,' * 140_000}]", ":2: a config has 50,000 values at most"),
    "one long value": (f"a: {'x' * 290_000}\na: 2\n", ":2: 'a' stands in line 1 already"),
    "a comment": (f"a: 1 #{'x' * 290_000}\na: 2\n", ":2: 'a' stands in line 1 already"),
    "many lines": ("#\n" * 140_000 + "a: 1\na: 1\n", ":140002: 'a' stands in line 140001"),
}


@pytest.mark.parametrize("kind", BOMBS)
def test_a_bomb_is_one_sentence_within_seconds(refusal, kind):
    text, sentence = BOMBS[kind]
    assert sentence in refusal(text)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a: 1\nb:\n- {c: 1}\n- c: 2\n  d: 3\n  c: 4\n", ":6: 'c' stands in line 4 already; remo"),
        ("a: 1\non: 2\n", ":2: YAML does not read the key 'on' as text; write it in quotes"),
        ("002: a\n", ":1: YAML does not read the key '002' as text"),
        ("[a, b]: 1\n", ":1: a list or section cannot be a key"),
        ("x: &x {b: 1}\ny:\n  <<: *x\n  <<: *x\n", ":4: '<<' stands in line 3 already"),
        ("y: {<<: 1}\n", ":1: '<<' takes a section, or a list of some"),
        ("y: {<<: [{a: 1}, 2]}\n", ":1: '<<' takes a section, or a list of some"),
        ("__use_yte__: true\n", ":1: a config holds values, no code"),
    ],
)
def test_a_key_that_is_none(refusal, text, sentence):
    assert refusal(text).startswith(sentence)


@pytest.mark.parametrize(
    "text",
    [
        "a: {b: 1}\nc: {b: 1}\nd: [{b: 1}, {b: 1}]\n",
        "x: &x {b: 1}\ny: {<<: *x, b: 2}\nz: {<<: [*x, {c: 1}]}\n",
        '{\n\t"a": {"b": [1e-3, true]}\n}\n',
        "\ufeffa: 1\r\nb: 2\r\n",
    ],
)
def test_a_file_that_snakemake_reads_passes(tmp_path, text):
    path = tmp_path / "over.yaml"
    path.write_bytes(text.encode())
    read_nodes(path)


@pytest.mark.parametrize(
    "path", [PROJECT / "config.yaml", *(PROJECT / "workflow/scales").glob("*.yaml")]
)
def test_the_shipped_files_pass(path):
    read_nodes(path)


def test_all_segments_of_waymo_fit_twice(tmp_path):
    path = tmp_path / "over.yaml"
    names = [f"segment-{n:020}_6380_000_6400_000_with_camera_labels@0-198" for n in range(2 * 1150)]
    path.write_text(f"train: [{', '.join(names)}]\n")
    read_nodes(path)


def test_what_is_no_file_is_said(tmp_path):
    (tmp_path / "smoke.yaml").write_text("a: 1\n")
    os.mkfifo(tmp_path / "fifo.yaml")
    for name, sentence in {
        "smok.yaml": r"there is no config file .*/smok.yaml; did you mean 'smoke.yaml'\?",
        "fifo.yaml": r".*/fifo.yaml is a pipe or a device, not a file",
        ".": r".* is a folder, not a file",
        "gone/over.yaml": r"there is no config file .*; there is no config in its folder",
    }.items():
        with pytest.raises(GeoEvsError, match=f"^{sentence}"):
            read_nodes(tmp_path / name)


@pytest.mark.parametrize(
    "arguments",
    [
        ["-n", "--configfile", "good.yaml", "bad.yaml", "--", "tables"],
        ["--configfiles", "bad.yaml", "good.yaml", "-n"],
        ["--configfile=bad.yaml"],
        ["--cores", "2", "--config", "a=1", "--configfile", "bad.yaml", "--quiet"],
    ],
)
def test_files_behind_configfile_are_checked(tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    Path("good.yaml").write_text("a: 1\n", encoding="utf-8")
    Path("bad.yaml").write_text("a: 1\n\tb: 2\n", encoding="utf-8")
    with pytest.raises(SystemExit, match=r"^bad.yaml:2: this is not YAML"):
        check_command_line(arguments)
    Path("bad.yaml").write_text("a: 1\n", encoding="utf-8")
    check_command_line(arguments)


@pytest.mark.parametrize("arguments", [[], ["-n", "--configfile"], ["--", "--configfile", "x"]])
def test_what_names_no_file_is_left_to_snakemake(arguments):
    check_command_line(arguments)


def test_every_profile_checks_the_files(tmp_path):
    for path in PROJECT.glob("profiles/*/*.yaml"):
        profile = yaml.safe_load(path.read_text())
        assert "check_command_line()" in profile["__definitions__"], path
        assert profile["__use_yte__"], path

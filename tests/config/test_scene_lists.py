"""Partitions that name lines of a list file."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from snakemake.utils import update_config

from geoevs.config.checks import check_config
from geoevs.config.partitions import expand_scenes, partition_scenes
from geoevs.config.scene_lists import MOST_BYTES, listed_scenes
from geoevs.core.errors import GeoEvsError
from geoevs.scenes.scene import SceneRef, find_sources

PROJECT = Path(__file__).parents[2]
SCHEMA = PROJECT / "workflow/schemas/config.schema.yaml"
LIST = "curve-5\nstraight-6@0-3\njunction-7\ncurve-8\n"
MINI = PROJECT / "workflow/scales/waymo-mini.yaml"


@pytest.fixture
def listed(tmp_path, monkeypatch):
    """A folder to run in that holds `split.txt`."""
    (tmp_path / "split.txt").write_text(LIST)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_indices_count_from_zero_and_ranges_have_both_ends(listed):
    scenes = ["curve-1..2", {"list": "split.txt", "indices": "1..2"}]
    assert expand_scenes(scenes) == ["curve-1", "curve-2", "straight-6@0-3", "junction-7"]
    given = {"list": str(listed / "split.txt"), "indices": [3, 0]}
    assert listed_scenes(given) == ["curve-8", "curve-5"]


def test_a_config_takes_them(listed):
    config = yaml.safe_load((PROJECT / "config.yaml").read_text())
    test = [{"list": "split.txt", "indices": "0..1"}]
    update_config(config, {"datasets": {"street": {"partitions": {"test": test}}}})
    check_config(config, SCHEMA, [])
    assert partition_scenes(config, "test", ["street"]) == [
        ("street", "curve-5"),
        ("street", "straight-6@0-3"),
    ]


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        ("list: no.txt, indices: 0..1", "5: no.txt is missing; make or copy it there"),
        ("list: ., indices: 0..1", "5: . is a folder, not a file; put the file there"),
        (
            "list: split.txt, indices: 3..4",
            "5: split.txt has 4 scenes, with indices 0 to 3, and index 4 is none of them; correct ",
        ),
        ("list: split.txt, indices: 0..999999999", "5: split.txt has 4 scenes, with indices 0 to"),
        ("list: many.txt, indices: 0..10000", "5: up to many.txt there are 10,002 scenes; a part"),
        ("list: split.txt, indices: [1, 9]", "5: split.txt has 4 scenes, with indices 0 to 3, and"),
        ("list: split.txt, indices: 2..1", "5: indices '2..1' are not of the form FIRST..LAST, su"),
        ("list: split.txt, indices: all", "5: indices 'all' are not of the form FIRST..LAST, such"),
        ("list: split.txt", "the key 'indices' is missing under 'datasets.street.partitions.test."),
        ("lists: a, indices: 0..1", "'lists' is not a known key; did you mean 'list'?"),
        ("list: split.txt, indices: 3", "'datasets.street.partitions.test.1.indices' is wrong: 3"),
        ("list: split.txt, indices: [-1]", "indices.0' is wrong: -1 is too small; make it 0 or"),
        ("list: odd.txt, indices: 0..1", "5: odd.txt:2: '../b' is not of the form NAME or NAME@"),
        ("list: empty.txt, indices: 0..1", "5: empty.txt has no scenes; write one a line"),
        ("list: binary.txt, indices: 0..1", "5: binary.txt is no plain text of scenes, one a lin"),
        ("list: large.txt, indices: 0..1", "5: large.txt has 1,000,001 bytes; a list of scenes h"),
    ],
)  # fmt: skip
def test_a_mistake_names_the_overlay_its_line_and_the_list(listed, entry, sentence):
    (listed / "odd.txt").write_text("curve-1\n../b\n")
    (listed / "empty.txt").write_text("")
    (listed / "many.txt").write_text("a\n" * 10_001)
    (listed / "binary.txt").write_bytes(b"\xff\x00\n")
    (listed / "large.txt").write_bytes(b"a" * (MOST_BYTES + 1))
    overlay = listed / "mine.yaml"
    head = "datasets:\n  street:\n    partitions:\n      test: [curve-1,\n"
    overlay.write_text(f"{head}        {{{entry}}}]\n")
    config = yaml.safe_load((PROJECT / "config.yaml").read_text())
    update_config(config, yaml.safe_load(overlay.read_text()))
    with pytest.raises(GeoEvsError) as caught:
        check_config(config, SCHEMA, [PROJECT / "config.yaml", overlay])
    said = str(caught.value)
    assert said.startswith(f"{overlay}:")
    assert sentence in said
    assert "\n" not in said


def test_waymo_mini_is_the_first_fifth_and_its_partitions_share_no_segment(monkeypatch):
    monkeypatch.chdir(PROJECT)
    lines = (PROJECT / "workflow/scales/waymo-mini.txt").read_text().splitlines()
    assert len(lines) == len(set(lines)) == 160
    assert lines == sorted(lines)
    # 1-based, as the list of 798 training segments numbers them.
    assert lines[0] == "10017090168044687777_6380_000_6400_000"
    assert lines[158] == "13506499849906169066_120_000_140_000"
    assert lines[159] == "13517115297021862252_2680_000_2700_000"
    assert all(SceneRef.parse(line) == SceneRef(line) for line in lines)
    partitions = yaml.safe_load(MINI.read_text())["datasets"]["waymo"]["partitions"]
    named = {name: expand_scenes(entries) for name, entries in partitions.items()}
    assert named["train"] == named["clips"] == lines[10:128]
    disjoint = named["geometry"] + named["train"] + named["validation"] + named["test"]
    assert disjoint == lines


@pytest.mark.skipif("waymo" not in find_sources(), reason="there is no data source 'waymo' yet")
def test_waymo_mini_is_planned_without_the_data(tmp_path):
    for name in ("Snakefile", "workflow", "profiles", "config.yaml", "geoevs", "baselines"):
        (tmp_path / name).symlink_to(PROJECT / name)
    files = ("--configfile", "config.yaml", "workflow/scales/waymo-mini.yaml")
    command = [sys.executable, "-m", "snakemake", "-n", "--quiet", "rules", "--cores", "1", *files]
    paths = os.pathsep.join([str(PROJECT), os.environ.get("PYTHONPATH", "")])
    there = os.environ | {"GEOEVS_WAYMO": str(tmp_path / "none"), "PYTHONPATH": paths}
    process = subprocess.run(
        [*command, "--", "tables"],
        cwd=tmp_path,
        env=there,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stdout + process.stderr

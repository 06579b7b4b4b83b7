import json
import platform

import numpy as np
import pytest

from geoevs import PROTOCOL
from geoevs.core.errors import GeoEvsError
from geoevs.core.hashes import hash_path
from geoevs.results import manifest
from geoevs.results.manifest import (
    add_provenance,
    cached_repository,
    install_weights,
    make_manifest,
    write_hash,
)

CONFIG = {"seed": 3, "run": "a"}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene/lidar").mkdir(parents=True)
    (tmp_path / "scene/a").write_text("bc")
    (tmp_path / "scene/lidar/b").write_text("d")
    return tmp_path / "scene"


def test_it_says_what_the_run_was_made_of(folder):
    made = make_manifest(CONFIG, [folder, folder / "a"])
    assert made["config"] == CONFIG
    assert made["seed"] == 3
    assert made["protocol"] == PROTOCOL
    assert list(made["inputs"]) == [str(folder), str(folder / "a")]
    # printf bc | sha256sum
    assert made["inputs"][str(folder / "a")].startswith("1e0bbd6c686ba050")
    assert made["versions"]["numpy"] == np.__version__
    assert made["versions"]["python"] == platform.python_version()
    assert made["machine"]["cores"] >= 1
    assert made["machine"]["memory_bytes"] > 1e8
    assert made["commit"]


def test_hashes_that_were_written_down_are_not_taken_again(folder, monkeypatch):
    whole = make_manifest(CONFIG, [folder, folder / "a"])["inputs"]
    write_hash(folder, folder.parent / "hash.json")
    monkeypatch.setattr(manifest, "hash_path", lambda path: f"hash of {path.name}")
    made = make_manifest(CONFIG, [folder / "a"], hashed=[folder.parent / "hash.json"])["inputs"]
    assert made == {str(folder): whole[str(folder)], str(folder / "a"): "hash of a"}
    assert list(made) == list(whole)


@pytest.mark.parametrize("text", ["[]", '{"scene": 1}'])
def test_what_is_no_hash_is_one_sentence(tmp_path, text):
    (tmp_path / "hash.json").write_text(text)
    with pytest.raises(GeoEvsError, match=r"hash.json holds no hash of a folder; delete it and ma"):
        make_manifest(CONFIG, [], hashed=[tmp_path / "hash.json"])


def test_a_cached_repository_is_known_by_its_files(tmp_path, monkeypatch):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    assert cached_repository("a/b") == "missing"
    assert cached_repository("no/such/name") == "missing"
    cached = tmp_path / "models--a--b"
    for folder in ("refs", "blobs", "snapshots/commit/unet"):
        (cached / folder).mkdir(parents=True)
    (cached / "refs/main").write_text("commit")
    for content in ("c0ffee", "c0c0a"):
        (cached / "blobs" / content).touch()
    weights = cached / "snapshots/commit/unet/weights"
    found = [cached_repository("a/b")]
    for content in ("c0ffee", "c0c0a"):
        weights.unlink(missing_ok=True)
        weights.symlink_to(f"../../../blobs/{content}")
        found.append(cached_repository("a/b"))
    assert len({"missing", *found}) == 4
    assert cached_repository("a/b") == found[-1]


def test_the_same_run_gives_the_same_bytes(folder):
    texts = {json.dumps(make_manifest(CONFIG, [folder])) for _ in range(2)}
    assert len(texts) == 1


@pytest.mark.parametrize(
    "change",
    [
        lambda folder: (folder / "lidar/b").write_text("e"),
        lambda folder: (folder / "lidar/c").write_text(""),
        lambda folder: (folder / "lidar/b").unlink(),
        lambda folder: (folder / "a").rename(folder / "lidar/a"),
        lambda folder: ((folder / "a").unlink(), (folder / "ab").write_text("c")),
    ],
    ids=["content", "new file", "deleted", "moved", "name instead of content"],
)
def test_any_change_of_an_input_changes_its_hash(folder, change):
    before = hash_path(folder)
    change(folder)
    assert hash_path(folder) != before


def test_where_a_folder_lies_does_not_count(folder):
    before = hash_path(folder)
    assert hash_path(folder.rename(folder.with_name("moved"))) == before


def test_a_missing_input_is_named(tmp_path):
    with pytest.raises(GeoEvsError, match=r"gone is missing; make or copy it there$"):
        make_manifest(CONFIG, [tmp_path / "gone"])


def test_a_missing_package_is_said(monkeypatch):
    monkeypatch.setattr(manifest, "PACKAGES", ("no-such-package",))
    assert make_manifest(CONFIG, [])["versions"]["no-such-package"] == "not installed"


def test_without_git_there_is_no_commit(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    assert make_manifest(CONFIG, [])["commit"] == "git is not installed"


def test_provenance_is_kept_of_weights_that_are_not_replaced():
    old = {"seed": 0, "files": {"a": "1", "b": "2"}, "trainings": {"of-a": {}, "of-b": {}}}
    new = {"seed": 1, "files": {"b": "3"}, "trainings": {"of-b": {}}}
    assert add_provenance(new, []) == [new]
    first, second = add_provenance(new, [old])
    assert first == new
    assert second == {"seed": 0, "files": {"a": "1"}, "trainings": {"of-a": {}}}
    assert add_provenance(old, [first, second]) == [old]


def test_installed_weights_stand_with_what_they_were_made_of(tmp_path):
    new, old, work = tmp_path / "new", tmp_path / "weights", tmp_path / "work"
    for path, text in ((new / "prior", "2"), (old / "prior", "1"), (old / "kept", "1")):
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    work.mkdir()
    (work / "losses.csv").write_text("step,loss\n1,9.0\n2,0.25\n")
    earlier = {"files": {"prior": "a", "kept": "b"}, "trainings": {"prior": {}, "kept": {}}}
    (old / "provenance.json").write_text(json.dumps([earlier]))
    config = {"seed": 3, "resolution": [8, 8], "datasets": {}, "pretrain": {"prior": {"steps": 2}}}
    record = install_weights(old, [new / "prior"], {"prior": work}, config)
    assert {path.name: path.read_text() for path in old.iterdir() if path.suffix == ""} == {
        "prior": "2",
        "kept": "1",
    }
    assert record["files"] == {"prior": hash_path(new / "prior")}
    assert record["trainings"] == {"prior": {"settings": {"steps": 2}, "losses": {"loss": 0.25}}}
    assert json.loads((old / "provenance.json").read_text()) == [
        record,
        {"files": {"kept": "b"}, "trainings": {"kept": {}}},
    ]

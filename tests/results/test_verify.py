"""A run that was made honestly passes; every change to it is found."""

import dataclasses
import json
import pickle
import shutil

import numpy as np
import pandas as pd
import pytest

from geoevs import PROTOCOL, layout
from geoevs.core.files import read_json, write_json, write_text
from geoevs.core.hashes import hash_path
from geoevs.core.images import write_image
from geoevs.core.locks import lock_folder
from geoevs.core.parquet import write_parquet
from geoevs.core.stamps import MADE_WITH
from geoevs.methods.contract import ORACLES
from geoevs.protocol.entries import FINE, MethodEntry
from geoevs.protocol.oracle import oracle_step
from geoevs.protocol.pictures import PICTURES, seal_pictures
from geoevs.protocol.provenance import references_stamp, renders_stamp, targets_stamp
from geoevs.protocol.reference import write_references
from geoevs.protocol.rows import cost_frame, protocol_fingerprint, score_frame
from geoevs.protocol.scoring import cost_rows, score_method
from geoevs.protocol.set_scoring import score_sets, set_frame
from geoevs.protocol.targets import write_targets
from geoevs.results.costs import write_cost_table
from geoevs.results.entrants import Entrants
from geoevs.results.formats import write_table
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import TABLES
from geoevs.results.verify import SHOWN, Check, verification_text, verify_run
from geoevs.run import Answers
from tests.results.conftest import PLACE
from tests.results.conftest import PROTOCOL as VIEWS

SETTINGS = TableSettings([0, 15, 30], [0, 0.1], 50, 0.95, "geo-evs")
KEEPS = [1.0, 0.5]


@pytest.fixture(scope="module")
def honest(run, tmp_path_factory):
    """A finished run of the tiny scene, with a control that copies the reference."""
    run = shutil.copytree(run, tmp_path_factory.mktemp("honest") / "run")
    answers = Answers(run, **PLACE)
    cost = {**FINE, "threads": 1, "peak_memory": 1, "gpu_memory": 0, "fit_seconds": 1.0}
    scores, costs, sets = [], [], []
    protocol = {**VIEWS, "reference_keep": KEEPS}
    scene, targets = answers.scene, answers.targets
    where = [
        run / path.format(**PLACE) for path in (layout.TARGETS, layout.REFERENCES, layout.MASKS)
    ]
    write_targets(where[0], targets, targets_stamp(scene, protocol, 0))
    write_references(*where[1:], scene, targets, 0, references_stamp(scene, where[0], 0))
    fingerprint = protocol_fingerprint(answers.scene, protocol)
    for name in ("grey", ORACLES[0]):
        entry, folder = MethodEntry(name), answers.renders(name)
        kinds = ("all-cameras", "front-side")
        if name in ORACLES:
            for sources in kinds:
                oracle_step(name, str(run), *PLACE.values(), sources, str(folder))
        made_with = {MADE_WITH: renders_stamp(answers)}
        sealed = {**cost, PICTURES: seal_pictures(folder, targets), **made_with}
        write_json(folder / "render.json", dict.fromkeys(kinds, sealed))
        scores += score_method(entry, answers, KEEPS, fingerprint)
        costs += cost_rows(entry, answers)
        distances, views = score_sets(entry, run, "d", ["s"], 0.95, protocol)
        sets += distances
        scores += views
    rows = score_frame(scores), cost_frame(costs), set_frame(sets)
    for name, frame in zip((layout.SCORES, layout.COSTS, layout.SET_SCORES), rows, strict=True):
        write_parquet(run / name, frame)
    said = {"paradigm": "", "extra_prior": "", "needs": "", "sees": ""}
    write_json(run / layout.ENTRANTS, {"grey": {"name": "Grey", **said}})
    entrants = Entrants.read(run / layout.ENTRANTS)
    config = {"tables": dataclasses.asdict(SETTINGS), "methods": {"grey": {}}, "protocol": protocol}
    said = {"commit": "abc", "protocol": PROTOCOL, "seed": 0, "config": config}
    said |= {"inputs": {"a": "b"}, "versions": {"python": "3"}, "machine": {"cores": 2}}
    write_json(run / layout.MANIFEST, said)
    for name in TABLES:
        write_table(run / f"tables/{name}", name, rows[0], SETTINGS, entrants, rows[2])
    write_cost_table(run / layout.COST_TABLE, rows[1], entrants)
    lock_folder(run)()  # as a run leaves it
    return run


@pytest.fixture
def copy(honest, tmp_path):
    return shutil.copytree(honest, tmp_path / "run")


def problems(run, rescore=3):
    return {check.name: check.problems for check in verify_run(run, rescore) if check.problems}


def picture(run):
    return run / layout.RENDERS.format(label="grey", **PLACE) / "front/000000.png"


def test_an_honest_run_passes_and_nothing_is_written(honest):
    before = hash_path(honest)
    checks = verify_run(honest, 5)
    assert [check.problems for check in checks] == [[]] * 7
    assert "scores of 5 renders made again" in checks[-1].looked
    assert hash_path(honest) == before


def test_a_run_whose_renders_were_dropped_says_so_and_passes(copy):
    manifest = read_json(copy / layout.MANIFEST)
    manifest["config"]["renders"] = "drop"
    write_json(copy / layout.MANIFEST, manifest)
    shutil.rmtree(copy / "renders")
    checks = {check.name: check for check in verify_run(copy, 5)}
    assert not any(check.problems for check in checks.values())
    dropped = "renders were dropped when they were scored, as the config says"
    assert checks["pictures"].looked == dropped
    assert checks["scores"].looked == f"{dropped}, so no score can be made again"
    del manifest["config"]["renders"]
    write_json(copy / layout.MANIFEST, manifest)
    assert problems(copy).keys() == {"scenes", "pictures", "scores"}


def change_rows(run, change, name=layout.SCORES):
    rows = pd.read_parquet(run / name)
    write_parquet(run / name, change(rows))


def test_a_score_that_its_picture_does_not_give_is_found(copy):
    change_rows(copy, lambda rows: rows.assign(value=rows["value"] + 1))
    found = problems(copy, rescore=50)
    assert found.keys() == {"tables", "scores"}
    assert "by its picture" in found["scores"][0]


def test_a_table_that_its_rows_do_not_give_is_found(copy):
    path = copy / "tables/costs.csv"
    path.write_text(path.read_text(encoding="utf-8").replace(",1.0,", ",0.5,"), encoding="utf-8")
    write_text(copy / "tables/better.csv", "a\n1\n")
    assert problems(copy) == {
        "tables": [
            f"{copy}/tables/better.csv is no table that rows give",
            f"{path}: line 2 says fit_seconds = 0.5, the rows give 1.0",
        ]
    }


def test_pictures_of_another_size_kind_or_content_are_found(copy):
    path = picture(copy)
    write_image(path, np.full((48, 72, 3), 98, np.uint8))
    assert problems(copy)["pictures"] == [f"{path} is not the picture that was rendered"]
    write_image(path, np.full((48, 71, 3), 99, np.uint8))
    assert problems(copy)["pictures"] == [f"{path} is (48, 71), its target 48 x 72"]
    path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n")
    found = problems(copy)
    assert found["files"] == [f"{path} is no png file by its content"]
    assert found["pictures"] == [f"{path} is missing or no PNG"]
    path.rename(path.with_name("000009.png"))
    assert problems(copy)["pictures"][-1].endswith("000009.png is a picture that no row scores")


def test_rows_of_other_targets_and_protocols_are_found(copy):
    first = {"frame": 77, "fingerprint": "0" * 16}
    change_rows(copy, lambda rows: pd.concat([rows, rows.head(1).assign(**first)]))
    found = problems(copy)
    assert "different protocols" in found["tables"][0]
    assert "but scene and manifest give" in found["scenes"][0]
    assert "1 views are no targets rows" in "\n".join(found["scenes"])


def test_rows_without_value_column_or_type_are_found(copy):
    change_rows(copy, lambda rows: rows.assign(value=np.nan))
    assert "rows are ok and have no value" in problems(copy)["rows"][0]
    change_rows(copy, lambda rows: rows.assign(frame="1"))
    assert "column 'frame' holds" in problems(copy)["rows"][0]
    change_rows(copy, lambda rows: rows.drop(columns="frame"))
    assert "lacks the column 'frame'" in problems(copy)["rows"][0]


def test_what_may_hold_code_or_lies_elsewhere_is_found(copy, tmp_path):
    secret = tmp_path / "secret.json"
    write_text(secret, "{}")
    (copy / "link.json").symlink_to(secret)
    (copy / "weights.pt").write_bytes(b"PK")
    write_text(copy / "run.md", "#!/bin/sh\n")
    write_text(copy / "broken.json", "{")
    np.savez(copy / "objects.npz", a=np.array([{}], dtype=object))
    (copy / "model.csv").write_bytes(pickle.dumps([b"\0"]))
    assert problems(copy)["files"] == [
        f"{copy}/broken.json is no JSON",
        f"{copy}/link.json is a link that leads out of the run",
        f"{copy}/model.csv is a program, not text",
        f"{copy}/objects.npz holds Python objects",
        f"{copy}/run.md is a program, not text",
        f"{copy}/weights.pt is of a kind that runs do not have (code, or data that may hold code)",
    ]


@pytest.mark.parametrize("name", ["references", "masks", "targets"])
def test_missing_answers_are_found(copy, name):
    (path,) = (path for path in (copy / name).rglob("*") if path.is_file())
    path.unlink()
    found = problems(copy)
    assert "scenes" in found
    assert str(path) in found["scenes"][0]


def test_answers_of_another_seed_are_found(copy):
    manifest = read_json(copy / layout.MANIFEST)
    write_json(copy / layout.MANIFEST, manifest | {"seed": 1})
    found = problems(copy)
    assert found.keys() == {"scenes"}
    assert "was made with other" in found["scenes"][0]


def test_another_protocol_and_an_unreadable_manifest_are_found(copy):
    manifest = read_json(copy / layout.MANIFEST)
    write_json(copy / layout.MANIFEST, manifest | {"protocol": PROTOCOL + 1})
    assert problems(copy).keys() == {"manifest"}
    for said in ([], {"config": 3}, {"config": {"tables": []}}):
        write_json(copy / layout.MANIFEST, said)
        assert list(problems(copy)) == ["manifest"]
        assert json.dumps(said) not in problems(copy)["manifest"][0]


def test_the_text_names_the_first_problems():
    lines = verification_text([Check("files", "3 files"), Check("rows", "", list("abcde"))])
    assert lines[0] == "files      ok      3 files"
    assert lines[1:] == [
        "rows       FAILED",
        *(f"           - {name}" for name in "abc"[:SHOWN]),
        "           ... and 2 more",
    ]

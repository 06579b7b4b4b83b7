"""Methods that take part in some splits alone, and those that render a frame's views at once."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import baselines
from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json
from geoevs.methods.contract import Rendering
from geoevs.protocol.entries import SPLITS_FILE, MethodEntry, read_splits, takes_part
from geoevs.protocol.render_step import render_step, render_targets
from geoevs.protocol.scoring import cost_rows, score_method
from geoevs.protocol.set_scoring import score_sets
from geoevs.protocol.stability import OUTCOME_FILE
from geoevs.protocol.stability_step import stability_step

ALL = ("observed", "interpolation", "extrapolation", "masked-observed")
INFO = 'MethodInfo("Toy", "control")'
OBSERVED = 'MethodInfo("Toy", "control", splits=("observed",))'
TOGETHER = """
    def render_together(self, cameras, frame):
        {line}
        return [self.render(camera, frame) for camera in cameras]

    def save("""


@pytest.fixture
def edited(toy):
    """Makes a toy whose code is changed."""

    def make(name: str, *changes: tuple[str, str], **lines: str) -> str:
        path = Path(baselines.__path__[-1]) / toy(name, **lines) / "adapter.py"
        text = path.read_text()
        for old, new in changes:
            assert text.count(old) == 1
            text = text.replace(old, new)
        path.write_text(text)
        return name

    return make


@pytest.fixture
def scored(stage, attempt, tmp_path):
    """Fits, renders and scores a method on frame 0; gives its rows and its costs."""

    def run(name: str):
        outcomes = attempt(name, *ALL)
        answers, entry = stage.linked(tmp_path / "run"), MethodEntry(name)
        shutil.copytree(tmp_path / "renders", answers.renders(entry.label))
        rows = score_method(entry, answers, [1.0], "f")
        rows = [row for row in rows if row["frame"] == 0]
        protocol = {**stage.protocol, "reference_keep": [1.0]}
        sets, _ = score_sets(entry, answers.run, "d", ["s"], 0.95, protocol)
        return outcomes, rows, cost_rows(entry, answers), sets

    return run


@pytest.mark.slow
def test_a_split_without_a_method_has_no_rows_of_it(edited, scored, tmp_path):
    (fits, renders), rows, costs, sets = scored(edited("some", (INFO, OBSERVED)))
    assert {outcome["status"] for outcome in (*fits.values(), *renders.values())} == {"ok"}
    assert fits["all-cameras"]["splits"] == fits["front-side"]["splits"] == ["observed"]
    assert "fit_seconds" not in fits["front-side"]
    assert not [*(tmp_path / "model/front-side/model").iterdir()]
    pictures = {path.parent.name for path in (tmp_path / "renders").rglob("*.png")}
    assert pictures == {"front", "left", "right"}
    assert {row["split"] for row in rows} == {"observed"}  # masks need a condition map
    assert {row["status"] for row in rows} <= {"ok", "unavailable"}
    assert [row["sources"] for row in costs] == ["all-cameras"]
    assert {row["split"] for row in sets} == {"observed"}


@pytest.mark.slow
def test_a_fit_that_fails_fails_in_its_own_splits_alone(edited, scored):
    name = edited("broken", (INFO, OBSERVED), fit="raise GeoEvsError('no')")
    (fits, _), rows, costs, _ = scored(name)
    assert (fits["all-cameras"]["status"], fits["front-side"]["status"]) == ("failed", "ok")
    # Nobody could ask whether it has a condition map to mask.
    assert {(row["split"], row["status"]) for row in rows} == {
        ("observed", "failed"),
        ("masked-observed", "failed"),
    }
    assert [row["sources"] for row in costs] == ["all-cameras"]


@pytest.mark.parametrize("said", ["{}", '["observed", "nowhere"]', "[[]]", "", "[3"])
def test_what_a_process_says_of_its_splits_is_checked(tmp_path, said):
    (tmp_path / SPLITS_FILE).write_text(said)
    assert read_splits(tmp_path) == []


def test_masked_views_go_with_their_split(stage):
    by_split = {target.split: target for target in stage.targets}
    for split, asked in (("observed", True), ("masked-observed", True), ("pose-sweep", False)):
        assert takes_part({"splits": ["observed"]}, by_split[split]) == asked
        assert takes_part({}, by_split[split])
        assert takes_part({"splits": []}, by_split[split])
    assert not takes_part({"masked": False}, by_split["masked-observed"])


def test_views_of_a_frame_share_its_seconds(stage, tmp_path, monkeypatch):
    clock = SimpleNamespace(now=0.0)
    clock.perf_counter = lambda: clock.now
    monkeypatch.setattr("geoevs.protocol.clock.time", clock)
    observed = [target for target in stage.targets if target.split == "observed"]
    groups = [observed[:3], observed[3:4]]
    spent = iter([30.0, 6.0, 5.0])

    def render(targets):
        clock.now += next(spent)
        return [Rendering(np.zeros((48, 72, 3))) for _ in targets]

    told = render_targets(render, groups, tmp_path)
    # 30 s for three views when it is cold; then three of 2 s and one of 5 s.
    assert told["warm_up_seconds"] == 10.0
    assert told["render_seconds"] == 2.0
    assert told["clock"] == {"warm-up": 30.0, "views": 11.0}
    assert len([*tmp_path.rglob("*.png")]) == 4


def test_a_frame_is_rendered_at_once_and_splits_apart(edited, stage, tmp_path):
    calls = tmp_path / "calls"
    line = f"open({str(calls)!r}, 'a').write(' '.join(c.name for c in cameras) + chr(10))"
    name = edited("joint", ("\n    def save(", TOGETHER.format(line=line)))
    targets = stage.keep(tmp_path / "targets.json", "observed", "extrapolation", "masked-observed")
    masks = str(stage.answers.path(layout.MASKS))
    places = (str(tmp_path), masks, str(tmp_path / "renders"))
    render_step(name, str(targets), "all-cameras", *places, warm_up=False)
    first, second = calls.read_text().splitlines()
    assert first == "front left right"
    assert len(second.split()) == 4
    assert len([*(tmp_path / "renders").rglob("*.png")]) == 7


def test_too_few_views_are_a_sentence(edited, stage, tmp_path):
    name = edited("few", ("\n    def save(", TOGETHER.format(line="cameras = cameras[1:]")))
    targets = stage.keep(tmp_path / "targets.json", "observed")
    masks = str(stage.answers.path(layout.MASKS))
    with pytest.raises(GeoEvsError, match="returned 2 renderings of 3 cameras; return one of each"):
        render_step(name, str(targets), "all-cameras", str(tmp_path), masks, str(tmp_path / "r"))


def test_stresses_ask_for_no_split_without_the_method(edited, stage, tmp_path):
    targets = stage.keep(tmp_path / "targets.json", "extrapolation")
    (tmp_path / "out").mkdir()
    stress = {"key": "a", "scene": str(stage.store.folder), "seed": 0}
    limits = {"fit": None, "render": None}
    for name, change, count in (("none", OBSERVED, 0), ("all", INFO, 4)):
        method = edited(name, (INFO, change))
        out = tmp_path / "out" / name
        out.mkdir()
        masks = str(stage.answers.path(layout.MASKS))
        arguments = (method, {}, [stress], str(targets), None, masks, str(out), "log", limits, 0)
        stability_step(*arguments)
        outcome = read_json(out / "a" / OUTCOME_FILE)
        assert outcome["status"] == "ok", outcome
        assert len([*out.rglob("*.png")]) == count
        assert outcome["splits"] == (["observed"] if name == "none" else [])

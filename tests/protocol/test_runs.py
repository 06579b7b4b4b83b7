import re
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_json
from geoevs.core.images import read_image
from geoevs.core.machine import machine
from geoevs.methods.contract import Budget
from geoevs.protocol.entries import MethodEntry, read_outcomes
from geoevs.protocol.fit_step import fit_step
from geoevs.protocol.render_step import render_step
from geoevs.protocol.runs import fit_method, render_method

BUDGET = Budget(seconds=None, threads=1)


def test_a_good_method_leaves_images_and_costs(toy, attempt, tmp_path):
    fits, renders = attempt(toy("good"), "interpolation", "extrapolation")
    assert list(fits) == list(renders) == ["all-cameras", "front-side"]
    for sources in fits:
        fit, render = fits[sources], renders[sources]
        assert fit["status"] == render["status"] == "ok"
        assert fit["stage"] == fit["reason"] == fit["log"] == ""
        assert (render["primitives"], render["parameters"], render["note"]) == (3, 2, "toy")
        assert render["bytes"] == 5  # what its save wrote
        assert (tmp_path / "model" / sources / "model/value").read_bytes() == b"12345"
        assert render["fit_seconds"] == fit["fit_seconds"]
        assert render["peak_memory"] >= fit["peak_memory"] > 10e6
        assert fit.items() >= machine().items()
        assert render.items() >= machine().items()
    images = sorted(path.relative_to(tmp_path / "renders") for path in tmp_path.rglob("*.png"))
    assert len(images) == 5  # interpolation, and two sides times two shifts
    for image in images:
        pixels = read_image(tmp_path / "renders" / image)
        assert pixels.shape == (48, 72, 3)
        assert (pixels == 128).all()  # 0.5 * 255, rounded to even


def test_a_fit_that_another_machine_renders_names_both(toy, attempt, monkeypatch):
    machines = iter([{"host": host, "cpu": "EPYC"} for host in ("a", "b")])
    monkeypatch.setattr("geoevs.protocol.runs.machine", lambda: next(machines))
    fits, renders = attempt(toy("good"), "extrapolation")
    assert (fits["all-cameras"]["host"], fits["all-cameras"]["cpu"]) == ("a", "EPYC")
    assert (renders["all-cameras"]["host"], renders["all-cameras"]["cpu"]) == ("a, b", "EPYC")


def test_seconds_are_of_the_fit_and_of_a_view_alone(toy, stage, tmp_path, monkeypatch):
    clock = SimpleNamespace(now=0.0, views=[50.0, 1.0, 9.0, 2.0, 4.0])
    clock.perf_counter = lambda: clock.now
    monkeypatch.setattr("geoevs.protocol.clock.time", clock)
    spend = "from geoevs.protocol.clock import time as clock; clock.now += "
    lines = {"fit": "3", "load": "100", "render": "clock.views.pop(0)"}
    name = toy("slow", **{place: spend + seconds for place, seconds in lines.items()})
    targets = stage.keep(tmp_path / "targets.json", "extrapolation")
    model = tmp_path / "fit/model"
    model.mkdir(parents=True)
    where = (str(stage.store.folder), name, {}, 0, "all-cameras", {}, str(model))
    assert fit_step(*where, ["extrapolation"])["fit_seconds"] == 3.0
    masks = str(stage.answers.path(layout.MASKS))
    places = (str(model), masks, str(tmp_path / "renders"))
    rendered = render_step(name, str(targets), "all-cameras", *places)
    # The first view is rendered twice; how long it takes when the machine is cold stands apart.
    clock_ = rendered.pop("clock")
    assert clock_ == {"load": 100.0, "warm-up": 50.0, "views": 16.0}
    assert rendered == {"load_seconds": 100.0, "warm_up_seconds": 50.0, "render_seconds": 3.0}
    assert clock.views == []


def test_compilation_is_no_cost_of_a_fit_but_noted(toy, attempt):
    lines = "import numba; numba.njit(parallel=True)(lambda x: (2 * x + 1).sum())(np.ones(9))"
    fits, _ = attempt(toy("compiled", fit=lines))
    fit = fits["all-cameras"]
    noted = re.fullmatch(r"toy; kernels compiled in (\d+\.\d) s, not counted", fit["note"])
    assert noted
    assert 0 <= fit["fit_seconds"] < float(noted[1])


# Where the method breaks: lines of fit, render or load; the stage, and the reason's start.
FAILURES = {
    "fit raises": ({"fit": "raise KeyError('oops')"}, "fit", "KeyError: 'oops'"),
    "fit leaves": ({"fit": "os._exit(0)"}, "fit", "the process ended by itself with exit code 0"),
    "undeclared": ({"fit": "views.lidar(0)"}, "fit", "the method reads lidar without declaring"),
    "load raises": ({"load": "raise OSError('gone')"}, "render", "OSError: gone"),
    "render crashes": (
        {"render": "os.kill(os.getpid(), signal.SIGSEGV)"},
        "render",
        "the process was killed by SIGSEGV",
    ),
}


@pytest.mark.parametrize("error", ["GeoEvsError", "KeyError"])
def test_what_a_fit_stopped_at_on_purpose_is_kept(toy, attempt, tmp_path, error):
    lines = f"from geoevs.core.errors import GeoEvsError; raise {error}('stopped')"
    fits, _ = attempt(toy("bad", fit=lines))
    assert (fits["all-cameras"]["status"], fits["all-cameras"]["stage"]) == ("failed", "fit")
    reason, folder = fits["all-cameras"]["reason"], tmp_path / "model" / "all-cameras" / "model"
    if error == "GeoEvsError":
        assert reason == f"stopped; what it saved is in {folder}"
        assert (folder / "value").exists()
    else:
        assert reason == "KeyError: 'stopped'"
        assert not list(folder.iterdir())


def without_stamps(outcomes):
    return {name: {**outcome, "made_with": {}} for name, outcome in outcomes.items()}


@pytest.mark.parametrize("kind", FAILURES)
def test_a_failing_method_is_a_status_with_stage_reason_and_log(toy, attempt, tmp_path, kind):
    lines, stage, reason = FAILURES[kind]
    fits, renders = attempt(toy("bad", **lines))
    outcome = renders["all-cameras"]
    assert (outcome["status"], outcome["stage"]) == ("failed", stage)
    assert outcome["reason"].startswith(reason)
    assert outcome["log"] == str(tmp_path / f"{stage}.log")
    if stage == "fit":
        assert without_stamps(fits) == without_stamps(renders)
        assert not list(tmp_path.rglob("*.png"))
    else:
        assert fits["all-cameras"]["status"] == "ok"
        assert outcome["fit_seconds"] == fits["all-cameras"]["fit_seconds"]
    if not reason.startswith("the process"):
        assert "Traceback" in (tmp_path / f"{stage}.log").read_text()


def test_sources_fail_one_by_one(toy, attempt):
    name = toy("half", fit="views.image('front', 0)")
    _, renders = attempt(name, "interpolation", "extrapolation")
    assert renders["all-cameras"]["status"] == "ok"
    assert renders["front-side"]["status"] == "failed"
    assert renders["front-side"]["reason"].startswith("camera 'front' is not a source of this")


def test_a_method_that_does_not_exist_is_a_failure_too(attempt):
    fits, renders = attempt("nothing")
    assert fits["all-cameras"]["reason"].startswith("there is no method called 'nothing'; ")
    assert without_stamps(renders) == without_stamps(fits)


def test_a_second_fit_starts_a_new_log(toy, stage, tmp_path):
    targets = stage.keep(tmp_path / "targets.json", "extrapolation")
    (tmp_path / "log").write_text("of an earlier run\n")
    entry, scene = MethodEntry(toy("loud", fit="print('fitted')")), stage.store.folder
    fit_method(entry, scene, targets, BUDGET, tmp_path / "model", tmp_path / "log")
    assert (tmp_path / "log").read_text() == "fitted\n"


# What one line of render does to the picture, and the sentence that refuses it.
PICTURES = {
    "wrong size": ("rgb = rgb[1:]", "rgb has shape (47, 72, 3); the camera asks for (48, 72, 3)"),
    "alpha": ("rgb = rgb[..., [0, 1, 2, 2]]", "shape (48, 72, 4); the camera asks for (48, 72, 3)"),
    "NaN": ("rgb[3, 4] = np.nan", "rgb spans nan to nan; keep it finite and in [0, 1]"),
    "infinity": ("rgb[3, 4] = np.inf", "rgb spans 0.5 to inf; keep it finite and in [0, 1]"),
    "up to 255": ("rgb *= 255", "rgb spans 127.5 to 127.5; keep it finite and in [0, 1]"),
    "from -1": ("rgb[0] = -1", "rgb spans -1 to 0.5; keep it finite and in [0, 1]"),
    "wide integers": ("rgb = (255 * rgb).astype(int)", "int64; give uint8, or float in [0, 1]"),
    "a list": ("rgb = rgb.tolist()", "rgb is a list; make it a NumPy array"),
}


@pytest.mark.parametrize("kind", PICTURES)
def test_pictures_that_are_none_are_refused(toy, stage, tmp_path, kind):
    line, sentence = PICTURES[kind]
    targets = stage.keep(tmp_path / "targets.json", "interpolation")
    name = toy(f"picture_{kind.replace(' ', '_')}", render=line).replace("_", "-")
    masks = str(stage.answers.path(layout.MASKS))
    with pytest.raises(GeoEvsError) as caught:
        render_step(name, str(targets), "front-side", str(tmp_path), masks, str(tmp_path))
    key = "interpolation-front/000000"
    assert str(caught.value).startswith(f"target {key}: rgb ")
    assert str(caught.value).endswith(sentence)


@pytest.mark.parametrize("text", ["[]", '{"all-cameras": {"status": "ok"}}', "{"])
def test_a_fit_of_the_wrong_shape_is_one_sentence(stage, tmp_path, text):
    (tmp_path / "fit.json").write_text(text)
    with pytest.raises(GeoEvsError, match=rf"^{tmp_path / 'fit.json'} (does not say|is not valid)"):
        render_method(
            MethodEntry("mean-colour"),
            tmp_path,
            *(stage.answers.path(pattern) for pattern in (layout.TARGETS, layout.MASKS)),
            tmp_path / "renders",
            tmp_path / "log",
        )
    assert not (tmp_path / "renders").exists()


def test_outcomes_survive_a_round_trip(tmp_path):
    blank = {**dict.fromkeys(("stage", "reason", "log"), ""), "status": "ok"}
    outcomes = {
        "all-cameras": {**blank, "threads": 1, "peak_memory": 1, "gpu_memory": 0, "more": [1]}
    }
    write_json(tmp_path / "fit.json", outcomes)
    assert read_outcomes(tmp_path / "fit.json") == outcomes


NAMES = st.from_regex(r"[a-z0-9]+(-[a-z0-9]+)*", fullmatch=True)


@given(method=NAMES, variant=NAMES, seed=st.integers(0, 99))
def test_names_say_method_and_variant(method, variant, seed):
    entry = MethodEntry.parse(f"{method}.{variant}", {"a": 1}, seed)
    assert (entry.method, entry.variant, entry.options) == (method, variant, {"a": 1})
    assert entry == MethodEntry(method, variant, {"a": 1}, seed)


def test_labels_by_hand():
    labels = {
        MethodEntry.parse(name, {}, seed).label: (name, seed)
        for name, seed in [("a-b", 0), ("a-b", 2), ("a-b.fast", 0), ("a-b.fast", 2)]
    }
    assert list(labels) == ["a-b", "a-b.seed2", "a-b.fast", "a-b.fast.seed2"]

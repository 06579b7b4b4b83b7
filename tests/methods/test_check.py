"""The contract's checks tell good adapters from broken ones, and new adapters are good ones."""

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

import baselines
from geoevs.cli import adapters
from geoevs.cli.arguments import parse_json
from geoevs.core.errors import GeoEvsError
from geoevs.core.images import write_image
from geoevs.methods.check import CHECKS, check_adapter, contract_failures
from geoevs.methods.finding import find_methods
from geoevs.methods.template import new_adapter
from geoevs.methods.tiny import HEIGHT, WIDTH

GOOD = """
from dataclasses import dataclass, field
from pathlib import Path
import json
import numpy as np
from geoevs.methods.contract import FitReport, MethodInfo, Rendering

@dataclass
class Method:
    info = MethodInfo("Good", "control")
    colour: list = field(init=False, default_factory=lambda: [0.0, 0.0, 0.0])

    def fit(self, views, budget, rng):
        self.colour = rng.numpy.random(3).tolist()
        return FitReport()

    def render(self, camera, frame):
        rgb = np.zeros((camera.height, camera.width, 3), np.float32)
        return Rendering(rgb + np.float32(self.colour))

    def save(self, folder):
        (folder / "colour.json").write_text(json.dumps(self.colour))

    @classmethod
    def load(cls, folder):
        method = cls()
        method.colour = json.loads((folder / "colour.json").read_text())
        return method
"""


def statuses(name, **options):
    return {check.name: check.status for check in check_adapter(name, options)}


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("mean-colour", {}),
        ("nearest-view", {}),
        ("reproject", {}),
        ("reproject-inpaint", {}),
        ("reproject", {"frames": "all"}),
        ("reproject-inpaint", {"frames": "all"}),
    ],
)
def test_controls_pass(name, options):
    assert set(statuses(name, **options).values()) == {"passed"}


def test_external_passes_with_images(tmp_path):
    for camera in ("virtual", "front"):
        write_image(tmp_path / f"tiny/{camera}/000001.png", np.zeros((HEIGHT, WIDTH, 3)))
    assert contract_failures("external", folder=str(tmp_path)) == []


def test_a_new_adapter_passes(repository):
    written = new_adapter("my-first_method", repository)
    assert [str(path.relative_to(repository)) for path in written] == [
        "baselines/my_first_method/adapter.py",
        "baselines/my_first_method/__init__.py",
        "tests/baselines/test_my_first_method.py",
    ]
    assert "my-first-method" in find_methods()
    assert set(statuses("my-first-method").values()) == {"passed"}
    assert len(written[0].read_text().splitlines()) < 60
    with pytest.raises(GeoEvsError, match="exists already"):
        new_adapter("my-first-method", repository)


@pytest.mark.parametrize(
    "name", ["../evil", "a/b", "Upper", "1st", "", "a b", "class", "match", "x.y", "-x", "über"]
)
def test_illegal_names_are_refused(repository, name):
    with pytest.raises(GeoEvsError, match="name"):
        new_adapter(name, repository)
    assert not list((repository / "baselines").iterdir())


@pytest.mark.parametrize("name", ["reproject", "controls"])
def test_taken_names_are_refused(repository, name):
    (repository / "baselines" / "controls").mkdir()
    with pytest.raises(GeoEvsError, match="exists already"):
        new_adapter(name, repository)


def test_the_good_adapter_passes(adapter):
    assert set(statuses(adapter(GOOD)).values()) == {"passed"}


BROKEN = {
    "nondeterministic": ("rng.numpy.random(3)", "np.random.rand(3)", "determinism"),
    "writes in cwd": ("return FitReport()", "open('x', 'w'); return FitReport()", "own folder"),
    "writes beside itself": (
        "return FitReport()",
        "(Path(__file__).parent / 'cache.bin').write_text('x'); return FitReport()",
        "own folder",
    ),
    "forgets state": ("method.colour = json", "json", "save and reload"),
    "reads the scene late": (
        "self.colour = rng.numpy.random(3).tolist()",
        "type(self).views = views",
        "save and reload",
    ),
    "wrong shape": ("(camera.height, camera.width, 3)", "(camera.width, 3)", "source view"),
    "out of range": ("np.float32(self.colour)", "2", "virtual view"),
    "not finite": ("np.float32(self.colour)", "np.nan", "virtual view"),
    "wrong type": ("np.float32(self.colour)", "1).astype(np.int32", "virtual view"),
    "no rendering": ("return Rendering(", "return (", "source view"),
    "no report": ("return FitReport()", "pass", "fit"),
    "raises": ("return FitReport()", "raise KeyError('oops')", "fit"),
    "undeclared LiDAR": ("return FitReport()", "views.lidar(0); return FitReport()", "fit"),
    "no name": ('MethodInfo("Good"', 'MethodInfo(""', "info"),
    "unknown need": ('"control")', '"control", needs=("radar",))', "info"),
    "does not import": ("import json", "import jason", "import"),
    "knows the metrics": ("import json", "import json\nfrom geoevs import protocol", "imports"),
    "knows the tables": ("import json", "import json\nimport geoevs.results.tables", "imports"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_each_broken_adapter_fails_its_check(adapter, kind):
    old, new, failed = BROKEN[kind]
    assert GOOD.count(old) == 1
    text = GOOD.replace(old, new)
    if kind == "reads the scene late":
        text = text.replace("np.float32(self.colour)", "self.views.image('front', 0)")
    checks = {check.name: check for check in check_adapter(adapter(text), {})}
    assert checks[failed].status == "failed"
    assert checks[failed].sentence


MASKED = """
    def render_masked(self, camera, frame, keep):
        rendering = self.render(camera, frame)
        return Rendering(np.where(keep[..., None], rendering.rgb, np.float32(0)))

    def save("""
BROKEN_MASKS = {
    "wrong shape": (
        "rendering.rgb, np.float32(0))",
        "rendering.rgb, np.float32(0))[1:]",
        "masked view",
    ),
    "changes what it keeps": ("np.float32(0))", "np.float32(0)) / 2", "masked view"),
    "nondeterministic": ("np.float32(0))", "np.float32(np.random.rand()))", "determinism"),
    "forgets state": ("np.float32(0))", "np.float32(self.fill))", "save and reload"),
}


def test_an_adapter_with_a_condition_map_passes(adapter):
    assert set(statuses(adapter(GOOD.replace("\n    def save(", MASKED))).values()) == {"passed"}


@pytest.mark.parametrize("kind", BROKEN_MASKS)
def test_each_broken_mask_fails_its_check(adapter, kind):
    old, new, failed = BROKEN_MASKS[kind]
    assert MASKED.count(old) == 1
    text = GOOD.replace("\n    def save(", MASKED.replace(old, new))
    if kind == "forgets state":
        text = text.replace("return FitReport()", "self.fill = 0.25\n        return FitReport()")
        text = text.replace("method = cls()", "method = cls()\n        method.fill = 0.75")
    found = statuses(adapter(text))
    assert found[failed] == "failed"
    assert {found[name] for name in ("source view", "virtual view")} == {"passed"}


SPLATS = """
    def splats(self, frame):
        from geoevs.scenes.splats import Splats
        rest = np.zeros((1, 3)), np.zeros(1), np.array([[self.colour]])
        return Splats(np.full((1, 3), 1.0), np.ones((1, 4)), *rest)

    def save("""
BROKEN_SPLATS = {
    "another type": ("return Splats(", "return list((", "splats"),
    "wrong shape": ("np.ones((1, 4))", "np.ones((2, 4))", "splats"),
    "not finite": ("1.0)", "np.nan)", "splats"),
    "nondeterministic": ("1.0)", "np.random.rand())", "determinism"),
    "forgets state": ("1.0)", "self.fill)", "save and reload"),
}


def test_an_adapter_of_gaussians_passes(adapter):
    assert set(statuses(adapter(GOOD.replace("\n    def save(", SPLATS))).values()) == {"passed"}


@pytest.mark.parametrize("kind", BROKEN_SPLATS)
def test_each_broken_set_of_gaussians_fails_its_check(adapter, kind):
    old, new, failed = BROKEN_SPLATS[kind]
    assert SPLATS.count(old) == 1
    broken = SPLATS.replace(old, new)
    if kind == "another type":
        broken = broken.replace("*rest)", "*rest))")
    text = GOOD.replace("\n    def save(", broken)
    if kind == "forgets state":
        text = text.replace("self.colour = rng", "self.fill = 0.5\n        self.colour = rng")
    assert statuses(adapter(text))[failed] == "failed"


def test_undeclared_needs_fail_even_if_the_refusal_is_swallowed(adapter):
    text = GOOD.replace(
        "return FitReport()",
        "\n        try:\n            views.lidar(0)\n        except Exception:\n            pass"
        "\n        return FitReport()",
    )
    checks = {check.name: check for check in check_adapter(adapter(text), {})}
    assert checks["fit"].status == "passed"
    assert checks["declared needs"].status == "failed"
    assert "add 'lidar'" in checks["declared needs"].sentence


def test_needs_that_are_never_used_warn(adapter):
    text = GOOD.replace('"control")', '"control", needs=("tracks",))')
    found = statuses(adapter(text))
    assert found["declared needs"] == "warned"
    assert set(found.values()) == {"passed", "warned"}


def test_after_a_failed_fit_the_rest_is_skipped(adapter):
    text = GOOD.replace("return FitReport()", "raise KeyError('oops')")
    checks = check_adapter(adapter(text), {})
    assert [check.name for check in checks] == list(CHECKS)
    (fit,) = [check for check in checks if check.name == "fit"]
    assert "KeyError: 'oops'" in fit.sentence
    assert "adapter.py:" in fit.sentence
    assert "Traceback" in fit.traceback
    assert {check.status for check in checks if check.name in ("determinism", "source view")} == {
        "skipped"
    }


def test_unknown_methods_and_options_are_refused():
    with pytest.raises(GeoEvsError, match="did you mean 'reproject'"):
        check_adapter("reprojct", {})
    with pytest.raises(GeoEvsError, match="has no option 'radius'"):
        check_adapter("reproject-inpaint", {"radius": 3})


@pytest.fixture
def run():
    app = Typer()
    adapters.register(app)
    return lambda *arguments: CliRunner().invoke(app, arguments)


def test_the_commands(repository, monkeypatch, run):
    monkeypatch.setattr(baselines, "__path__", baselines.__path__[::-1])
    made = run("new-adapter", "made-by-command")
    assert made.exit_code == 0, made.output
    assert "baselines/made_by_command/adapter.py" in made.output
    checked = run("check-adapter", "made-by-command")
    assert checked.exit_code == 0, checked.output
    assert checked.output.count("✓") == len(CHECKS) + 1  # and that it reads without torch


@pytest.mark.parametrize("command", ["new-adapter", "check-adapter"])
@pytest.mark.parametrize("name", ["reference", "truth"])
def test_the_name_of_a_control_that_copies_the_answer_is_taken(run, command, name):
    refused = run(command, name)
    assert refused.exit_code == 1
    assert str(refused.exception).startswith(f"'{name}' is the control that copies the answer")


def test_the_check_command_fails_with_a_sentence(adapter, run):
    name = adapter(GOOD.replace("return FitReport()", "raise KeyError('oops')"))
    checked = run("check-adapter", name)
    assert checked.exit_code == 1
    assert "✗ fit: KeyError: 'oops'" in checked.output
    assert "Traceback" not in checked.output
    assert "Traceback" in run("check-adapter", name, "--traceback").output


def test_options_are_json():
    assert parse_json("--options", '{"inpaint": "telea"}') == {"inpaint": "telea"}
    for text in ("inpaint=telea", "[1]"):
        with pytest.raises(GeoEvsError, match="--options"):
            parse_json("--options", text)

"""What entrants say of themselves, whatever their modules do."""

import sys

import pandas as pd
import pytest

import baselines
from geoevs.core.files import write_json
from geoevs.methods.contract import ORACLES
from geoevs.protocol.entrants import describe_entrants
from geoevs.protocol.entries import FLOOR
from geoevs.results.entrants import Entrants
from geoevs.results.settings import TableSettings
from geoevs.results.tables import make_table


@pytest.fixture
def adapter(tmp_path, monkeypatch):
    """Writes a method's module into a folder of its own beside the baselines."""
    monkeypatch.setattr(baselines, "__path__", [*baselines.__path__, str(tmp_path)])

    def write(name: str, text: str) -> str:
        for module in (f"baselines.{name}", f"baselines.{name}.adapter"):  # another test's
            monkeypatch.delitem(sys.modules, module, raising=False)
        (tmp_path / name).mkdir()
        (tmp_path / name / "adapter.py").write_text(text)
        return name

    return write


def test_an_entrant_says_who_it_is():
    (made,) = describe_entrants({"three-dgs.small": {"gaussians": 9}}).values()
    assert made["name"] == "3DGS"
    assert (made["paradigm"], made["extra_prior"]) == ("reconstruction", "none")
    assert (made["needs"], made["sees"], made["splits"]) == ("sfm lidar", "views", "")
    assert made["citation"].startswith("Kerbl et al.")


def test_options_may_change_what_it_needs():
    options = {"reproject": {}, "reproject.all-frames": {"frames": "all"}}
    needs = [made["needs"] for made in describe_entrants(options).values()]
    assert needs == ["lidar", "lidar tracks"]


def test_without_its_trained_weights_it_still_says_who_it_is():
    assert describe_entrants({"geo-evs": {}})["geo-evs"]["needs"] == "lidar training"


def test_a_control_is_one_wherever_it_lies(adapter, tmp_path):
    text = "from geoevs.methods.contract import MethodInfo\n"
    text += "class Method:\n    info = MethodInfo('Flat', 'control')"
    players = (adapter("elsewhere", text), FLOOR, *ORACLES, "geo-evs")
    write_json(tmp_path / "entrants.json", describe_entrants({name: {} for name in players}))
    row = {"dataset": "d", "scene": "s", "variant": "default", "split": "masked-observed"}
    row |= {"metric": "psnr", "value": 20.0, "status": "ok", "stressor": "", "reason": ""}
    row |= {"frame": 0, "fingerprint": "f", "target": "t", "seed": 0, "level": float("nan")}
    scores = pd.DataFrame([row | {"method": name} for name in players])
    settings = TableSettings([], [], 100, 0.9, "geo-evs")
    table = make_table("masked", scores, settings, Entrants.read(tmp_path / "entrants.json"))
    groups = table.drop_duplicates("method").set_index("method")["group"].to_dict()
    assert groups == dict.fromkeys(players, "control") | {"geo-evs": "method"}


@pytest.mark.parametrize(
    "text",
    [
        "import no_such_package",
        "def fit(:",
        "raise SystemExit(3)",
        "class Method: pass",
        "class Method:\n    info = ('Mine', 'control')",
    ],
)
def test_one_that_cannot_say_so_has_its_bare_name(adapter, text):
    (made,) = describe_entrants({adapter("mine", text): {}}).values()
    assert made["name"] == "mine"
    assert {made[key] for key in ("paradigm", "extra_prior", "needs", "sees", "citation")} == {""}


def test_its_words_are_text_of_one_line(adapter):
    line = "MethodInfo('My\\n  method', 'control', None, ['lidar'])"
    text = f"from geoevs.methods.contract import MethodInfo\nclass Method:\n    info = {line}"
    (made,) = describe_entrants({adapter("mine", text): {}}).values()
    assert made["name"] == "My method"
    assert (made["extra_prior"], made["needs"]) == ("None", "lidar")

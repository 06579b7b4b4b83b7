"""The training contract: what breaks it is one sentence before any job, what keeps it passes."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import baselines
from geoevs.conditions.trial import check_method, trial_inputs
from geoevs.config.checks import check_config
from geoevs.core.attempts import attempt_file
from geoevs.core.code_hash import code_hash
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json
from geoevs.methods.check_training import TRAINING_CHECKS
from geoevs.methods.finding import find_methods, find_trainings, training_class
from geoevs.methods.template import new_adapter
from geoevs.methods.tiny import write_tiny_scene
from geoevs.methods.trained import trained_seconds
from geoevs.methods.training import Inputs
from geoevs.methods.training_steps import combine_files, prepare_scene, train_method

PROJECT = Path(__file__).parents[2]


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """An empty repository whose baselines are found beside the real ones."""
    (tmp_path / "baselines").mkdir()
    monkeypatch.setattr(baselines, "__path__", [*baselines.__path__, str(tmp_path / "baselines")])
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("baselines.trial_")]:
        del sys.modules[name]


@pytest.fixture
def trained(repository, request):
    """Writes a method that trains, its training.py changed; gives the method's name."""

    def write(*changes):
        name = f"trial-{abs(hash(request.node.name)) % 10**6}"
        new_adapter(name, repository, training=True)
        path = repository / "baselines" / name.replace("-", "_") / "training.py"
        text = path.read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path.write_text(text)
        return name

    return write


def check(method):
    """Check the default config with a method that trains."""
    config = yaml.safe_load((PROJECT / "config.yaml").read_text())
    config["methods"][method] = {}
    check_config(config, PROJECT / "workflow/schemas/config.schema.yaml", [])


BROKEN = {
    "no train": (("def train(", "def learn("), "class Training lacks 'train'; add it"),
    "no prepare": (("def prepare(", "def ready("), "class Training lacks 'prepare'; add it"),
    "no partition": (('    partition: ClassVar[str] = "train"', ""), "lacks 'partition'"),
    "no settings": (("    Settings: ClassVar[type] = Settings\n", ""), "lacks 'Settings'"),
    "no class": (("class Training:", "class Learning:"), "has no class Training; name its"),
    "a partition that nobody has": (
        ('ClassVar[str] = "train"', 'ClassVar[str] = "trian"'),
        "there is no partition 'trian' to train on; did you mean 'train'? (one of: clips, train)",
    ),
    "a partition that tests": (('= "train"', '= "test"'), "there is no partition 'test' to train"),
    "something that it cannot read": (
        ("reads: ClassVar[tuple[str, ...]] = ()", 'reads = ("point-map",)'),
        "a training cannot read 'point-map'; did you mean 'point-maps'?",
    ),
    "a prior that no setting names": (
        ("reads: ClassVar[tuple[str, ...]] = ()", 'reads = ("prior",)'),
        "it reads a prior, but Settings has no text 'prior' that names it; add it",
    ),
    "a setting without a default": (
        ("steps: Count = 200\n    batch: Count = 512\n    learning_rate: Positive = 1.0e-2",
         "steps: Count\n    batch: Count\n    learning_rate: Positive"),
        "the setting 'steps' has no default; give it one",
    ),
    "a syntax error": (("class Training:", "class Training"), "cannot be read (SyntaxError: "),
    "a module that is not there": (
        ("import numpy as np\n", "import numpy as np\nimport no_such_module\n"),
        "cannot be read (ModuleNotFoundError: No module named 'no_such_module'); mend it",
    ),
    "an end of the process": (
        ("import numpy as np\n", "import sys\n\nimport numpy as np\n\nsys.exit(3)\n"),
        "cannot be read (SystemExit: 3); mend it",
    ),
    "an end of the process without a word": (
        ("import numpy as np\n", "import os\n\nimport numpy as np\n\nos._exit(0)\n"),
        "/training.py ends the process that imports it; let it do nothing when it is imported",
    ),
    "a setting that is the section's own word": (
        ("    steps: Count = 200\n", "    steps: Count = 200\n    variants: int = 3\n"),
        "'variants' are trainings by name in every section; rename the setting",
    ),
    "a setting without a type": (
        ("steps: Count = 200", "steps: 'whatever' = 200"),
        "the setting 'steps' has no type that can be checked",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_contract_is_one_sentence_before_any_job(trained, kind):
    change, sentence = BROKEN[kind]
    method = trained(change)
    with pytest.raises(GeoEvsError) as caught:
        check(method)
    assert sentence in str(caught.value)
    assert "training.py" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_new_adapter_writes_keeps_the_contract(trained):
    method = trained()
    check(method)
    checks = {done.name: done for done in check_method(method, {}, {})}
    assert set(TRAINING_CHECKS) < set(checks)
    assert {done.status for done in checks.values()} == {"passed"}


MUTANTS = {
    "prepare": (
        '"wanted": wanted}',
        '"wanted": wanted + np.random.default_rng().integers(9, size=(1, 3))}',
    ),
    "train": ("report)\n", 'report)\n        raise ValueError("nothing learned")\n'),
    "train after a kill": ("matrix})", "matrix + np.random.default_rng().random((3, 4))})"),
}


@pytest.mark.parametrize("kind", MUTANTS)
def test_what_breaks_the_contract_is_found_by_its_check(trained, kind):
    method = trained(MUTANTS[kind])
    failed = [done.name for done in check_method(method, {}, {}) if done.status == "failed"]
    assert failed[0] == kind


def test_a_wrong_setting_is_refused_before_anything_is_trained(trained):
    method = trained()
    for values, sentence in (
        ({"stepps": 3}, f"the training of '{method}' has no option 'stepps'; did you mean 'steps'"),
        ({"steps": "3"}, f"the training of '{method}' cannot have '3' for its option 'steps'"),
    ):
        with pytest.raises(GeoEvsError, match=f"^{sentence}"):
            check_method(method, {}, values)


def test_a_training_may_raise_anything(trained, tmp_path, capsys):
    method = trained(
        ("        parts = [", '        raise RuntimeError("out of luck")\n        parts = [')
    )
    train_method(method, {}, [], Inputs(), 0, tmp_path / "work", tmp_path / "out")
    reason = read_json(tmp_path / "out/failure.json")["reason"]
    assert reason == "RuntimeError: out of luck"
    assert "error: RuntimeError: out of luck" in capsys.readouterr().err


@pytest.mark.parametrize(
    "lines",
    [
        "shutil.rmtree(out)",
        "shutil.rmtree(out); out.mkdir(); (out / 'networks').touch()",
        "shutil.rmtree(out); out.touch()",
        "out.rename(out.with_name('mine')); out.mkdir()",
    ],
)
def test_a_training_may_do_anything_to_its_folder(trained, tmp_path, lines):
    method = trained(
        ("        parts = [", f"        import shutil; {lines}; return\n        parts = [")
    )
    train_method(method, {}, [], Inputs(), 0, tmp_path / "work", tmp_path / "outs/out")
    reason = read_json(tmp_path / "outs/out/failure.json")["reason"]
    assert reason == "the folder that it was given was removed"
    left = {path.name for path in (tmp_path / "outs").iterdir()}
    assert left - {"mine"} == {"out"}


# Lines of `prepare` that break it, and the reason that reaches the entrants.
UNPREPARED = {
    "raises": ('raise KeyError("no colours")', "KeyError: 'no colours' (while preparing scene)"),
    "leaves": ("import os; os._exit(0)", "ended by itself with exit code 0 (while preparing"),
    "hangs": ("import time; time.sleep(600)", "timeout: it took longer than 3 s (while preparing"),
    "no file": ("return", "it wrote no file; write the path that it is given (while preparing"),
    "no memory": ("raise MemoryError", "machine: MemoryError: no message (while preparing scene)"),
}


@pytest.mark.parametrize("kind", UNPREPARED)
def test_what_cannot_be_prepared_fails_the_training_alone(trained, tmp_path, kind):
    line, reason = UNPREPARED[kind]
    signature = "def prepare(self, scene: Scene, inputs: Inputs, out: Path) -> None:\n"
    method = trained((signature, f"{signature}        {line}\n"))
    scene = write_tiny_scene(tmp_path / "scene")
    limit = 3.0 if kind == "hangs" else None
    prepare_scene(method, scene.folder, Inputs(), tmp_path / "prepared.npz", limit)
    told = read_json(tmp_path / "prepared.npz")
    assert told["attempt"] == (3 if kind == "no memory" else 0)
    assert told.get("limit") == limit
    train = (method, {}, [tmp_path / "prepared.npz"], Inputs(), 0, tmp_path / "w", tmp_path / "out")
    train_method(*train)
    failure = read_json(tmp_path / "out/failure.json")
    assert reason in failure["reason"]
    assert failure["attempt"] == 0  # that of the preparation counts


def test_a_file_that_was_prepared_at_last_says_which_attempt_it_was(trained, tmp_path):
    method, out = trained(), tmp_path / "prepared.npz"
    scene = write_tiny_scene(tmp_path / "scene")
    for attempt, written in ((0, None), (3, 2), (2, 2), (0, None)):
        prepare_scene(method, scene.folder, Inputs(), out, attempt=attempt)
        mark = attempt_file(out)
        assert (read_json(mark)["attempt"] if mark.exists() else None) == written


def test_a_training_at_its_limit_goes_on_to_the_same_bytes(trained, tmp_path):
    method = trained(("report)\n", "report)\n        import time; time.sleep(float(Path("
                      f"{str(tmp_path / 'sleep')!r}).read_text()))\n"))  # fmt: skip
    scene = write_tiny_scene(tmp_path / "scene")
    prepared = [tmp_path / "prepared.npz"]
    prepare_scene(method, scene.folder, Inputs(), prepared[0])

    def train(place, sleep, **more):
        (tmp_path / "sleep").write_text(sleep)
        folders = tmp_path / "work" / place, tmp_path / "out" / place
        train_method(method, {"steps": 4}, prepared, Inputs(), 0, *folders, **more)
        return {path.name: path.read_bytes() for path in folders[1].iterdir()}

    whole = train("whole", "0")
    stopped = train("stopped", "600", limit=8.0)
    assert list(stopped) == ["failure.json"]
    told = read_json(tmp_path / "out/stopped/failure.json")
    assert told["reason"] == "timeout: it took longer than 8 s"
    assert (told["limit"], told["stage"], told["attempt"]) == (8.0, "training", 0)
    resumed = train("stopped", "0", limit=600.0, attempt=2)
    assert read_json(tmp_path / "out/stopped/attempt.json") == {"attempt": 2}
    for files in (whole, resumed):
        files.pop("seconds.json")
    resumed.pop("attempt.json")
    assert resumed == whole


@pytest.mark.parametrize("said", ["NaN", "-1", "true", '"3"', "Infinity", "1e30", "null"])
def test_seconds_of_a_training_that_are_none_are_refused(tmp_path, said):
    (tmp_path / "seconds.json").write_text(f'{{"training": 3.5, "prior": {said}}}')
    with pytest.raises(GeoEvsError, match=r"seconds\.json is not whole"):
        trained_seconds(tmp_path)


def test_a_training_that_combines_nothing_says_so(trained, tmp_path):
    method = trained()
    with pytest.raises(GeoEvsError, match=f"^the training of '{method}' has no 'combine'; leave"):
        combine_files(method, [], tmp_path / "combined.npz")


def test_no_adapter_and_no_training_needs_torch_to_be_read():
    modules = [*find_methods().values(), *find_trainings().values()]
    code = "import sys, importlib\nsys.modules['torch'] = None\n" + "".join(
        f"importlib.import_module('{module}')\n" for module in modules
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_method_that_needs_torch_to_be_read_is_told(trained):
    method = trained(("import numpy as np\n", "import numpy as np\nimport torch\n"))
    (first, *_) = check_method(method, {"weights": "nowhere"}, {})
    assert (first.name, first.status) == ("reads without torch", "failed")
    assert first.sentence.startswith("baselines.trial_")
    assert "imports torch when it is read" in first.sentence


def test_prepared_files_do_not_depend_on_the_networks_code():
    """What `prepare` reaches is hashed for it; what `train` alone reaches is not."""
    module = find_trainings()["geo-evs"]
    own = {step: code_hash(f"{module}:Training.{step}") for step in ("prepare", "train")}
    assert own["prepare"] != own["train"]
    with_networks = code_hash(f"{module}:Training.prepare", "geoevs.generator.geo_evs.task")
    assert own["train"] == with_networks == code_hash(module)


def test_inputs_are_what_a_training_declares(tmp_path):
    scene = write_tiny_scene(tmp_path / "scene")
    inputs = trial_inputs(scene, tmp_path)
    for method in ("geo-evs", "freevs"):
        prepare_scene(method, scene.folder, inputs, tmp_path / f"{method}.npz")
        assert (tmp_path / f"{method}.npz").stat().st_size > 1000
    assert training_class("geo-evs").partition == "train"
    assert training_class("freevs").partition == "clips"

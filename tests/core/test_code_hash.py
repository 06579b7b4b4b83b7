import shutil
from pathlib import Path

import pytest

from geoevs.core import code_hash as module
from geoevs.core.code_hash import code_hash
from geoevs.methods.finding import find_methods
from geoevs.scenes.scene import find_sources

FIT = "geoevs.protocol.fit_step"


@pytest.fixture
def copy(tmp_path, monkeypatch):
    """Hashes a copy of the project's code; edits show at once."""
    for package in module.PACKAGES:
        shutil.copytree(module.ROOT / package, tmp_path / package)
    monkeypatch.setattr(module, "ROOT", tmp_path)

    def forget() -> None:
        for part in (module._tree, module._code, module._imports):
            part.cache_clear()

    def fresh(*names: str) -> str:
        forget()
        return code_hash(*names)

    yield tmp_path, fresh
    forget()


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def append(path: Path, text: str) -> None:
    path.write_text(path.read_text(encoding="utf-8") + text, encoding="utf-8")


def test_comments_and_layout_do_not_count(copy):
    root, fresh = copy
    before = fresh(FIT)
    append(root / "geoevs/protocol/fit_step.py", "\n\n# a remark\n")
    remarked = "from pathlib import Path  # a remark\n\n\n"
    edit(root / "geoevs/protocol/fit_step.py", "from pathlib import Path\n", remarked)
    assert fresh(FIT) == before


# What fitting reaches: itself, then through imports ever deeper.
@pytest.mark.parametrize(
    "file",
    [
        "protocol/fit_step",
        "methods/contract",
        "scenes/store",
        "core/files",
        "core/errors",
        "projection/kernels",
    ],
)
def test_code_counts_however_deep_it_is_imported(copy, file):
    root, fresh = copy
    before = fresh(FIT)
    append(root / f"geoevs/{file}.py", "\nADDED = 1\n")
    assert fresh(FIT) != before


@pytest.mark.parametrize(
    "file", ["results/tables", "results/figures", "protocol/metrics", "cli/main", "config/checks"]
)
def test_code_that_is_not_imported_does_not_count(copy, file):
    root, fresh = copy
    before = fresh(FIT)
    append(root / f"geoevs/{file}.py", "\nADDED = 1\n")
    assert fresh(FIT) == before


def test_a_new_path_remakes_nothing(copy):
    root, fresh = copy
    scoring = "geoevs.protocol.scoring"
    before = fresh(scoring)
    append(root / "geoevs/layout.py", '\nADDED = "somewhere/{scene}"\n')
    assert fresh(scoring) == before
    append(root / "geoevs/run.py", "\nADDED = 1\n")
    assert fresh(scoring) != before


def test_only_the_oracles_renders_hang_on_the_answers(copy):
    root, fresh = copy
    steps = ("geoevs.protocol.render_step", "geoevs.protocol.runs")
    before, copied = fresh(*steps), fresh("geoevs.protocol.oracle")
    append(root / "geoevs/run.py", "\nADDED = 1\n")
    assert fresh(*steps) == before
    assert fresh("geoevs.protocol.oracle") != copied


def test_a_method_counts_where_it_is_named(copy):
    root, fresh = copy
    method = find_methods()["reproject-inpaint"]
    alone, both = fresh(FIT), fresh(FIT, method)
    assert alone != both
    # It imports the reprojection control.
    append(root / "baselines/controls/reproject/adapter.py", "\nADDED = 1\n")
    assert fresh(FIT) == alone
    assert fresh(FIT, method) != both


def test_a_method_that_is_not_python_counts_by_its_text(copy):
    root, fresh = copy
    method = find_methods()["reproject-inpaint"]
    append(root / "baselines/controls/reproject_inpaint/adapter.py", "\ndef fit(:\n")
    before = fresh(FIT, method)
    append(root / "baselines/controls/reproject_inpaint/adapter.py", "# a remark\n")
    assert fresh(FIT, method) != before


def test_a_number_counts(copy):
    root, fresh = copy
    before = fresh("geoevs.protocol.metrics")
    edit(root / "geoevs/protocol/metrics.py", "SSIM_SIGMA = 1.5", "SSIM_SIGMA = 1.6")
    assert fresh("geoevs.protocol.metrics") != before


def test_data_beside_a_module_count_with_it(copy):
    root, fresh = copy
    tables, fit = fresh("geoevs.results.tables"), fresh(FIT)
    append(root / "geoevs/results/paper_values.yaml", "\n# a remark\n")
    assert fresh("geoevs.results.tables") != tables
    assert fresh(FIT) == fit


def test_the_order_of_names_does_not_count():
    assert (
        code_hash(FIT, "geoevs.core.files") == code_hash("geoevs.core.files", FIT) == code_hash(FIT)
    )


def test_every_module_of_the_project_can_be_hashed():
    # A relative import would not be followed, so there is none (ruff's TID252 says so).
    names = [*find_methods().values(), *find_sources().values(), "geoevs.results.tables"]
    assert len({code_hash(name) for name in names}) == len(names)

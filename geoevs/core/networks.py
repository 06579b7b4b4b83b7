"""Networks: weights on disk, the device and precision they run in, their first weights."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from safetensors import safe_open
from torch import Tensor, nn

from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.files import whole_file, write_bytes
from geoevs.core.randomness import Rng

COUNTS = ("depth", "layers")
"""What is in the names of settings that count parts of a network, each with weights of its own."""

LARGEST_SETTING = 2**20
"""Largest whole number that a network's settings may hold."""


def save_network(
    path: Path, model: nn.Module, settings: dict[str, Any], dtype: torch.dtype = torch.float32
) -> None:
    """Write a network's weights, and what it was made with, whole or not at all.

    Args:
        path: the .safetensors file.
        model: on any device.
        settings: JSON-able; `read_network` gives it back.
        dtype: what floating-point weights are stored as; float16 halves the file.
    """
    weights = {}
    for name, value in model.state_dict().items():
        value = value.detach().cpu().contiguous()
        weights[name] = value.to(dtype) if value.is_floating_point() else value
    write_bytes(path, safetensors.torch.save(weights, {"settings": json.dumps(settings)}))


def read_network(path: Path) -> tuple[dict[str, Any] | None, dict[str, Tensor]]:
    """Settings (None in files of others) and weights of a .safetensors file, on the CPU.

    Raises:
        GeoEvsError: the file is missing or damaged, or its settings say more than its weights hold.
    """
    with whole_file(path), safe_open(path, "pt") as file:
        weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        settings = json.loads((file.metadata() or {}).get("settings", "null"))
        if not isinstance(settings, dict | None):
            raise ValueError("its settings are no mapping")
        _check_settings(settings, len(weights))
    return settings, weights


def _check_settings(value: Any, parts: int, name: str = "settings") -> None:
    """Refuse numbers that would take minutes or all memory to build what the file cannot hold."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _check_settings(inner, parts, key)
    elif isinstance(value, list):
        if len(value) > LARGEST_SETTING:
            raise ValueError(f"'{name}' has {len(value)} values")
        for inner in value:
            _check_settings(inner, parts, name)
    elif isinstance(value, int | float):
        counts = any(count in name for count in COUNTS)
        if not abs(value) <= (max(parts, 1) if counts else LARGEST_SETTING):
            raise ValueError(f"'{name}' is {value}, and it has {parts} weights")


@contextmanager
def built_as_described(path: Path, advice: str) -> Iterator[None]:
    """Let the block build a network from a file's settings, on the meta device.

    There, random weights are not made in vain.

    Args:
        path: where the settings were read, for errors.
        advice: what to do about a mistake, the end of its sentence.

    Raises:
        GeoEvsError: a setting is missing, unknown or of a wrong kind.
    """
    try:
        with torch.device("meta"):
            yield
    except GeoEvsError:
        raise
    except Exception as error:  # networks check their settings in any way
        raise GeoEvsError(
            f"{path} describes no network of this kind ({reason_of(error)}); {advice}"
        ) from error


def best_device() -> str:
    """The GPU if there is one."""
    return "cuda" if torch.cuda.is_available() else "cpu"


def load_weights(model: nn.Module, weights: dict[str, Tensor], path: Path, advice: str) -> None:
    """Put weights into a network, in float32 and exactly.

    Args:
        model: may lie on the meta device; its parameters are replaced.
        weights: by name.
        path: where they were read, for errors.
        advice: what to do about a mistake, the end of its sentence.

    Raises:
        GeoEvsError: a weight is missing, unknown, of another shape or type, or not finite; the
            first one is named.
    """
    state = model.state_dict()
    for name, value in state.items():
        if name not in weights:
            raise GeoEvsError(f"{path} lacks '{name}'; {advice}")
        if weights[name].shape != value.shape:
            raise GeoEvsError(
                f"{path} has '{name}' of shape {tuple(weights[name].shape)} where this network's "
                f"is {tuple(value.shape)}; {advice}"
            )
        if weights[name].is_floating_point() != value.is_floating_point():
            raise GeoEvsError(
                f"{path} has '{name}' of type {weights[name].dtype} where this network's is "
                f"{value.dtype}; {advice}"
            )
        if not torch.isfinite(weights[name]).all():
            raise GeoEvsError(f"{path} has '{name}' with NaN or infinite weights; {advice}")
    for name in weights:
        if name not in state:
            raise GeoEvsError(f"{path} has '{name}', which this network has not; {advice}")
    # Copied, because kernels round by their operands' alignment, which in a file is any.
    copied = {
        name: value.to(torch.float32 if value.is_floating_point() else value.dtype, copy=True)
        for name, value in weights.items()
    }
    model.load_state_dict(copied, assign=True)


@contextmanager
def seeded(seed: int, *key: str) -> Iterator[None]:
    """Let torch's global generator, which fills new networks, be a function of seed and key."""
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(int(Rng(seed, *key, "weights").numpy.integers(2**62)))
        yield


@contextmanager
def mixed_precision(device: torch.device) -> Iterator[None]:
    """Autocast to bfloat16 where the device computes it faster than float32."""
    fast = device.type == "cuda" or torch.cpu.get_capabilities().get("avx512_bf16", False)
    with torch.autocast(device.type, torch.bfloat16, enabled=fast):
        yield

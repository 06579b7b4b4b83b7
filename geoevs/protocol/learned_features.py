"""Features of EfficientNet-Lite0, computed once a picture: several metrics look at them."""

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import new_folder, read_arrays, write_json
from geoevs.core.mapped import write_mapped

if TYPE_CHECKING:
    from torch import Tensor

RECENT = 64
"""Pictures whose features are in memory, as each metric asks for them: one takes 1 MB."""


@dataclass(frozen=True)
class LearnedFeatures:
    """What the network sees in one picture.

    Args:
        layers: its maps, (1, h, w, C) float16 each (see `geoevs.core.efficientnet`).
        whole: (1280,) float32, the picture as a whole.
    """

    layers: "list[Tensor]"
    whole: np.ndarray


_recent: dict[str, LearnedFeatures] = {}
_folders: list[Path] = []


def learned_features(
    image: np.ndarray,  # [H, W, 3] float32 in [0, 1]
) -> LearnedFeatures:
    """The features of a picture: computed, or read where `kept_features` says that they lie.

    Raises:
        GeoEvsError: this machine has not the network's weights, or a kept file is damaged.
    """
    key = _key(image)
    found = _recent.pop(key, None)
    if found is None:
        kept = (folder / f"{key}.npz" for folder in _folders)
        path = next(filter(Path.exists, kept), None)
        found = _computed(image) if path is None else _read(path)
    _recent[key] = found  # as the latest
    while len(_recent) > RECENT:
        del _recent[next(iter(_recent))]
    return found


def write_features(folder: Path, images: Iterable[np.ndarray]) -> None:
    """Keep the features of pictures, for `kept_features`: a file a picture, copies once.

    `pictures.json` lists them, so that the folder is never empty, which some storages cannot hold.
    """
    with new_folder(folder) as partial:
        for image in images:
            path = partial / f"{_key(image)}.npz"
            if not path.exists():
                found = learned_features(image)
                maps = {f"layer{n}": layer.numpy() for n, layer in enumerate(found.layers)}
                write_mapped(path, {"whole": found.whole, **maps})
        write_json(partial / "pictures.json", sorted(path.stem for path in partial.glob("*.npz")))


@contextmanager
def kept_features(folder: Path) -> Iterator[None]:
    """In the block, features that lie in `folder` are read and not computed."""
    _folders.append(folder)
    try:
        yield
    finally:
        _folders.remove(folder)


def _key(image: np.ndarray) -> str:
    """A name for a picture that no other has."""
    digest = hashlib.sha256(str(image.shape).encode())
    digest.update(np.ascontiguousarray(image, np.float32).data)
    return digest.hexdigest()


def _computed(image: np.ndarray) -> LearnedFeatures:
    import torch

    from geoevs.core.efficientnet import described

    pixels = torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)
    layers, whole = described(pixels[None])
    return LearnedFeatures(layers, whole[0].numpy())


def _read(path: Path) -> LearnedFeatures:
    import torch

    arrays = read_arrays(path)
    whole = arrays.pop("whole", None)
    if whole is None or not arrays:
        raise GeoEvsError(f"{path} holds no features of a picture; delete its folder and rerun")
    return LearnedFeatures([torch.from_numpy(arrays[name]) for name in sorted(arrays)], whole)

"""What methods share whose pictures a trained network samples: weights, options, seed, files."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from geoevs.core.files import read_json, write_json
from geoevs.core.randomness import Rng
from geoevs.methods.trained import link_trained, read_trained
from geoevs.scenes.camera import Camera

if TYPE_CHECKING:
    import torch


@dataclass
class SampledMethod(ABC):
    """Base of such methods; fields named as those of `sampling` are options, None by default.

    Args:
        weights: the folder that a training wrote.
    """

    sampling: ClassVar[type]
    """The dataclass of how pictures are sampled; the training's own is in its settings.json."""
    weights: str
    _generator: Any = field(init=False)
    _sampling: Any = field(init=False)
    _seed: int = field(init=False)

    @abstractmethod
    def _read_generator(self, folder: Path) -> Any:
        """The networks of a training's folder; a subclass knows their class."""

    def _load_trained(self) -> dict[str, Any]:
        """Read the networks, and how they sample: as trained, but for options that are given.

        Returns:
            The settings of their training.

        Raises:
            GeoEvsError: the training failed, or its files are missing or damaged.
        """
        settings = read_trained(Path(self.weights))
        given = {name: value for name, value in self._options().items() if value is not None}
        self._sampling = self.sampling(**settings["sampling"] | given)
        self._generator = self._read_generator(Path(self.weights))
        return settings

    def _draw_seed(self, rng: Rng) -> None:
        """Draw what decides the noise of every view."""
        self._seed = int(rng.numpy.integers(2**31))

    def _noise_of(self, camera: Camera, frame: int) -> "torch.Generator":
        """A view's own noise, whatever was rendered before."""
        return Rng(self._seed, camera.name, str(frame)).torch

    def _parameters(self) -> int:
        """The number of the networks' learned parameters."""
        networks = self._generator.autoencoder, self._generator.denoiser
        return sum(p.numel() for network in networks for p in network.parameters())

    def _save_trained(self, folder: Path) -> None:
        """Link the weights, which many scenes share; write options and seed."""
        link_trained(Path(self.weights), folder / "weights")
        write_json(folder / "options.json", {**self._options(), "seed": self._seed})

    @classmethod
    def _load_saved(cls, folder: Path) -> Self:
        """Read what `_save_trained` wrote."""
        options = read_json(folder / "options.json")
        seed = options.pop("seed")
        method = cls(str(folder / "weights"), **options)
        method._load_trained()
        method._seed = seed
        return method

    def _options(self) -> dict[str, Any]:
        """The options of how pictures are sampled; None takes the training's."""
        return {option.name: getattr(self, option.name) for option in fields(self.sampling)}

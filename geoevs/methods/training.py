"""The training contract: what a method learns before it is fitted to any scene.

A method that trains has one class `Training` in `training.py`, beside its `adapter.py`. Its config
section is `trainings.<method>`; another method may take its weights. Neither file imports torch at
module level: configs are checked without it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.settings import check_settings_class
from geoevs.scenes.store import Scene

PARTITIONS = ("train", "clips")
"""The partitions whose scenes a training may have. A frame may be in both: nothing is scored on
either."""

READS = ("point-maps", "mask-poses", "geometry", "prior")
"""The names of all that a training may read besides scenes; it declares those that it does."""


@dataclass(frozen=True)
class Inputs:
    """Inputs of a training besides its scenes; None or empty where it did not declare them.

    Args:
        point_maps: for `prepare`: the depth of the scene's recorded views (`point-maps`).
        mask_poses: for `prepare`: the config's `conditions.masks`, virtual poses whose validity
            masks degrade conditions (`mask-poses`).
        combined: for `train`: what `combine` made, where a training has that.
        geometry: for `train`: the depth model's name (`geometry`).
        geometry_weights: the depth network's weights, if it is one. They are linked into the
            training's folder as `geometry.safetensors`.
        weights: for `train`: the folder of this suite's pretrained weights (`prior`).
    """

    point_maps: Path | None = None
    mask_poses: Mapping[str, Sequence[float]] | None = None
    combined: Path | None = None
    geometry: str = ""
    geometry_weights: Path | None = None
    weights: Path | None = None


class Training(Protocol):
    """A method's way to learn beforehand; its class is called `Training` and takes no arguments."""

    Settings: ClassVar[type[Any]]
    """A dataclass: the schema and the defaults of the method's section under `trainings`."""
    partition: ClassVar[str]
    """The partition whose scenes it learns from, one of PARTITIONS."""
    reads: ClassVar[tuple[str, ...]]
    """The other things that it reads, of READS (see Inputs). One that starts from a `prior` has a
    setting of that name."""

    def prepare(self, scene: Scene, inputs: Inputs, out: Path) -> None:
        """Write what is learned from one scene to the file `out`, the same for all variants."""
        ...

    def train(
        self,
        settings: Any,
        files: Sequence[Path],
        inputs: Inputs,
        seed: int,
        work: Path,
        out: Path,
    ) -> None:
        """Learn from prepared files, and write what the method needs into the empty folder `out`.

        `geoevs.core.optimising.optimise` is a loop that goes on after a kill to the same bytes,
        stops at the first NaN, and leaves losses.csv and previews in `work`.

        Args:
            settings: a Settings.
            files: what `prepare` wrote, a file a scene, in the config's order.
            inputs: what else it reads.
            seed: decides first weights and every batch.
            work: a folder of its own that outlives a kill.
            out: an empty folder, kept only if this ends well.

        Raises:
            GeoEvsError: it cannot go on; methods that take these weights fail with this sentence.
        """
        ...


@runtime_checkable
class CombinedTraining(Protocol):
    """A training that makes one more file of all prepared ones, such as a mask library."""

    def combine(self, files: Sequence[Path], out: Path) -> None:
        """Write the file `out`; `train` finds it as `inputs.combined`."""
        ...


def check_training_class(kind: type[Any], where: str) -> None:
    """Check that a class keeps the contract, as far as can be told without running it.

    Args:
        kind: the class.
        where: it stands, for errors.

    Raises:
        GeoEvsError: a part is missing, its partition or something it reads does not exist, or a
            setting has no type or default.
    """
    for part in ("Settings", "partition", "reads", "prepare", "train"):
        if not hasattr(kind, part):
            raise GeoEvsError(
                f"{where}: class Training lacks '{part}'; add it (see geoevs/methods/training.py)"
            )
    check_settings_class(kind.Settings, where)
    if kind.partition not in PARTITIONS:
        raise GeoEvsError(
            f"{where}: there is no partition '{kind.partition}' to train on; "
            f"{did_you_mean(str(kind.partition), PARTITIONS)}"
        )
    if not isinstance(kind.reads, tuple):
        raise GeoEvsError(f"{where}: reads is {kind.reads!r}; make it a tuple of {READS}")
    for name in kind.reads:
        if name not in READS:
            hint = did_you_mean(str(name), READS)
            raise GeoEvsError(f"{where}: a training cannot read '{name}'; {hint}")
    if "variants" in {field.name for field in fields(kind.Settings)}:
        raise GeoEvsError(
            f"{where}: 'variants' are trainings by name in every section; rename the setting"
        )
    if "prior" in kind.reads and not isinstance(getattr(kind.Settings(), "prior", None), str):
        raise GeoEvsError(
            f"{where}: it reads a prior, but Settings has no text 'prior' that names it; add it"
        )

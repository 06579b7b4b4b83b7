"""What Geo-EVS trains on, and its settings (paper sections 3.2 to 3.4); networks lie in `task`."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from geoevs.conditions.artifact_masks import (
    join_artifact_masks,
    make_artifact_masks,
    mask_arrays,
    read_artifact_masks,
)
from geoevs.conditions.injection import INJECTIONS
from geoevs.conditions.pairs import make_pairs, pair_arrays, read_pairs
from geoevs.core.files import write_json
from geoevs.core.mapped import write_mapped
from geoevs.core.progress import progress_bar, training_bar
from geoevs.core.settings import Count, OneOf, Positive, Share, check_fields
from geoevs.diffusion.sampling import PREDICTIONS, SCHEDULES, Sampling
from geoevs.geometry.point_maps import PointMaps
from geoevs.methods.training import Inputs
from geoevs.scenes.store import Scene

SAMPLING = Sampling(steps=1, guidance=1.0)
"""Sampling of a short training: one step, at the timestep that it learns. The paper takes 30."""


@dataclass(frozen=True)
class Settings:
    """One training; workflow/scales/paper.yaml has the paper's values.

    Args:
        prior: the weights to start from (see `load_prior`).
        prediction, schedule: of the diffusion process; None keeps the prior's.
        timesteps: the ones to learn, `uniform` (all) or `sampled`, those that `sampling` visits: a
            training for few steps spends nothing on others, and sampling that visits more is then
            refused.
        steps, batch, learning_rate: of the optimiser; AdamW's peak rate (the paper's is 1e-4).
        drop: share of conditions replaced by the null condition.
        encoder: E_geo, `trained` or `frozen`.
        validity: whether the trained encoder sees the validity mask beside X.
        filled: whether it starts from X with its holes filled, or black.
        weighting: per-sample weights w_i, `uniform` (1) or `support`, the condition's support ratio
            over the training pairs' mean.
        masks: kind of artifact injection, and `probability` its p (see `ArtifactInjection`).
        sampling: what renders use unless they ask for another.
    """

    prior: str = "nano"
    prediction: Annotated[str, OneOf(PREDICTIONS)] | None = "sample"
    schedule: Annotated[str, OneOf(SCHEDULES)] | None = None
    timesteps: Annotated[str, OneOf(("uniform", "sampled"))] = "sampled"
    steps: Count = 160
    batch: Count = 16
    learning_rate: Positive = 1.5e-3
    drop: Share = 0.1
    encoder: Annotated[str, OneOf(("trained", "frozen"))] = "trained"
    validity: bool = True
    filled: bool = True
    weighting: Annotated[str, OneOf(("uniform", "support"))] = "uniform"
    masks: Annotated[str, OneOf(INJECTIONS)] = "reprojected"
    probability: Share = 0.4
    sampling: Sampling = SAMPLING

    def __post_init__(self) -> None:
        check_fields("the training of Geo-EVS", self)


class Training:
    """Condition-target pairs and artifact masks of training scenes; one denoiser of all."""

    Settings: ClassVar[type] = Settings
    partition: ClassVar[str] = "train"
    reads: ClassVar[tuple[str, ...]] = ("point-maps", "mask-poses", "geometry", "prior")

    def prepare(self, scene: Scene, inputs: Inputs, out: Path) -> None:
        """Write the pairs of every recorded view, and the masks at virtual poses."""
        maps, frames = PointMaps(inputs.point_maps), len(scene.frames)
        with progress_bar(f"pairs {scene.info.name}", frames) as advance:
            pairs = make_pairs(scene, maps, advance)
        with progress_bar(f"masks {scene.info.name}", frames) as advance:
            masks = make_artifact_masks(scene, maps, inputs.mask_poses, advance)
        write_mapped(out, pair_arrays(pairs) | mask_arrays(masks))

    def combine(self, files: Sequence[Path], out: Path) -> None:
        """Put the masks of all scenes into one artifact-mask library."""
        library = join_artifact_masks([read_artifact_masks(path) for path in files])
        write_mapped(out, mask_arrays(library))

    def train(
        self,
        settings: Settings,
        files: Sequence[Path],
        inputs: Inputs,
        seed: int,
        work: Path,
        out: Path,
    ) -> None:
        """Train the denoiser and its condition encoder."""
        from geoevs.generator.geo_evs.task import train_geo_evs

        pairs, library = read_pairs(files), read_artifact_masks(inputs.combined)
        with training_bar(f"Geo-EVS on {len(pairs)} pairs", settings.steps) as report:
            generator = train_geo_evs(settings, pairs, library, inputs.weights, seed, work, report)
        generator.save(out)
        made_with = {"timesteps": settings.timesteps, "sampling": asdict(settings.sampling)}
        write_json(out / "settings.json", {"geometry": inputs.geometry, **made_with})

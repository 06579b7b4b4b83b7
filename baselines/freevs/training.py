"""What FreeVS trains on, and its settings; networks lie in `task`."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from baselines.freevs.clips import make_clips, read_clips, write_clips
from baselines.freevs.sampling import Sampling
from geoevs.core.files import write_json
from geoevs.core.progress import progress_bar, training_bar
from geoevs.core.settings import AtLeast, Count, Positive, Share, check_fields
from geoevs.methods.training import Inputs
from geoevs.scenes.store import Scene


@dataclass(frozen=True)
class Noise:
    """Normal distribution of the logarithm of the noise's standard deviation in training."""

    mean: float = 1.6
    std: Annotated[float, AtLeast(0)] = 1.0


NOISE = Noise()
SAMPLING = Sampling(steps=1, guidance=1.0, sigma_max=10.0, average=4)


@dataclass(frozen=True)
class Settings:
    """A training of FreeVS; workflow/scales/paper.yaml has the published values.

    Args:
        prior: the weights to start from (see `load_prior`).
        frames: of a clip.
        steps, batch, learning_rate: of the optimiser; a batch is of clips.
        drop: share of clips without their conditions.
        simulated: share of clips shown by points of frames 4 earlier or later.
        noise: in training.
        sampling: what renders use unless they ask for another.
    """

    prior: str = "nano"
    frames: Count = 3
    steps: Count = 160
    batch: Count = 4
    learning_rate: Positive = 1.0e-3
    drop: Share = 0.1
    simulated: Share = 0.5
    noise: Noise = NOISE
    sampling: Sampling = SAMPLING

    def __post_init__(self) -> None:
        check_fields("the training of FreeVS", self)


class Training:
    """Clips of training scenes with their pseudo-images; one denoiser of all."""

    Settings: ClassVar[type] = Settings
    partition: ClassVar[str] = "clips"
    reads: ClassVar[tuple[str, ...]] = ("prior",)

    def prepare(self, scene: Scene, inputs: Inputs, out: Path) -> None:
        """Write every recorded view with its pseudo-images."""
        with progress_bar(f"clips {scene.info.name}", len(scene.cameras)) as advance:
            write_clips(out, make_clips(scene, advance))

    def train(
        self,
        settings: Settings,
        files: Sequence[Path],
        inputs: Inputs,
        seed: int,
        work: Path,
        out: Path,
    ) -> None:
        """Train the denoiser of clips and its encoder."""
        from baselines.freevs.task import train_freevs

        clips = read_clips(files)
        with training_bar(f"FreeVS on {len(clips)} views", settings.steps) as report:
            generator = train_freevs(settings, clips, inputs.weights, seed, work, report)
        generator.save(out)
        write_json(out / "settings.json", {"sampling": asdict(settings.sampling)})

"""FreeVS as commands: what it trains on, and its training."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs.cli.arguments import Out, SceneFolder, Seed, Work, parse_json
from geoevs.cli.generator import failure_written
from geoevs.core.progress import progress_bar, training_bar


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (clips, train_freevs):
        app.command()(command)


def clips(scene: SceneFolder, out: Out) -> None:
    """Make the pseudo-images of every recorded view of a scene."""
    from baselines.freevs.clips import make_clips, write_clips
    from geoevs.scenes.store import Scene

    store = Scene(scene)
    with progress_bar(f"clips {store.info.name}", len(store.cameras)) as advance:
        write_clips(out, make_clips(store, advance))


def train_freevs(
    clips: Annotated[list[Path], typer.Option(help="What `geoevs clips` wrote; repeat for more.")],
    settings: Annotated[str, typer.Option(help="The config's freevs section, as JSON.")],
    weights: Annotated[Path, typer.Option(help="The folder of this suite's pretrained weights.")],
    work: Work,
    out: Out,
    seed: Seed = 0,
) -> None:
    """Train FreeVS on clips of recorded views.

    A failure is written down, not raised: methods that take these weights fail with its reason, and
    the others go on.
    """
    from baselines.freevs.clips import read_clips
    from baselines.freevs.task import TrainingSettings
    from baselines.freevs.task import train_freevs as train
    from geoevs.core.files import new_folder, write_json
    from geoevs.core.optimising import finish, training_seconds
    from geoevs.core.settings import check_options
    from geoevs.methods.trained import seconds_file

    parsed = parse_json("--settings", settings)
    check_options("--settings", TrainingSettings, parsed)
    wanted, data = TrainingSettings(**parsed), read_clips(clips)
    with failure_written(out):
        with training_bar(f"FreeVS on {len(data)} views", wanted.steps) as report:
            generator = train(wanted, data, weights, seed, work, report)
        with new_folder(out) as partial:
            generator.save(partial)
            write_json(seconds_file(partial), {"training": training_seconds(work)})
            write_json(partial / "settings.json", {"sampling": wanted.sampling})
        finish(work)

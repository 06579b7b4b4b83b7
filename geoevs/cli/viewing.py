"""The commands that show what entrants learned: `export-splats` and `view`."""

from typing import Annotated

import typer

from geoevs.cli.arguments import Out, RunOrFolder, run_folder
from geoevs.core.text import printable

SceneOfRun = Annotated[str, typer.Argument(help="The scene, SCENE or DATASET/SCENE.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (export_splats,):
        app.command()(command)


def export_splats(
    run: RunOrFolder,
    scene: SceneOfRun,
    entrant: Annotated[
        str, typer.Argument(help="METHOD or METHOD.VARIANT, with .seedN unless the seed is 0.")
    ],
    out: Out,
) -> None:
    """Write an entrant's Gaussians as .ply and .spz, which viewers open: a pair for each frame.

    What moves is where it is in the frame. The sky is a pair of its own, if the method has one.
    """
    from geoevs.protocol.saved import SavedScene
    from geoevs.protocol.splats import export_splats as write_splats

    for line in write_splats(SavedScene(run_folder(run), scene), entrant, out):
        print(printable(line))

"""The commands that show what entrants learned: `export-splats` and `view`."""

from contextlib import suppress
from typing import Annotated

import typer

from geoevs.cli.arguments import Out, RunOrFolder, run_folder
from geoevs.core.text import printable

SceneOfRun = Annotated[str, typer.Argument(help="The scene, SCENE or DATASET/SCENE.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (view, export_splats):
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


def view(
    run: RunOrFolder,
    scene: SceneOfRun,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Of this machine.")] = 8080,
) -> None:
    """Show entrants side by side at any pose, in a browser, among what was recorded.

    Gaussians follow the camera; others are drawn when it rests. Only this machine can open the
    page. It needs no display: through SSH, forward the port.
    """
    import threading

    from geoevs.protocol.saved import SavedScene
    from geoevs.results.view.page import Page

    saved = SavedScene(run_folder(run), scene)
    with Page(saved, port) as page, suppress(KeyboardInterrupt):
        name = f"{saved.dataset}/{saved.name}"
        print(f"{name} is shown at {page.address} until Ctrl-C is pressed")
        print(f"from elsewhere: ssh -L {port}:127.0.0.1:{port} HOST, then open it", flush=True)
        threading.Event().wait()

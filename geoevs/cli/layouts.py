"""The command that draws layouts: `layout-sheet`."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(layout_sheet)


def layout_sheet(
    scene: Annotated[Path, typer.Option(help="The scene store.")],
    out: Annotated[Path, typer.Option(help="A .png to write.")],
    frame: Annotated[
        int | None, typer.Option(help="Which; the first one if none is named.")
    ] = None,
) -> None:
    """Draw what methods are told of a frame's layout beside what its cameras recorded."""
    from geoevs.conditions.layout_sheet import layout_sheet as draw
    from geoevs.core.images import write_image
    from geoevs.scenes.store import Scene

    store = Scene(scene)
    write_image(out, draw(store, store.frames[0] if frame is None else frame))

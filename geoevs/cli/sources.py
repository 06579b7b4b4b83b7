"""The commands for people who add a data source: `new-source` and `check-source`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from geoevs.cli.arguments import parse_json

MARKS = {"ok": "[green]✓[/] ok", "wrong": "[red]✗[/] wrong", "not checked": "[dim]–[/] not checked"}


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (new_source, check_source):
        app.command()(command)


def new_source(name: Annotated[str, typer.Argument(help="such as my-data")]) -> None:
    """Write a small working data source, for you to change, and its test."""
    from geoevs.source_check.template import new_source as write_source
    from geoevs.source_check.template import sources_root

    root = sources_root()
    console = Console()
    written = write_source(name, root)
    for path in written:
        console.print(f"wrote {escape(str(path.relative_to(root)))}", soft_wrap=True)
    called = written[0].parent.name.replace("_", "-")
    console.print(
        f"\nNow: edit {written[0].relative_to(root)}, run "
        f"[bold]geoevs check-source {called} SCENE --out DIR[/] as you go,\n"
        "look at its pictures, and name the source under `datasets` in a config.",
        soft_wrap=True,
    )


def check_source(
    name: Annotated[str, typer.Argument(help="the data source, such as my-data")],
    scene: Annotated[str, typer.Argument(help="a scene, as a config names it")],
    options: Annotated[str, typer.Option(help="the source's options as JSON")] = "{}",
    height: Annotated[int, typer.Option(min=16, help="pixels of the images")] = 256,
    width: Annotated[int, typer.Option(min=16, help="likewise")] = 384,
    frames: Annotated[int, typer.Option(min=1, help="how many are read at most")] = 12,
    out: Annotated[
        Path | None, typer.Option(help="where pictures of points and boxes on images go")
    ] = None,
) -> None:
    """Check that a data source keeps the conventions of a scene; exit code 1 if it does not.

    Nothing is imported: it works on what is there, and names what it cannot check.
    """
    from geoevs.source_check.check import check_source as check
    from geoevs.source_check.check import write_overlays

    console = Console()
    findings, sample = check(name, scene, parse_json("--options", options), height, width, frames)
    for finding in findings:
        line = f"{MARKS[finding.status]}  {finding.name}: {escape(finding.sentence)}"
        console.print(line, soft_wrap=True, highlight=False)
    if out is not None and sample is not None:
        for path in write_overlays(sample, out):
            console.print(f"wrote {escape(str(path))}", soft_wrap=True, highlight=False)
    if any(finding.status == "wrong" for finding in findings):
        raise typer.Exit(1)

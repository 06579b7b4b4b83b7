"""The commands for people who add a method: `new-adapter` and `check-adapter`."""

from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

from geoevs.cli.arguments import parse_json

if TYPE_CHECKING:
    from geoevs.methods.trial import Check

MARKS = {
    "passed": "[green]✓[/]",
    "failed": "[red]✗[/]",
    "warned": "[yellow]![/]",
    "skipped": "[dim]–[/]",
}


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (new_adapter, check_adapter):
        app.command()(command)


def new_adapter(
    name: Annotated[str, typer.Argument(help="such as my-method")],
    training: Annotated[
        bool, typer.Option("--training", help="one that learns before it is fitted")
    ] = False,
) -> None:
    """Write a small working adapter, for you to change, and its test."""
    from geoevs.methods.finding import methods_root
    from geoevs.methods.template import new_adapter as write_adapter

    root = methods_root()
    console = Console()
    written = write_adapter(name, root, training)
    for path in written:
        console.print(f"wrote {escape(str(path.relative_to(root)))}", soft_wrap=True)
    called = written[0].parent.name.replace("_", "-")
    console.print(
        f"\nNow: edit {written[0].relative_to(root)}, run [bold]geoevs check-adapter {called}[/] "
        f"as you go,\nand add `{called}: {{}}` under `methods` in config.yaml to have it scored.",
        soft_wrap=True,
    )
    if training:
        console.print(
            f"Settings that are not its defaults go to `{called}: {{...}}` under `trainings`.",
            soft_wrap=True,
        )


def check_adapter(
    name: Annotated[str, typer.Argument(help="the method, such as my-method")],
    options: Annotated[str, typer.Option(help="its options as JSON")] = "{}",
    settings: Annotated[
        str, typer.Option(help="its training's settings that are not the defaults, as JSON")
    ] = "{}",
    traceback: Annotated[bool, typer.Option(help="print the method's own tracebacks")] = False,
) -> None:
    """Check on a tiny scene that a method keeps the contract; exit code 1 if it does not.

    A method that trains beforehand is trained first, for a few steps, and fitted with what that
    left. One that takes another method's weights needs the option `weights`.
    """
    from geoevs.conditions.trial import check_method

    given = parse_json("--options", options), parse_json("--settings", settings)
    checks = check_method(name, *given)
    console = Console()
    for check in checks:
        _print_check(console, check, traceback)
    failed = [check for check in checks if check.status == "failed"]
    if any(check.traceback for check in failed) and not traceback:
        console.print("[dim]--traceback prints where it was raised[/]")
    if failed:
        raise typer.Exit(1)


def _print_check(console: Console, check: "Check", traceback: bool) -> None:
    line = f"{MARKS[check.status]} {check.name}"
    if check.sentence:
        line += f": {escape(check.sentence)}"
    console.print(line, soft_wrap=True, highlight=False)
    if traceback and check.traceback:
        console.print(escape(check.traceback), soft_wrap=True, highlight=False)

"""The `geoevs` command."""

import importlib
import io
import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer
from typer.models import CommandInfo

from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.files import write_text
from geoevs.core.text import printable

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Geo-EVS: benchmark extrapolative view synthesis in driving scenes. The whole protocol is "
    "`snakemake --cores 2 tables`; these are its steps, and tools for your own method.",
)
COMMANDS = (
    "stages",
    "geometry",
    "trainings",
    "pretraining",
    "stability",
    "audit",
    "tables",
    "outcomes",
    "adapters",
    "detection",
    "detection_stage",
    "sources",
    "layouts",
    "viewing",
)
FOR_PEOPLE = (
    *("why", "compare", "verify", "grid"),
    *("new-adapter", "check-adapter", "new-source", "check-source"),
    *("view", "export-splats", "export", "export-colmap", "layout-sheet", "let-ap"),
)
"""The commands that people call, as the help lists them; rules call the others."""

_log: Path | None = None


@app.callback()
def options(
    log: Annotated[
        Path | None, typer.Option(help="Also write an error, with its traceback, here.")
    ] = None,
) -> None:
    """Options that come before the command."""
    global _log
    if log is not None:
        write_text(log, "")
    _log = log


def arrange_help(app: typer.Typer) -> None:
    """Divide the commands into two panels, those for people first and in the order above."""

    def place(command: CommandInfo) -> int:
        name = command.callback.__name__.replace("_", "-")
        return FOR_PEOPLE.index(name) if name in FOR_PEOPLE else len(FOR_PEOPLE)

    app.registered_commands.sort(key=place)
    for command in app.registered_commands:
        people = place(command) < len(FOR_PEOPLE)
        command.rich_help_panel = "For people" if people else "For the workflow"


def main() -> None:
    """Run the command line: one sentence for a mistake, a traceback only in the log."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # ∞ in a locale that lacks it ends no command
        sys.stdout.reconfigure(errors="backslashreplace")
    for commands in COMMANDS:
        importlib.import_module(f"geoevs.cli.{commands}").register(app)
    arrange_help(app)
    try:
        app()
    except Exception as error:
        if isinstance(error, GeoEvsError):
            message = f"error: {error}"
        else:
            where = (
                f"see {_log}" if _log else "repeat it as `geoevs --log FILE ...` for the traceback"
            )
            message = f"internal error: {reason_of(error)} ({where})"
        if _log is not None:
            write_text(_log, f"{message}\n\n{traceback.format_exc()}")
        print(printable(message), file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()

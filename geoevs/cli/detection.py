"""3-D detection, as commands."""

from pathlib import Path
from typing import Annotated

import typer

from geoevs.core.text import printable


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command()(let_ap)


def let_ap(
    predictions: Annotated[Path, typer.Argument(help="Waymo's Objects, or rows as .parquet.")],
    truths: Annotated[Path, typer.Argument(help="Likewise, of what was there.")],
    plain: Annotated[
        bool, typer.Option("--plain", help="AP and APH, without tolerance of errors in distance.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="The folder for counts.parquet and the tables.")
    ] = None,
) -> None:
    """Score 3-D boxes by LET-3D-AP, APL and APH, as Waymo's camera-only challenge does.

    Breakdowns, thresholds and cutoffs are those of Waymo's tools. Intervals redraw scenes.
    """
    from geoevs.detection.rules import LET, PLAIN
    from geoevs.detection.scoring import score_files
    from geoevs.results.detection import detection_table, detection_text, write_detection

    counts, remarks = score_files(predictions, truths, PLAIN if plain else LET)
    table = detection_table(counts)
    if out is not None:
        write_detection(out, counts, table, remarks)
    for line in [*detection_text(table).splitlines(), *remarks]:
        print(printable(line))

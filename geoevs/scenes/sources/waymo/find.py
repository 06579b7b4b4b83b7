"""Where the files of a segment lie: it is found by its context name, whatever a file is called."""

import re
from pathlib import Path

from geoevs.core.errors import GeoEvsError
from geoevs.core.text import clean
from geoevs.scenes.sources.waymo import v1, v2
from geoevs.scenes.sources.waymo.segment import Segment

CONTEXT_NAME = re.compile(r"\d+_\d+_\d{3}_\d+_\d{3}")
"""How contexts are named; a file that is called after one is not opened to look for another."""


def segment_files(folder: Path, name: str) -> list[Path]:
    """The files of a segment that are there; the name of one that is missing if none is."""
    records, _ = _record_files(folder, name)
    found = [*records, *v2.table_files(folder, name)]
    return found or [folder / f"segment-{name}_with_camera_labels.tfrecord"]


def open_segment(folder: Path, name: str) -> Segment:
    """Open the segment `name`, of whichever version it is.

    Raises:
        GeoEvsError: it is not there, there twice or in both versions, or damaged.
    """
    if not folder.is_dir():
        raise GeoEvsError(
            f"there is no Waymo folder '{folder}'; set GEOEVS_WAYMO to the folder that holds "
            "*.tfrecord files (v1) or camera_image/ and the other components (v2)"
        )
    records, damaged = _record_files(folder, name)
    tables = v2.table_files(folder, name)
    if records and tables:
        raise GeoEvsError(
            f"segment '{name}' is there in both versions, as {records[0]} and as {tables[0]}; "
            "move one of them elsewhere"
        )
    if len(records) > 1:
        raise GeoEvsError(
            f"segment '{name}' is there twice, as {records[0]} and as {records[1]}; keep one"
        )
    if records:
        return v1.Segment(records[0], name)
    if tables:
        return v2.Segment(folder, name)
    more = f" ({damaged[0]}; {len(damaged)} such files)" if damaged else ""
    raise GeoEvsError(
        f"there is no segment '{name}' in {folder}{more}; set GEOEVS_WAYMO to the folder that "
        "holds it, or name another scene"
    )


def _record_files(folder: Path, name: str) -> tuple[list[Path], list[str]]:
    """The TFRecord files of a segment, and why others could not be looked at."""
    found, damaged = [], []
    for path in sorted(folder.glob("*.tfrecord")):
        called = CONTEXT_NAME.findall(path.name)
        if called and name not in called:
            continue
        try:
            if v1.context_name(path) == name:
                found.append(path)
        except GeoEvsError as error:
            if name in path.name:
                found.append(path)  # opening it says what is wrong with it
            else:
                damaged.append(clean(str(error), 200))
    return found, damaged

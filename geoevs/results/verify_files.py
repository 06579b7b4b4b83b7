"""What a file in a run's folder is by its content, and by its name."""

import json
import struct
import zipfile
from pathlib import Path

import numpy as np

from geoevs.core.locks import LOCK_FILE

HEAD = 512
"""Bytes of a file that say what it is."""

PNG = b"\x89PNG\r\n\x1a\n"

BEGINNINGS = {".png": PNG, ".parquet": b"PAR1", ".npz": b"PK", ".ply": b"ply\n"}
"""How files begin, by the end of their names."""

TEXTS = (".json", ".csv", ".tsv", ".md", ".tex", ".html", ".log", ".txt")
"""Ends of the names of text files."""

NAMES = (".snakemake_timestamp", LOCK_FILE)
"""Other files that a run has, by their names."""


def what_is_wrong(path: Path) -> str:
    """Why a file does not belong in a run, as the end of a sentence; nothing if it does."""
    if not path.is_file():
        return "is neither a file nor a folder"
    if path.name in NAMES:
        return ""
    suffix = path.suffix.lower()
    with path.open("rb") as file:
        head = file.read(HEAD)
    if suffix in BEGINNINGS:
        if not head.startswith(BEGINNINGS[suffix]):
            return f"is no {suffix[1:]} file by its content"
        return _objects_in(path) if suffix == ".npz" else ""
    if suffix == ".safetensors":
        return "" if len(head) > 8 and head[8:9] == b"{" else "is no safetensors file"
    if suffix not in TEXTS:
        return "is of a kind that runs do not have (code, or data that may hold code)"
    if head.startswith((b"#!", b"\x7fELF", b"MZ")) or (b"\0" in head and suffix != ".log"):
        return "is a program, not text"
    return _json_fault(path) if suffix == ".json" else ""


def _json_fault(path: Path) -> str:
    try:
        json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return "is no JSON"
    return ""


def _objects_in(path: Path) -> str:
    """Whether a file of arrays has any that would be unpickled, or that are no arrays."""
    try:
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                with archive.open(name) as member:
                    version = np.lib.format.read_magic(member)
                    read = {
                        (1, 0): np.lib.format.read_array_header_1_0,
                        (2, 0): np.lib.format.read_array_header_2_0,
                    }[version]
                    if read(member)[2].hasobject:
                        return "holds Python objects"
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return "is no file of arrays"
    return ""


def png_size(path: Path) -> tuple[int, int] | None:
    """Height and width that a PNG says it has; None for what is no PNG.

    Nothing is decoded.
    """
    if not path.is_file():
        return None
    with path.open("rb") as file:
        head = file.read(24)
    if len(head) < 24 or not head.startswith(PNG) or head[12:16] != b"IHDR":
        return None
    width, height = struct.unpack(">II", head[16:24])
    return height, width

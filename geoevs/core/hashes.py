"""Hashes of what results are made of."""

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path

from geoevs.core.files import check_file


def text_hash(text: str) -> str:
    """The first 16 hexadecimal digits of a text's SHA-256."""
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:16]


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal.

    Raises:
        GeoEvsError: it is missing, or no regular file.
    """
    with check_file(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hash_path(path: Path) -> str:
    """SHA-256 of a file, or of the list of a folder's files with their own.

    Raises:
        GeoEvsError: there is no such file or folder.
    """
    path = Path(path)
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.is_file())
        listed = [[file.relative_to(path).as_posix(), hash_path(file)] for file in files]
        return hashlib.sha256(json.dumps(listed).encode()).hexdigest()
    return file_hash(path)


def outside_hash(paths: Iterable[Path]) -> str:
    """Hash of where files lie, and of their sizes and times, without reading them.

    Args:
        paths: files or folders; of a folder, all files below it count. What is missing counts as
            such.
    """
    stamps: list[list[str | int | None]] = []
    for path in sorted(_files(paths)):
        try:
            found = path.stat()
            stamps.append([str(path.resolve()), found.st_size, found.st_mtime_ns])
        except OSError:
            stamps.append([str(path), None, None])
    return text_hash(json.dumps(stamps))


def _files(paths: Iterable[Path]) -> Iterable[Path]:
    for path in map(Path, paths):
        if path.is_dir():
            for folder, _, names in os.walk(path):
                yield from (Path(folder) / name for name in names)
        else:
            yield path

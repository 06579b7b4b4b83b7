"""Files that are written whole or not at all, and read whole or refused."""

import glob
import io
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from geoevs.core.errors import GeoEvsError


@contextmanager
def _explain_write_failure(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise GeoEvsError(
            f"cannot write {path} ({reason}); free space there or choose a writable folder "
            "(nothing was changed)"
        ) from error


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path` through a temporary file beside it, so that readers see old or new.

    Raises:
        GeoEvsError: the disk is full or the folder is read-only; an earlier file stays as it was.
    """
    path = Path(path)
    with _explain_write_failure(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise


def link_file(source: Path, path: Path) -> None:
    """Give `source` a second name, or copy it where the file system cannot; whole or not at all.

    Raises:
        GeoEvsError: `source` is missing, the disk is full or the folder is read-only.
    """
    source, path = Path(source), Path(path)
    if not source.is_file():
        raise GeoEvsError(f"{source} is missing; make or copy it there")
    with _explain_write_failure(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            temporary = Path(folder) / path.name
            try:
                os.link(source, temporary)
            except OSError:  # another device, or one without links
                shutil.copyfile(source, temporary)
            os.replace(temporary, path)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole or not at all (see `write_bytes`)."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON, whole or not at all (see `write_bytes`)."""
    write_text(path, json.dumps(value, indent=1) + "\n")


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        GeoEvsError: the file is missing or is not JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise GeoEvsError(f"{path} is missing; make or copy it there") from error
    except ValueError as error:
        raise GeoEvsError(f"{path} is not valid JSON ({error}); restore or remake it") from error


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A temporary folder that becomes `path` when the block ends well, and vanishes when it fails.

    An existing folder at `path` is replaced only then, and stays whole until then.

    Raises:
        GeoEvsError: the disk is full or the place is read-only.
    """
    path = Path(path)
    with _explain_write_failure(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        for abandoned in path.parent.glob(f".{glob.escape(path.name)}~*"):  # by a killed process
            shutil.rmtree(abandoned, ignore_errors=True)
        temporary = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}~"))
    try:
        yield temporary
        with _explain_write_failure(path):
            temporary.chmod(0o755)
            _replace_folder(temporary, path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _replace_folder(new: Path, path: Path) -> None:
    """Move `new` to `path`; a folder there is deleted afterwards, and put back if that fails."""
    if not path.is_dir():
        os.replace(new, path)
        return
    old = new.with_name(f"{new.name}.old")
    os.replace(path, old)
    try:
        os.replace(new, path)
    except BaseException:
        os.replace(old, path)
        raise
    shutil.rmtree(old, ignore_errors=True)


@contextmanager
def whole_file(path: Path) -> Iterator[None]:
    """Name `path` in whatever goes wrong while the block decodes it.

    Broken archives and tables raise anything, so every exception counts.

    Raises:
        GeoEvsError: the file is missing or damaged.
    """
    try:
        yield
    except FileNotFoundError as error:
        raise GeoEvsError(f"{path} is missing; make or copy it there") from error
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise GeoEvsError(f"{path} is not whole ({reason}); delete it and make it again") from error


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays as a compressed .npz, whole or not at all (see `write_bytes`)."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_bytes(path, buffer.getvalue())


def read_arrays(path: Path, prefix: str = "") -> dict[str, np.ndarray]:
    """Read what `write_arrays` wrote: the arrays whose names begin with `prefix`, without it.

    Raises:
        GeoEvsError: the file is missing or damaged.
    """
    with whole_file(path), np.load(path, allow_pickle=False) as file:
        names = [name for name in file.files if name.startswith(prefix)]
        return {name.removeprefix(prefix): file[name] for name in names}


def read_image(path: Path) -> np.ndarray:
    """Read an image file as (H, W, 3) uint8 RGB.

    Raises:
        GeoEvsError: the file is missing, truncated, or no image.
    """
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except FileNotFoundError as error:
        raise GeoEvsError(f"{path} is missing; copy it there or drop its frame") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise GeoEvsError(f"{path} is not a whole image ({error}); download it again") from error


def write_image(path: Path, image: np.ndarray) -> None:
    """Write (H, W, 3) uint8, or float in [0, 1], as PNG, whole or not at all."""
    write_bytes(path, encode_png(image))


def encode_png(image: np.ndarray) -> bytes:
    """(H, W, 3) uint8, or float in [0, 1] (clipped, rounded to nearest), as PNG bytes."""
    buffer = io.BytesIO()
    Image.fromarray(to_uint8(image)).save(buffer, format="png", compress_level=3)
    return buffer.getvalue()


def to_uint8(image: np.ndarray) -> np.ndarray:
    """Float image in [0, 1] to uint8, clipped and rounded to nearest; uint8 passes through."""
    if image.dtype == np.uint8:
        return image
    return np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)


def to_float(image: np.ndarray) -> np.ndarray:
    """uint8 image to float32 in [0, 1]; float images become float32."""
    if image.dtype == np.uint8:
        return image.astype(np.float32) / np.float32(255.0)
    return image.astype(np.float32)

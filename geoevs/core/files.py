"""Files that are written whole or not at all, and read whole or refused."""

import errno
import fcntl
import io
import json
import os
import re
import shutil
import stat
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.text import clean

MAX_JSON_BYTES = 256 * 2**20
"""Most bytes of a JSON file; the largest of a run, a scene's targets, has a thousandth."""

SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
"""How JSON writes half of a letter beyond 16 bits."""

MAX_ARRAY_BYTES = 4 * 2**30
"""Most bytes that the arrays of a file may unpack to; a scene's largest are a hundredth."""

ADVICE = {
    errno.ENOSPC: "free space there",
    errno.EDQUOT: "free space there",
    errno.ENAMETOOLONG: "give it a shorter name",
    errno.ENOTDIR: "move the file that stands where a folder should",
    errno.EEXIST: "move the file that stands where a folder should",
    errno.EISDIR: "move the folder that stands where the file should",
    errno.EIO: "check the disk",
}
"""What to do about an error of the system's; for all others, see `_explain_write_failure`."""


class FolderRemovedError(GeoEvsError):
    """A folder was removed while it was being filled."""


_UMASK = os.umask(0)
os.umask(_UMASK)


@contextmanager
def _explain_write_failure(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        advice = ADVICE.get(error.errno or 0, "choose a writable folder")
        raise GeoEvsError(
            f"cannot write {path} ({reason}); {advice} (nothing was changed)"
        ) from error


def write_files(files: Mapping[Path, bytes]) -> None:
    """Write files that belong together, each through a temporary one beside it.

    All are complete on disk before the first gets its name, so that readers see old or new.

    Raises:
        GeoEvsError: the disk is full or a folder is read-only; earlier files stay as they were.
    """
    with ExitStack() as stack:
        complete = []
        for path, data in files.items():
            path = _real(path)
            with _explain_write_failure(path):
                temporary, handle = stack.enter_context(_temporary_file(path))
                with os.fdopen(os.dup(handle), "wb") as file:
                    file.write(data)
                    file.flush()
                    os.fsync(handle)
                os.chmod(temporary, 0o666 & ~_UMASK)
                complete.append((temporary, path))
        for temporary, path in complete:
            with _explain_write_failure(path):
                os.replace(temporary, path)


def write_bytes(path: Path, data: bytes) -> None:
    """Write one file, whole or not at all (see `write_files`)."""
    write_files({Path(path): data})


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """A temporary file that becomes `path` when the block ends well, and vanishes when it fails.

    Raises:
        GeoEvsError: the disk is full, or the place is read-only.
    """
    path = _real(path)
    with _explain_write_failure(path), _temporary_file(path) as (temporary, handle):
        yield temporary
        os.fsync(handle)
        os.chmod(temporary, 0o666 & ~_UMASK)
        os.replace(temporary, path)


def link_file(source: Path, path: Path) -> None:
    """Give `source` a second name, or copy it where the file system cannot; whole or not at all.

    Raises:
        GeoEvsError: `source` is missing, the disk is full or the folder is read-only.
    """
    source, path = Path(source), _real(path)
    if not source.is_file():
        raise GeoEvsError(f"{source} is missing; make or copy it there")
    with _explain_write_failure(path), _temporary_folder(path) as folder:
        temporary = folder / path.name
        try:
            os.link(source, temporary)
        except OSError:  # another device, or one without links
            shutil.copyfile(source, temporary)
        os.replace(temporary, path)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole or not at all (see `write_files`)."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON, whole or not at all (see `write_files`)."""
    write_text(path, json.dumps(value, indent=1) + "\n")


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A temporary folder that becomes `path` when the block ends well, and vanishes when it fails.

    An existing folder at `path` is replaced only then, and stays whole until then.

    Raises:
        FolderRemovedError: somebody removed the temporary folder meanwhile, so that what it holds
            is not whole.
        GeoEvsError: the disk is full, or the place is read-only.
    """
    path = _real(path)
    with ExitStack() as stack:
        with _explain_write_failure(path):
            temporary = stack.enter_context(_temporary_folder(path))
            made = temporary.stat()
        with _kept(temporary, made, path):
            yield temporary
        with _explain_write_failure(path):
            temporary.chmod(0o777 & ~_UMASK)
            _replace_folder(temporary, path)


@contextmanager
def _kept(folder: Path, made: os.stat_result, path: Path) -> Iterator[None]:
    """Refuse a folder that is another one after the block, whether or not that ended well."""
    failure = None
    try:
        yield
    except (GeoEvsError, OSError) as error:
        failure = error
    if not (folder.exists() and os.path.samestat(folder.stat(), made)):
        raise FolderRemovedError(
            f"the folder that was to become {path} was removed while it was filled; do not clear a "
            "run's folder while it runs, and start it again"
        ) from failure
    if failure is not None:
        raise failure


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


def _real(path: Path) -> Path:
    """Where a path that is a link leads: what is written goes there, and the link stays."""
    path = Path(path)
    return path.resolve() if path.is_symlink() else path


# A temporary file or folder is locked by the process that fills it. A lock ends with its process,
# on every host that shares the disk, so that what can be locked is what a killed one left.


@contextmanager
def _temporary_file(path: Path) -> Iterator[tuple[Path, int]]:
    """A locked new file beside `path`, and its handle; it is gone afterwards, unless renamed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _clear_abandoned(path)
    while True:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}~")
        if _lock(handle, name):
            break
        os.close(handle)
    try:
        yield Path(name), handle
    finally:
        os.close(handle)
        Path(name).unlink(missing_ok=True)


@contextmanager
def _temporary_folder(path: Path) -> Iterator[Path]:
    """A locked new folder beside `path`; it is gone afterwards, unless renamed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _clear_abandoned(path)
    while True:
        name = tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}~")
        with suppress(FileNotFoundError):  # cleared before it could be locked
            handle = os.open(name, os.O_RDONLY)
            if _lock(handle, name):
                break
            os.close(handle)
    try:
        yield Path(name)
    finally:
        os.close(handle)
        shutil.rmtree(name, ignore_errors=True)
        with suppress(OSError):  # what stands there in its place
            os.unlink(name)


def _lock(handle: int, name: str) -> bool:
    """Lock a new file or folder; False if another process took it for abandoned just before."""
    with suppress(OSError):  # file systems without locks: then nothing is ever cleared there
        fcntl.flock(handle, fcntl.LOCK_EX)
    return os.path.exists(name)


def _clear_abandoned(path: Path) -> None:
    """Remove temporary files and folders of `path` that killed processes left."""
    prefix = f".{path.name}~"
    for abandoned in [entry for entry in os.scandir(path.parent) if entry.name.startswith(prefix)]:
        with suppress(OSError):  # it is locked, and so in use, or just gone
            handle = os.open(abandoned.path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if abandoned.is_dir():
                    shutil.rmtree(abandoned.path, ignore_errors=True)
                else:
                    os.unlink(abandoned.path)
            finally:
                os.close(handle)


def check_file(path: Path) -> Path:
    """A path, if it is a regular file: reading a pipe or a device might never end.

    Raises:
        GeoEvsError: it is missing, a folder, a pipe or a device, or cannot be looked at.
    """
    path = Path(path)
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        raise GeoEvsError(f"{path} is missing; make or copy it there") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise GeoEvsError(f"{path} cannot be read ({reason}); correct the path") from error
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
        raise GeoEvsError(f"{path} is {kind}, not a file; put the file there")
    return path


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        GeoEvsError: the file is missing, is not JSON, has a key twice in one object or half a
            letter, or is larger than MAX_JSON_BYTES.
    """
    path = check_file(path)
    if path.stat().st_size > MAX_JSON_BYTES:
        raise GeoEvsError(
            f"{path} has more than {MAX_JSON_BYTES // 2**20} MiB; restore or remake it"
        )
    try:
        text = path.read_bytes().decode("utf-8-sig")
        value = json.loads(text, object_pairs_hook=_object)
        if SURROGATE.search(text):  # half a letter is none, and can be written nowhere
            json.dumps(value, ensure_ascii=False).encode()
        return value
    except OSError as error:
        raise GeoEvsError(f"{path} cannot be read ({error.strerror}); mend its rights") from error
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError among them
        raise GeoEvsError(
            f"{path} is not valid JSON ({clean(str(error))}); restore or remake it"
        ) from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in made if names.count(name) > 1)
        raise ValueError(f"'{twice}' stands there twice")
    return made


@contextmanager
def whole_file(path: Path) -> Iterator[None]:
    """Name `path` in whatever goes wrong while the block decodes it.

    Broken archives and tables raise anything, so every exception counts.

    Raises:
        GeoEvsError: the file is missing, no regular file, or damaged.
    """
    check_file(path)
    try:
        yield
    except GeoEvsError:
        raise
    except Exception as error:
        reason = clean(str(error)) or type(error).__name__
        raise GeoEvsError(f"{path} is not whole ({reason}); delete it and make it again") from error


def encode_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Named arrays as the bytes of a compressed .npz."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays as a compressed .npz, whole or not at all (see `write_files`)."""
    write_bytes(path, encode_arrays(arrays))


def open_arrays(path: Path) -> "np.lib.npyio.NpzFile":
    """What `write_arrays` wrote, its arrays read when asked for; the caller closes it.

    Raises:
        GeoEvsError: the file is missing or damaged, or its arrays unpack to more than
            MAX_ARRAY_BYTES.
    """
    with whole_file(path):
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MAX_ARRAY_BYTES:
            raise GeoEvsError(
                f"{path} unpacks to more than {MAX_ARRAY_BYTES // 2**30} GiB; do not open it, get "
                "the original"
            )
        return np.load(path, allow_pickle=False)


def read_arrays(path: Path, prefix: str = "") -> dict[str, np.ndarray]:
    """Read what `write_arrays` wrote: the arrays whose names begin with `prefix`, without it.

    Raises:
        GeoEvsError: see `open_arrays`.
    """
    with open_arrays(path) as file, whole_file(path):
        names = [name for name in file.files if name.startswith(prefix)]
        return {name.removeprefix(prefix): file[name] for name in names}

"""One run of a folder at a time."""

import fcntl
import os
import socket
from collections.abc import Callable
from pathlib import Path

from geoevs.core.errors import GeoEvsError
from geoevs.core.text import clean

LOCK_FILE = ".lock"


def lock_folder(folder: Path) -> Callable[[], None]:
    """Claim a folder for this process until the lock is released or the process ends.

    A killed process leaves no lock. On file systems without locks nothing is claimed.

    Returns:
        Releases the lock.

    Raises:
        GeoEvsError: another process has it; the sentence names that process.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK_FILE
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = clean(os.read(handle, 200).decode(errors="replace"))
        os.close(handle)
        raise GeoEvsError(
            f"{folder} is being written by {holder or 'another process'}; wait for it or stop it, "
            "or give this run another name (`run:` in the config)"
        ) from None
    except OSError:
        pass
    os.truncate(handle, 0)
    os.write(handle, f"process {os.getpid()} on {socket.gethostname()}".encode())
    return lambda: os.close(handle)

"""Which machine this is, in words that mixed clusters tell apart."""

import platform
import socket
from pathlib import Path

from geoevs.core.text import clean


def machine() -> dict[str, str]:
    """The columns `host` and `cpu` of what is timed here: the host's name and its processor's."""
    return {"host": clean(socket.gethostname()), "cpu": clean(processor())}


def processor(info: Path = Path("/proc/cpuinfo")) -> str:
    """The processor's name; where the system tells none, as on some ARM, its architecture.

    Args:
        info: what Linux says of its processors.

    >>> processor(Path("nowhere")) == (platform.processor() or platform.machine())
    True
    """
    if info.exists():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()

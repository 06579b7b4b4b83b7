"""Timing that sees what a GPU is still doing, and leaves out what numba compiles."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from numba.core.event import TimingListener, install_listener


@dataclass
class Spent:
    """Seconds of a timed block, known when it has ended: its own, and those of compilation."""

    seconds: float = 0.0
    compiling: float = 0.0


@contextmanager
def timed() -> Iterator[Spent]:
    """Time a block, the GPU's work included.

    Kernels that numba compiles count apart: the first fit on a machine is no dearer than the next.
    Those that come from numba's cache are not compiled, and loading them counts as the block's.
    """
    spent = Spent()
    _synchronise()
    # Kernels that a kernel calls are compiled within its own compilation; the listener counts once.
    with install_listener("numba:compile", TimingListener()) as compilation:
        start = time.perf_counter()
        yield spent
        _synchronise()
        elapsed = time.perf_counter() - start
    spent.compiling = compilation.duration if compilation.done else 0.0
    spent.seconds = elapsed - spent.compiling


def _synchronise() -> None:
    """Wait for the GPU, where a method has started one, so that the clock sees its work.

    One that is only there is left alone: starting it takes time that is not the method's.
    """
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_initialized():
        torch.cuda.synchronize()

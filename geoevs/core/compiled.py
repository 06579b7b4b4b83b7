"""Numba kernels whose cache on disk depends on all of the project's code that they are made of."""

import inspect
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import caching

from geoevs.core.code_hash import code_hash

_code_of = cache(code_hash)


def cached_njit(**options: Any) -> Callable[[Callable], Callable]:
    """Compile a function as `numba.njit(cache=True)` does, but never load outdated machine code.

    Numba's cache looks at a function's own file. A kernel has in it what other modules define too,
    constants and the functions that it calls, so here the names of cached files end in the code
    hash of the function's module. Files of other code are removed when a kernel is saved.

    Args:
        options: of `numba.njit`, but for `cache`.

    Returns:
        A decorator, for functions in modules of the project.
    """

    def decorate(function: Callable) -> Callable:
        kernel = numba.njit(**options)(function)
        kernel._cache = _KernelCache(function)  # as its enable_caching() does
        return kernel

    return decorate


class _KernelFiles(caching.CompileResultCacheImpl):
    def __init__(self, function: Callable) -> None:
        self.code = _code_of(function.__module__)
        super().__init__(function)

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        return f"{super().get_filename_base(fullname, abiflags)}.{self.code}"


class _KernelCache(caching.FunctionCache):
    _impl_class = _KernelFiles

    def save_overload(self, sig: Any, data: Any) -> None:
        super().save_overload(sig, data)
        module = Path(inspect.getfile(self._py_func)).stem
        python = f"py{sys.version_info.major}{sys.version_info.minor}"  # others hash otherwise
        for path in Path(self.cache_path).glob(f"{module}.*.{python}*.nb[ic]"):
            if self._impl.code not in path.name:
                with suppress(OSError):  # another process was faster, or holds it open (Windows)
                    path.unlink()

import time

import numba
import pytest

from geoevs.protocol.clock import timed


def triple(x):
    return 3 * x


def test_a_block_takes_its_time():
    start = time.perf_counter()
    with timed() as spent:
        time.sleep(0.05)
    assert 0.05 <= spent.seconds <= time.perf_counter() - start
    assert spent.compiling == 0


def test_compilation_counts_apart_and_once():
    inner = numba.njit(triple)

    @numba.njit
    def kernel(x):
        return inner(x) + 1

    start = time.perf_counter()
    with timed() as spent:
        kernel(2)
        time.sleep(0.05)
    whole = time.perf_counter() - start
    assert spent.compiling > 0
    # Twice, the inner kernel's compilation would leave less than the block slept.
    assert 0.05 <= spent.seconds <= whole - spent.compiling
    with timed() as again:
        kernel(2)
    assert again.compiling == 0


def test_a_kernel_from_the_cache_is_not_compiled(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    numba.njit(triple, cache=True)(2)
    kernel = numba.njit(triple, cache=True)
    with timed() as spent:
        kernel(2)
    assert kernel.stats.cache_hits
    assert spent.compiling == 0
    assert spent.seconds > 0


def test_an_error_is_not_held_back_and_ends_the_listening():
    listeners = numba.core.event._registered["numba:compile"]
    before = len(listeners)
    with pytest.raises(KeyError), timed():
        raise KeyError
    assert len(listeners) == before

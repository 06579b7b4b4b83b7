"""Randomness that is a function of a key: the same on every machine, whatever ran before."""

import hashlib
from functools import cached_property
from typing import Any

import numpy as np


class Rng:
    """The randomness of one job, a pure function of the run's seed and the job's own key."""

    def __init__(self, seed: int, *key: str) -> None:
        digest = hashlib.sha256(repr((seed, *key)).encode()).digest()
        self._entropy = int.from_bytes(digest, "big")

    @cached_property
    def numpy(self) -> np.random.Generator:
        """The job's NumPy generator, made when it is first asked for."""
        return np.random.default_rng(self._entropy)

    @cached_property
    def torch(self) -> Any:
        """The job's `torch.Generator` on the CPU (torch is imported here, not before)."""
        import torch

        return torch.Generator().manual_seed(self._entropy % 2**63)

    @property
    def used(self) -> bool:
        """Whether either generator was asked for; if not, another seed would change nothing."""
        return not vars(self).keys().isdisjoint({"numpy", "torch"})


def keyed_rng(*key: object) -> np.random.Generator:
    """A generator that depends on the whole key and on nothing else."""
    digest = hashlib.sha256("/".join(map(str, key)).encode()).digest()
    return np.random.default_rng(np.frombuffer(digest, np.uint32))

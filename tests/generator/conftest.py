"""Pairs and masks to train tiny networks on."""

import numpy as np
import pytest
import torch

from geoevs.conditions.bits import pack_masks
from geoevs.conditions.masks import MaskLibrary
from geoevs.conditions.pairs import Pairs

HEIGHT, WIDTH = 16, 24


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def pairs(networks):
    """Eight pairs; of pair n, the n first of 16 rows are unknown."""
    target = networks.images(8)
    valid = np.arange(HEIGHT)[:, None] >= np.arange(8)[:, None, None]
    valid = np.broadcast_to(valid, (8, HEIGHT, WIDTH)).copy()
    names = np.array([f"scene-{n // 4}" for n in range(8)]), np.array(["front", "left"] * 4)
    return Pairs(target * valid[..., None], valid, target, *names, np.arange(8) // 2)


@pytest.fixture
def library():
    """Masks that hide the 6, 12 or 18 rightmost of 24 columns."""
    masks = np.arange(WIDTH) < WIDTH - 6 * np.arange(1, 4)[:, None, None]
    masks = np.broadcast_to(masks, (3, HEIGHT, WIDTH))
    labels = {"scene": np.full(3, "s"), "frame": np.arange(3)}
    labels |= {name: np.zeros(3) for name in ("yaw", "lateral")}
    return MaskLibrary(HEIGHT, WIDTH, pack_masks(masks), **labels, support=masks.mean(axis=(1, 2)))

"""Gaussians, footprints, and views of a wall for tests."""

import dataclasses

import cv2
import numpy as np
import pandas as pd
import pytest
import torch

from baselines.gaussians.interface import Footprints
from baselines.gaussians.model import Gaussians
from geoevs.core.images import to_uint8
from geoevs.methods.contract import Views
from geoevs.methods.tiny import tiny_camera
from geoevs.projection import unproject_depth
from geoevs.scenes.scene import TRACK_COLUMNS, Frame, PointCloud, Rig, SceneInfo
from geoevs.scenes.store import Scene, write_scene

WALL = 8.0  # x, metres


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(0)


@pytest.fixture
def make_gaussians():
    """Gaussians that differ in everything, of given opacities and scale."""

    def make(opacities, scale=0.1):
        count = len(opacities)
        draw = torch.Generator().manual_seed(1)
        return Gaussians(
            means=torch.randn(count, 3, generator=draw),
            quats=torch.randn(count, 4, generator=draw),
            log_scales=torch.log(scale * (1 + torch.rand(count, 3, generator=draw))),
            logit_opacities=torch.tensor(opacities).logit(),
            sh0=torch.randn(count, 1, 3, generator=draw),
            sh_rest=torch.randn(count, 3, 3, generator=draw),
        )

    return make


@pytest.fixture
def footprints_of():
    """Footprints that all show, with gradients of given lengths per pixel along x."""

    def make(lengths):
        gradient = torch.tensor(lengths)[:, None] * torch.tensor([1.0, 0.0])
        return Footprints(torch.full((len(lengths),), 3.0), gradient)

    return make


def textured(points):
    """(N, 3) colours of the wall: random every third of a metre, and smooth between."""
    grid = np.random.default_rng(0).uniform(0, 1, (64, 64, 3)).astype(np.float32)
    places = (points[:, 1:] * 3 + 32).astype(np.float32)[None]
    return cv2.remap(grid, places, None, cv2.INTER_CUBIC)[0].clip(0, 1)


def wall_frame(frame, centre, coloured):
    """A view of the wall, and LiDAR points on it, of which every second has no colour."""
    camera = tiny_camera("front", 0.0, np.array(centre, float))
    wall, _ = unproject_depth(np.full((camera.height, camera.width), WALL - centre[0]), camera)
    rgb = textured(wall) if coloured else np.full_like(wall, 0.5)
    image = to_uint8(rgb.reshape(camera.height, camera.width, 3))
    cloud = PointCloud.uncoloured(wall[::8], np.zeros(len(wall[::8])), np.zeros(len(wall[::8])))
    seen = np.where(np.arange(len(cloud)) % 2, 0, -1).astype(np.int8)
    cloud = dataclasses.replace(cloud, rgb=rgb[::8].astype(np.float32), camera=seen)
    return Frame(frame, 0.1 * frame, {"front": camera}, {"front": image}, cloud)


@pytest.fixture(scope="session")
def views_of_wall(tmp_path_factory):
    """Views of a wall at x = 8 from given places, with texture or without."""

    def make(centres, coloured=True, needs=("sfm",)):
        info = SceneInfo("wall", "test", "CC0-1.0", Rig(*["front"] * 3, "beam"), ("front",))
        frames = (wall_frame(n, centre, coloured) for n, centre in enumerate(centres))
        folder = tmp_path_factory.mktemp("wall")
        write_scene(folder, info, pd.DataFrame(columns=list(TRACK_COLUMNS)), frames)
        return Views(Scene(folder), ("front",), needs)

    return make

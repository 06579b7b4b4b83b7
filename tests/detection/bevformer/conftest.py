"""Small rigs and detectors."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from geoevs.core.networks import seeded
from geoevs.detection.bevformer.backbone import Backbone
from geoevs.detection.bevformer.inputs import RigFrame
from geoevs.detection.bevformer.network import new_bevformer
from geoevs.detection.bevformer.settings import Detector

SIZE = 16, 24
BOUNDS = (-4.0, -12.0, -0.4, 20.0, 12.0, 2.6)
CLASSES = ("vehicle", "pedestrian")


def projection(yaw, size=SIZE, place=(1.0, 0.0, 2.0)):
    """A level camera of 90 degrees across, turned to the left by `yaw` degrees."""
    cos, sin = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    rotation = np.array([[sin, -cos, 0], [0, 0, -1], [cos, sin, 0]])  # right, down, ahead
    K = np.array([[size[1] / 2, 0, size[1] / 2], [0, size[1] / 2, size[0] / 2], [0, 0, 1]])
    return K @ np.concatenate([rotation, -rotation @ np.array(place)[:, None]], axis=1)


@pytest.fixture(scope="session")
def make_frame():
    def make(views=5, scene="street", frame=0, x=0.0, turned=0.0, seed=0, **values):
        random = np.random.default_rng((seed, frame, views))
        pose = np.eye(4)
        cos, sin = np.cos(turned), np.sin(turned)
        pose[:2] = [[cos, -sin, 0, x], [sin, cos, 0, 0]]
        yaws = np.linspace(90, -90, views)
        given = {
            "scene": scene,
            "frame": frame,
            "seconds": 0.5 * frame,
            "images": random.random((views, *SIZE, 3), np.float32),
            "image_from_vehicle": np.stack([projection(yaw) for yaw in yaws]),
            "recorded": np.arange(views) < 5,
            "world_from_vehicle": pose,
            "boxes": np.array([[8, 1, 0.8, 4.2, 1.8, 1.5, 0.3], [5, -4, 0.9, 0.6, 0.6, 1.7, 2.0]]),
            "classes": np.array([0, 1]),
        }
        return RigFrame(**{**given, **values})

    return make


@pytest.fixture(scope="session")
def detector():
    return Detector(
        image=SIZE, channels=8, range=BOUNDS, grid=(6, 5), points=4, heights=2, queries=6
    )


@pytest.fixture(scope="session")
def make_model(detector):
    """A new detector whose attentions look elsewhere than at first, so that all of it counts."""

    def make(**values):
        changed = replace(detector, **values)
        with seeded(0, "backbone"):
            backbone = Backbone("cnn", changed.channels)
        model = new_bevformer(changed, CLASSES, backbone, 0)
        with seeded(0, "elsewhere"), torch.no_grad():
            for weight in model.parameters():
                weight += 0.05 * torch.randn_like(weight)
        return model.eval()

    return make

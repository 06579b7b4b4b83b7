import math

import cv2
import numpy as np
import pytest
from scipy.linalg import sqrtm

from geoevs.methods.tiny import write_tiny_scene
from geoevs.protocol.harm import HARMS, distances, harmed
from geoevs.protocol.metrics import GMS
from geoevs.protocol.set_metrics import (
    SET_METRICS,
    energy_distance,
    frechet_distance,
    kernel_distance,
    real_floor,
)
from geoevs.protocol.weights import missing_efficientnet

TEXTURE = SET_METRICS["texture_energy"]


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Views of the tiny scene, with texture that harm can be done to; (H, W, 3) in [0, 1]."""
    scene = write_tiny_scene(tmp_path_factory.mktemp("photos") / "scene")
    rng = np.random.default_rng(0)
    grain = cv2.GaussianBlur(rng.standard_normal((48, 72, 3)).astype(np.float32), (0, 0), 1.0)
    images = [scene.image(name, frame) for frame in scene.frames for name in scene.cameras]
    return [np.clip(image + 0.5 * grain, 0, 1) for image in images]


LEARNED = ("efficientnet_fd", "efficientnet_kd", "efficientnet_layers")


@pytest.mark.parametrize("harm", HARMS)
def test_distances_get_worse_with_every_grade_of_harm(photos, harm):
    frames = np.arange(len(photos)) // 3
    similarities, found = [1.0], [distances(photos, photos, frames)]
    for grade in HARMS[harm][1]:
        pictures = harmed(photos, harm, grade, 0)
        metric = GMS()
        for preds, target in zip(pictures, photos, strict=True):
            metric.update(preds, target, np.ones(target.shape[:2], bool))
        similarities.append(metric.compute())
        found.append(distances(pictures, photos, frames))
    assert (np.diff(similarities) < 0).all()
    assert {"texture_energy", *(() if missing_efficientnet() else LEARNED)} <= found[0].keys()
    for name, value in found[0].items():
        assert value == pytest.approx(0.0, abs=1e-9), name
        assert (np.diff([distance[name] for distance in found]) > 0).all(), name


def test_frechet_distance_equals_the_matrix_square_root():
    x, y = np.random.default_rng(0).standard_normal((2, 40, 5))
    y = 2 * y + 1
    a, b = np.cov(x.T), np.cov(y.T)
    mean = np.square(x.mean(0) - y.mean(0)).sum()
    expected = mean + np.trace(a + b - 2 * sqrtm(a @ b).real)
    assert frechet_distance(x, y).value == pytest.approx(expected, abs=1e-8)
    assert frechet_distance(x, x).value == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("distance", [kernel_distance, energy_distance])
def test_the_estimate_is_the_u_statistic_by_hand(distance):
    x, y = np.random.default_rng(0).standard_normal((2, 5, 3))

    def kernel(a, b):
        if distance is kernel_distance:
            return (a @ b / 3 + 1) ** 3
        return -np.linalg.norm(a - b) / math.sqrt(3)

    pairs = [(i, j) for i in range(5) for j in range(5) if i != j]
    expected = np.mean(
        [
            kernel(x[i], x[j]) + kernel(y[i], y[j]) - kernel(x[i], y[j]) - kernel(x[j], y[i])
            for i, j in pairs
        ]
    )
    assert distance(x, y, np.arange(5), 0.9).value == pytest.approx(expected)
    assert distance(x, x, np.arange(5), 0.9).value == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("distance", [kernel_distance, energy_distance])
def test_blocks_of_views_give_what_all_at_once_do(distance, monkeypatch):
    x, y = np.random.default_rng(0).standard_normal((2, 50, 3))
    frames = np.arange(50) // 4
    at_once = distance(x, y, frames, 0.9)
    monkeypatch.setattr("geoevs.protocol.set_metrics.MOST_PAIRS", 7 * 50)
    in_blocks = distance(x, y, frames, 0.9)
    for end in ("value", "low", "high"):
        assert getattr(in_blocks, end) == pytest.approx(getattr(at_once, end), rel=1e-9)
    assert distance(x, x, frames, 0.9).value == pytest.approx(0.0, abs=1e-12)


def test_the_estimate_is_unbiased_and_its_interval_covers():
    rng = np.random.default_rng(0)
    frames = np.arange(24) // 2
    estimates = [
        kernel_distance(*rng.standard_normal((2, 24, 4)), frames, 0.95) for _ in range(300)
    ]
    values = np.array([estimate.value for estimate in estimates])
    # Two samples of one distribution: zero on average, though each is off.
    assert abs(values.mean()) < 3 * values.std() / math.sqrt(300)
    assert (values < 0).any()
    covered = [estimate.low <= 0 <= estimate.high for estimate in estimates]
    assert np.mean(covered) > 0.85


def test_leaving_out_a_frame_is_leaving_out_its_views():
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((2, 7, 3))
    frames = np.array([0, 0, 1, 2, 2, 2, 3])
    found = energy_distance(x, y, frames, 0.95)
    kept = [frames != out for out in range(4)]
    without = np.array([energy_distance(x[k], y[k], frames[k], 0.95).value for k in kept])
    spread = math.sqrt(3 * np.mean((without - without.mean()) ** 2))
    assert found.high - found.value == pytest.approx(1.959964 * spread, rel=1e-6)
    assert found.value - found.low == pytest.approx(1.959964 * spread, rel=1e-6)


def test_the_floor_compares_alternate_frames():
    frames = np.repeat(["a", "b", "c", "d"], 2)
    same = np.tile(np.arange(2.0)[:, None], (4, 3))
    assert real_floor(TEXTURE, same, frames) == pytest.approx(0.0)
    other = same + 5 * np.repeat([0, 1, 0, 1], 2)[:, None]
    assert real_floor(TEXTURE, other, frames) > 1
    assert math.isnan(real_floor(TEXTURE, same, np.repeat("a", 8)))


def test_one_view_has_no_distance():
    one = np.zeros((1, 3))
    assert math.isnan(energy_distance(one, one, np.zeros(1), 0.95).value)
    assert math.isnan(frechet_distance(one, one).value)

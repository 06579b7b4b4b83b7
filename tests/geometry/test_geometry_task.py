"""What one step of VGGT's training sees."""

import dataclasses

import numpy as np
import pytest
import torch

from geoevs.core.files import write_arrays
from geoevs.core.randomness import Rng
from geoevs.geometry.finetuning import (
    BRIGHTEST,
    DARKEST,
    FAR,
    VIEWS,
    DepthFrames,
    GeometryTask,
    read_depth_frames,
)
from geoevs.geometry.vggt import VGGT_NANO, DepthPrediction
from geoevs.methods.tiny import tiny_truth, write_tiny_scene
from geoevs.projection import zbuffer


class Watcher(torch.nn.Module):
    """Predicts one depth everywhere, and keeps what it was shown."""

    def __init__(self, depth=10.0):
        super().__init__()
        self.depth = torch.nn.Parameter(torch.tensor(depth))
        self.seen = []

    def forward(self, images):
        self.seen.append(images)
        depth = self.depth.expand(*images.shape[:2], *images.shape[3:])
        return DepthPrediction(depth, torch.ones_like(depth))


@pytest.fixture
def frames():
    """Five frames of four views whose depth is a tenth of their red; view and frame are in blue."""
    rng = np.random.default_rng(0)
    images = rng.integers(40, 180, (5, 4, 8, 12, 3)).astype(np.uint8)
    images[..., 2] = 10 * np.arange(5)[:, None, None, None] + np.arange(4)[:, None, None]
    names = [f"scene/{frame}" for frame in range(5)]
    return DepthFrames(images, (images[..., 0] / 10).astype(np.float16), names)


def losses(frames, step, batch=2, depth=10.0):
    watcher = Watcher(depth)
    task = GeometryTask(watcher, frames, batch)
    found = task.losses(Rng(0, str(step)))
    return task, watcher.seen[0], found


def test_images_and_depths_are_mirrored_and_dimmed_together(frames, monkeypatch):
    known = []
    monkeypatch.setattr(
        "geoevs.geometry.finetuning.depth_loss",
        lambda prediction, depth: known.append(depth) or prediction.depth.mean(),
    )
    mirrored, exposures = 0, set()
    for step in range(12):
        task, seen, _ = losses(frames, step)
        assert seen.shape == (2, VIEWS, 3, 8, 12)
        red = seen[:, :, 0] / known[-1]
        exposure = red.mean().item() / (10 / 255)
        assert DARKEST <= exposure <= BRIGHTEST
        # Wherever a pixel has gone, its depth has gone with it.
        torch.testing.assert_close(red, red.mean().expand_as(red), atol=1e-4, rtol=0.01)
        exposures.add(round(exposure, 3))
        blue = np.rint(seen[:, :, 2].numpy() * 255 / exposure)
        number, view = divmod(blue[:, :, 0, 0], 10)
        assert task.batch(Rng(0, str(step))) == [f"scene/{n:.0f}" for n in number[:, 0]]
        assert all(len(set(views)) == VIEWS for views in view)
        plain = frames.images[int(number[0, 0]), int(view[0, 0]), ..., 0] / 255 * exposure
        same, flipped = (
            np.abs(seen[0, 0, 0].numpy() - side).max() < 0.01 for side in (plain, plain[:, ::-1])
        )
        assert same != flipped
        mirrored += flipped
    assert 0 < mirrored < 12
    assert len(exposures) == 12


def test_the_relative_error_is_of_known_pixels(frames):
    known = np.where(frames.depths > 10, np.float16(8), np.float16(0))
    known = dataclasses.replace(frames, depths=known)
    _, _, found = losses(known, 0)
    assert found["relative_error"].item() == pytest.approx(0.25)


def test_views_without_a_known_pixel_stop_nothing(frames):
    unknown = dataclasses.replace(frames, depths=np.zeros_like(frames.depths))
    _, _, found = losses(unknown, 0)
    assert {name: value.item() for name, value in found.items()} == {
        "loss": 0.0,
        "relative_error": 0.0,
    }


def test_data_and_batch_are_the_trainings_identity(frames):
    other = dataclasses.replace(frames, depths=frames.depths * np.float16(2))
    tasks = [(frames, 2), (frames, 3), (other, 2)]
    found = {GeometryTask(Watcher(), data, batch).identity for data, batch in tasks}
    assert len(found) == 3
    assert GeometryTask(Watcher(5.0), frames, 2).identity in found


def test_previews_show_images_known_and_predicted(frames):
    task = GeometryTask(Watcher(16.0), frames, 2)
    picture = task.preview(task.model)
    assert picture.shape == (3 * 8, 4 * 12, 3)
    np.testing.assert_allclose(picture[:8, 12:24], frames.images[2, 1] / 255, atol=1e-6)
    np.testing.assert_allclose(picture[16:], 0.25)  # four metres are white


def test_skies_are_far_and_lidar_stands_in_for_truth(tmp_path):
    scene = write_tiny_scene(tmp_path / "scene")
    depths = {n: tiny_truth(scene.camera(n, 0)).depth for n in scene.cameras}
    depths["left"][:10] = 0  # sky
    depths["left"][10:20] = 1e4
    write_arrays(tmp_path / "depths/000000.npz", depths)
    read = read_depth_frames([scene.folder], [tmp_path / "depths"], VGGT_NANO)
    assert read.names == [f"{scene.info.name}/0", f"{scene.info.name}/1"]
    found = read.depths
    left = scene.cameras.index("left")
    assert (found[0, left, :20] == FAR).all()
    np.testing.assert_allclose(found[0, left, 20:], depths["left"][20:], rtol=1e-3)
    sparse = zbuffer(scene.points(1).xyz, scene.camera("left", 1), visibility="footprint").depth
    np.testing.assert_allclose(found[1, left], sparse, rtol=1e-3)
    assert 0.01 < (found[1, left] > 0).mean() < 0.9

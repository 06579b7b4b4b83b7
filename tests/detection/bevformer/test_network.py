"""The whole detector: any number of cameras, each item's own, and what it remembers."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import read_network, save_network
from geoevs.detection.bevformer.encoder import Grid
from geoevs.detection.bevformer.network import Memory, load_bevformer, save_bevformer
from geoevs.detection.bevformer.settings import Detector


@pytest.fixture(scope="module")
def model(make_model):
    return make_model()


@pytest.fixture(autouse=True)
def _inference():
    with torch.inference_mode():
        yield


def test_any_number_of_cameras_goes_through_one_set_of_weights(model, make_frame):
    for views in (1, 5, 6, 45):
        found, heat = model([make_frame(views)], [None])
        assert found.logits.shape == (2, 1, 6, 2)
        assert found.codes.shape == (2, 1, 6, 8)
        assert heat.shape == (1, 2, 5, 6)
        assert all(torch.isfinite(part).all() for part in (*found, heat))


def test_the_order_of_cameras_changes_nothing(model, make_frame):
    frame = make_frame(45)
    order = np.random.default_rng(1).permutation(45)
    shuffled = replace(
        frame,
        images=frame.images[order],
        image_from_vehicle=frame.image_from_vehicle[order],
        recorded=frame.recorded[order],
    )
    one, other = (model.bev([each], [None]) for each in (frame, shuffled))
    torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-5)


def test_every_view_has_a_say(model, make_frame):
    frame = make_frame(6)
    before = model.bev([frame], [None])
    for view in range(6):
        images = frame.images.copy()
        images[view] = 1 - images[view]
        assert (model.bev([replace(frame, images=images)], [None]) - before).abs().max() > 1e-4
    generated = replace(frame, recorded=~frame.recorded)
    assert (model.bev([generated], [None]) - before).abs().max() > 1e-4


def test_items_of_a_batch_have_their_own_cameras_and_pasts(model, make_frame):
    frames = [make_frame(5, frame=1, x=2.0), make_frame(7, frame=3, turned=0.2), make_frame(2)]
    memories = [model.remember([make_frame(5)]), model.remember([make_frame(6, frame=2)]), None]
    together, heat = model(frames, memories)
    for item, (frame, memory) in enumerate(zip(frames, memories, strict=True)):
        alone, warm = model([frame], [memory])
        for whole, part in ((together.logits, alone.logits), (together.codes, alone.codes)):
            torch.testing.assert_close(whole[:, item], part[:, 0], atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(heat[item], warm[0], atol=1e-4, rtol=1e-4)


def test_cells_that_no_camera_sees_are_finite(model, make_frame):
    upwards = make_frame(1)
    projection = upwards.image_from_vehicle[0].copy()
    projection[2, 3] -= 1e3  # all lies behind it
    blind = replace(upwards, image_from_vehicle=projection[None])
    assert not model.views([blind]).visible.any()
    assert torch.isfinite(model([blind], [None])[0].codes).all()


def test_places_in_pictures_are_those_of_the_projection(detector, make_frame):
    grid, frame = Grid(detector), make_frame()
    places, visible = grid.project(torch.from_numpy(frame.image_from_vehicle), frame.size)
    assert places.shape == (5, 30, 2, 2)
    # Row 2 of 5 has y = 0; column 3 of 6 has x = 10; of heights -0.4 .. 2.6 the middles.
    cell, view = 2 * 6 + 3, 2  # the view that looks ahead, from (1, 0, 2)
    for level, z in enumerate((0.35, 1.85)):
        assert grid.pillars[cell, level] == pytest.approx([10, 0, z])
        u, v = 12.0, 8 + 12 * (2 - z) / 9
        assert places[view, cell, level].tolist() == pytest.approx([u / 24, v / 16])
        assert visible[view, cell, level]
    assert not visible[view, 2 * 6].any()  # x = -2 lies behind the camera


def test_a_moved_vehicle_finds_places_where_they_were(detector, make_frame):
    grid = Grid(detector)
    before, now = make_frame(x=1.0, turned=0.4), make_frame(frame=1, x=3.0, turned=-0.3)
    move = np.linalg.inv(before.world_from_vehicle) @ now.world_from_vehicle
    affine, motion = grid.from_here(move)
    here = np.array([6.0, -3.0])  # metres
    world = now.world_from_vehicle @ [*here, 0, 1]
    there = (np.linalg.inv(before.world_from_vehicle) @ world)[:2]
    low, extent = grid.low[:2], grid.extent[:2]
    got = affine[:, :2] @ ((here - low) / extent) + affine[:, 2]
    np.testing.assert_allclose(got, (there - low) / extent)
    np.testing.assert_allclose(motion, [*move[:2, 3], -0.7])


def test_what_is_remembered_counts(model, make_frame):
    now = make_frame(frame=1, x=2.0)
    past = model.remember([make_frame()])
    alone, after = model.bev([now], [None]), model.bev([now], [past])
    assert (after - alone).abs().max() > 1e-3
    elsewhere = Memory(make_frame(x=-3.0), past.bev)
    assert (model.bev([now], [elsewhere]) - after).abs().max() > 1e-4
    assert model.remember([]) is None


def test_grey_pictures_work(model, make_frame):
    frame = make_frame()
    grey = replace(frame, images=np.full_like(frame.images, 0.5))
    found, heat = model([grey], [None])
    assert all(torch.isfinite(part).all() for part in (*found, heat))


def test_pictures_of_any_size_are_resized(model, make_frame):
    frame = make_frame()
    large = frame.resized((32, 48))
    views = model.views([large])
    np.testing.assert_allclose(views.places, model.views([frame]).places, atol=1e-6)
    assert views.features.shape == (5, 8, 2, 3)


def test_a_detector_is_the_same_from_its_file(model, make_frame, tmp_path):
    path = tmp_path / "detector.safetensors"
    save_bevformer(path, model)
    loaded = load_bevformer(path)
    assert loaded.detector == model.detector
    assert loaded.classes == model.classes
    for name, value in model.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value)
    frame, past = make_frame(frame=1), model.remember([make_frame()])
    for one, other in zip(model([frame], [past])[0], loaded([frame], [past])[0], strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-5)  # memory is aligned otherwise


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda settings: settings.pop("classes"), "holds no detector; train the detector again"),
        (lambda settings: settings["backbone"].update(kind="resnet"), "holds no backbone"),
        (lambda settings: settings["detector"].update(colour=1), "its detector has no option"),
        (lambda settings: settings["detector"].update(queries=7), "has 'decoder.content' of shape"),
        (lambda settings: settings["detector"].update(decoder=9), "lacks 'decoder.layers.2"),
    ],
)
def test_files_of_other_networks_are_refused(model, tmp_path, change, sentence):
    path = tmp_path / "detector.safetensors"
    save_bevformer(path, model)
    settings, _ = read_network(path)
    change(settings)
    save_network(path, model, settings)
    with pytest.raises(GeoEvsError, match=sentence):
        load_bevformer(path)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"image": [60, 96]}, "60 x 96 does not divide into features; choose multiples of 8"),
        ({"channels": 12}, "cannot have 12 channels; choose a multiple of 8"),
        ({"points": 6}, "6 points do not divide among 4 heights"),
        ({"range": (0, 0, 0, 0, 1, 1)}, "is empty; write x, y and z from, then x, y and z to"),
        ({"backbone": "resnet"}, "backbone"),
    ],
)
def test_settings_that_fit_no_detector_are_refused(values, sentence):
    with pytest.raises(GeoEvsError, match=sentence):
        Detector(**values)

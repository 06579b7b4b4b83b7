"""The method as the protocol meets it: the contract, budgets, bad input, and emerged motion."""

import time

import numpy as np
import pandas as pd
import pytest

from baselines.emernerf.adapter import STEPS_AN_IMAGE
from geoevs.core.errors import GeoEvsError
from geoevs.core.randomness import Rng
from geoevs.methods import tiny as room
from geoevs.methods.check import contract_failures
from geoevs.methods.contract import Budget, Views
from geoevs.methods.finding import make_method
from geoevs.projection import colour_points, unproject_depth
from geoevs.scenes.scene import TRACK_COLUMNS, Frame, PointCloud, Rig, SceneInfo
from geoevs.scenes.store import Scene, write_scene

SMALL = {
    "iterations": 4,
    "rays": 64,
    "levels": 4,
    "log2_entries": 8,
    "width": 8,
    "samples": (8, 4, 4),
}
INFO = SceneInfo("moving", "tiny", "CC0-1.0", Rig("front", "left", "right", "beam"), ("front",))
FRAMES, STEP = 4, np.array([0.0, -1.2, 0.0])  # metres the car drives to the right each frame
CAR = room.CAR


def car_at(frame):
    return CAR + frame * STEP


def moving_frames(monkeypatch, lidar=True):
    """The tiny room seen from a standing camera, its car driving by."""
    for frame in range(FRAMES):
        monkeypatch.setattr(room, "CAR", car_at(frame))
        camera = room.tiny_camera("front", 0.0, room.MOUNT)
        truth = room.tiny_truth(camera)
        cameras, images = {"front": camera}, {"front": truth.rgb}
        xyz = unproject_depth(truth.depth, camera)[0][:: 3 if lidar else 10**9]
        xyz = xyz if lidar else xyz[:0]
        points = PointCloud.uncoloured(xyz, np.zeros(len(xyz)), np.zeros(len(xyz)))
        yield Frame(frame, 0.1 * frame, cameras, images, colour_points(points, cameras, images))


def tracks(moving=True, frames=FRAMES):
    rows = []
    for frame in range(frames):
        car = car_at(frame)
        box = (*car.mean(axis=0), *(car[1] - car[0]), 0.0)
        rows.append((frame, "car-0", "car", *box, moving))
    return pd.DataFrame(rows, columns=list(TRACK_COLUMNS)).astype({"moving": bool})


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving") / "scene"
    with pytest.MonkeyPatch.context() as monkeypatch:
        write_scene(folder, INFO, tracks(), moving_frames(monkeypatch))
    return Scene(folder)


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    return room.write_tiny_scene(tmp_path_factory.mktemp("still") / "scene")


def fit(scene, budget=None, **options):
    method = make_method("emernerf", {**SMALL, **options})
    views = Views(scene, scene.cameras, method.info.needs)
    return method, method.fit(views, budget or Budget(), Rng(0))


def test_contract():
    assert contract_failures("emernerf", **SMALL) == []


def test_a_static_scene_gets_no_dynamic_field_and_says_so(still, moving):
    method, report = fit(still)
    assert report.note == "static scene: no dynamic field"
    assert not method.motion(still.camera("front", 0), 0)[0].any()
    _, larger = fit(moving)
    assert larger.note == ""
    assert larger.parameters > report.parameters


def test_a_moving_scene_is_the_same_after_reload(moving, tmp_path):
    method, _ = fit(moving)
    method.save(tmp_path)
    again = type(method).load(tmp_path)
    camera = room.tiny_camera("virtual", 20.0, room.MOUNT)
    one, other = method.render(camera, 2), again.render(camera, 2)
    np.testing.assert_array_equal(one.rgb, other.rgb)
    np.testing.assert_array_equal(one.depth, other.depth)
    assert not np.array_equal(one.rgb, method.render(camera, 0).rgb)


def test_two_fits_of_one_seed_are_the_same_bytes(moving, tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        fit(moving)[0].save(tmp_path / name)
    one, two = ((tmp_path / name / "field.safetensors").read_bytes() for name in ("one", "two"))
    assert one == two


def test_source_images_keep_their_appearance_and_others_get_the_mean(still):
    method, _ = fit(still)
    camera = still.camera("front", 0)
    renamed = room.tiny_camera("virtual", 0.0, room.MOUNT)
    own, mean = method.render(camera, 0).rgb, method.render(renamed, 0).rgb
    assert not np.array_equal(own, mean)


def test_a_budget_ends_the_fit(still):
    fit(still)  # compiles
    start = time.monotonic()
    _, report = fit(still, Budget(seconds=0.5), iterations=10**6)
    assert time.monotonic() - start < 1.5
    assert "of 1000000 iterations in the budget" in report.note


def test_a_budget_that_is_spent_before_the_fit_still_leaves_a_model(still):
    method, report = fit(still, Budget(seconds=0.0))
    assert "0 of 4 iterations in the budget" in report.note
    _, report = fit(still, Budget(seconds=0.0), iterations=None)
    images = len(still.frames) * len(still.cameras)
    assert f"0 of {STEPS_AN_IMAGE * images} iterations in the budget" in report.note
    assert np.isfinite(method.render(still.camera("front", 0), 0).rgb).all()


def test_a_loss_that_is_not_finite_names_its_step(still):
    with pytest.raises(GeoEvsError, match=r"loss is not finite at step \d+; lower"):
        fit(still, learning_rate=1e14, iterations=100)


def test_without_lidar_there_are_no_depth_losses(tmp_path, monkeypatch):
    write_scene(tmp_path / "dark", INFO, tracks(), moving_frames(monkeypatch, lidar=False))
    method, report = fit(Scene(tmp_path / "dark"))
    assert report.note == "no LiDAR: no depth losses"  # its car drives by
    assert method.motion(room.tiny_camera("front", 0.0, room.MOUNT), 0)[0].any()
    assert np.isfinite(method.render(room.tiny_camera("front", 0.0, room.MOUNT), 0).rgb).all()


def test_without_lidar_a_parked_car_gets_no_dynamic_field(tmp_path, monkeypatch):
    frames = moving_frames(monkeypatch, lidar=False)
    write_scene(tmp_path / "dark", INFO, tracks(moving=False), frames)
    _, report = fit(Scene(tmp_path / "dark"))
    assert report.note == "no LiDAR: no depth losses; static scene: no dynamic field"


def test_without_tracks_nobody_says_that_nothing_moves(tmp_path, monkeypatch):
    write_scene(tmp_path / "scene", INFO, tracks(frames=0), moving_frames(monkeypatch))
    method, report = fit(Scene(tmp_path / "scene"))
    assert report.note == "no tracks: a dynamic field in case something moves"
    assert method.render(room.tiny_camera("front", 0.0, room.MOUNT), 0).depth is not None


def test_all_sky_is_fitted(tmp_path):
    camera = room.tiny_camera("front", 0.0, room.MOUNT)
    blue = np.full((room.HEIGHT, room.WIDTH, 3), (90, 120, 200), np.uint8)
    nothing = PointCloud.uncoloured(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    frame = Frame(0, 0.0, {"front": camera}, {"front": blue}, nothing)
    write_scene(tmp_path / "sky", INFO, tracks(frames=0), iter([frame]))
    method, report = fit(Scene(tmp_path / "sky"), iterations=150, learning_rate=0.03)
    assert report.note == "no LiDAR: no depth losses; one frame: no dynamic field"
    seen = method.render(camera, 0)
    assert abs(seen.rgb - blue / 255).mean() < 0.05
    assert not seen.depth.any()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"iterations": 0}, "0 for its option 'iterations'; make it 1 or more"),
        ({"samples": (8, 4)}, r"\(8, 4\) for its option 'samples'; write a list of 3"),
        ({"levels": 2}, "2 for its option 'levels'; make it 4 or more"),
        ({"raise": 2}, "no option 'raise'; did you mean 'rays'"),
    ],
)
def test_bad_options_are_one_sentence(options, sentence):
    with pytest.raises(GeoEvsError, match=sentence):
        make_method("emernerf", options)


def test_dynamics_emerge_where_the_car_is_and_flow_the_way_it_drives(moving, monkeypatch):
    learned = {"iterations": 250, "rays": 128, "levels": 6, "log2_entries": 12, "width": 16}
    method, _ = fit(moving, **learned, samples=(24, 12, 12))
    shown, both, either, along, weight = [], 0, 0, 0.0, 0.0
    for frame in range(FRAMES):
        camera = moving.camera("front", frame)
        monkeypatch.setattr(room, "CAR", car_at(frame))
        points, pixels = unproject_depth(room.tiny_truth(camera).depth, camera)
        inside = (points >= car_at(frame)[0] - 0.01) & (points <= car_at(frame)[1] + 0.01)
        car = np.zeros(camera.height * camera.width, bool)
        car[pixels[inside.all(axis=1)]] = True
        shares, flow = (
            part.reshape(len(car), -1).squeeze() for part in method.motion(camera, frame)
        )
        shown.append((shares[car].mean(), shares[~car].mean()))
        both += np.count_nonzero(car & (shares > 0.5))
        either += np.count_nonzero(car | (shares > 0.5))
        along += (flow[car, 1] * shares[car]).sum()
        weight += shares[car].sum()
    on_car, elsewhere = np.mean(shown, axis=0)
    assert both / either > 0.6  # measured: 0.90
    assert on_car > 3 * elsewhere
    # The car drives 1.2 m a frame to the right, where y falls; measured: 1.1.
    assert along / weight == pytest.approx(STEP[1], abs=0.5)

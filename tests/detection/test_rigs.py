"""Frames as detectors of a setting see them, counted and moved aside, on the tiny scene."""

import numpy as np
import pandas as pd
import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_json
from geoevs.core.images import write_image
from geoevs.core.parquet import write_parquet
from geoevs.detection.labels import scene_labels
from geoevs.detection.rigs import DetectionScene
from geoevs.detection.rows import BOX, PREDICTION_TYPES
from geoevs.detection.setting_counts import count_setting
from geoevs.detection.task_rows import RECORDED, task_rows
from geoevs.detection.views import BETWEEN, ViewSettings, moved_rig, views_between
from geoevs.methods.tiny import tiny_truth, write_tiny_scene
from geoevs.projection import project_points
from geoevs.protocol.entries import FINE, failed
from geoevs.protocol.pictures import PICTURES, seal_pictures
from geoevs.protocol.targets import ALL_CAMERAS, read_targets, write_targets
from geoevs.scenes.scene import SceneExtras

PLACE = {"dataset": "d", "scene": "tiny"}
OFFSETS = (-1.0, 2.0)
NUMBERS = {"threads": 1, "peak_memory": 0, "gpu_memory": 0}
ZONE = np.array([[8.0, 1.0], [40.0, 1.0], [40.0, 3.0], [8.0, 3.0]])


def grey(run, label, value, leave_out=()):
    """Renders of an entrant that knows one grey value."""
    folder = run / layout.DETECTION_VIEWS.format(**PLACE, label=label)
    targets = read_targets(run / layout.DETECTION_TARGETS.format(**PLACE))
    for target in targets:
        if target.key not in leave_out:
            picture = np.full((target.camera.height, target.camera.width, 3), value, np.uint8)
            write_image(folder / f"{target.key}.png", picture)
    outcome = {**FINE, **NUMBERS, PICTURES: seal_pictures(folder, targets)}
    write_json(folder / "render.json", {ALL_CAMERAS: outcome})
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    run = tmp_path_factory.mktemp("run")
    extras = SceneExtras(no_label_zones={1: [ZONE]})
    scene = write_tiny_scene(run / layout.SCENE.format(**PLACE), extras=extras)
    labels = scene_labels(scene, "d/tiny", {"vehicle": ["car"]}, (-8, -28, -3, 48, 28, 5))
    write_parquet(run / layout.DETECTION_LABELS.format(**PLACE), labels)
    targets = [*views_between(scene, ViewSettings()), *moved_rig(scene, OFFSETS)]
    write_targets(run / layout.DETECTION_TARGETS.format(**PLACE), targets)
    for target in targets:
        path = run / layout.DETECTION_TRUTH.format(**PLACE) / f"{target.key}.png"
        write_image(path, tiny_truth(target.camera).rgb)
    grey(run, "grey", 51)
    return run


@pytest.fixture
def scene(run):
    return DetectionScene(run, "d", "tiny")


def test_recorded_views_come_first_and_project_the_labelled_car(scene):
    frames = list(scene.frames("with-truth"))
    assert [frame.frame for frame in frames] == [0, 1]
    assert frames[1].seconds == pytest.approx(0.1)
    frame = frames[0]
    assert frame.images.shape == (3 + 20, 48, 72, 3)
    assert frame.recorded.tolist() == [True] * 3 + [False] * 20
    np.testing.assert_array_equal(frame.images[0], scene.store.image("front", 0))
    # The same pixel by the vehicle's frame and by the world's.
    centre = np.append(frame.boxes[0, :3], 1)
    u, v, depth = frame.image_from_vehicle[0] @ centre
    world = (frame.world_from_vehicle @ centre)[None, :3]
    uv, z = project_points(world, scene.store.camera("front", 0))
    np.testing.assert_allclose([u / depth, v / depth, depth], [*uv[0], z[0]])
    assert frame.classes.tolist() == [0]


def test_a_blind_detector_sees_grey_and_a_native_one_what_was_recorded(scene):
    blind, native = (next(scene.frames(setting)) for setting in ("blind", "native"))
    assert np.ptp(blind.images) == 0
    assert blind.images.shape == native.images.shape == (3, 48, 72, 3)
    for name in ("longer", "augmented"):
        np.testing.assert_array_equal(next(scene.frames(name)).images, native.images)
    np.testing.assert_array_equal(blind.image_from_vehicle, native.image_from_vehicle)


def test_views_are_the_entrants(scene):
    frame = next(scene.frames("with-grey"))
    np.testing.assert_allclose(frame.images[3:], 0.2)
    truth = next(scene.frames("with-truth"))
    views = [target for target in scene.targets if target.split == BETWEEN]
    expected = tiny_truth(views[0].camera).rgb / 255.0
    np.testing.assert_allclose(truth.images[3], expected, atol=1e-6)


def test_missing_pictures_are_one_sentence(run, scene):
    key = next(target.key for target in scene.targets if target.split == BETWEEN)
    grey(run, "gaps", 51, leave_out=[key])
    with pytest.raises(
        GeoEvsError, match=rf"d/tiny: {key[:5]}.*: no picture of this view was left"
    ):
        list(scene.frames("with-gaps"))
    folder = run / layout.DETECTION_VIEWS.format(**PLACE, label="broken")
    outcome = failed("fit", "no memory", "fit.log") | NUMBERS
    write_json(folder / "render.json", {ALL_CAMERAS: outcome})
    with pytest.raises(GeoEvsError, match=r"d/tiny: fit: no memory \(see fit.log\)"):
        list(scene.frames("with-broken"))


def test_where_nobody_knows_the_truth_it_is_one_sentence(run, scene, monkeypatch):
    monkeypatch.setattr(layout, "DETECTION_TRUTH", "nowhere/{dataset}/{scene}")
    with pytest.raises(GeoEvsError, match=r"nobody knows what a camera at .* would see"):
        list(scene.frames("with-truth"))


def test_the_moved_rig_carries_its_vehicle_frame_along(scene):
    recorded = next(scene.moved_frames(None, 0.0))
    moved = next(scene.moved_frames("truth", 2.0))
    shift = moved.world_from_vehicle[:3, 3] - recorded.world_from_vehicle[:3, 3]
    np.testing.assert_allclose(shift, [0, 2, 0], atol=1e-12)
    np.testing.assert_allclose(moved.boxes - recorded.boxes, [[0, -2, 0, 0, 0, 0, 0]])
    # Cameras stand in the moved vehicle as they did in the recorded one.
    np.testing.assert_allclose(
        moved.image_from_vehicle, recorded.image_from_vehicle, rtol=0, atol=1e-9
    )
    assert moved.recorded.all()


def told(frames, score=0.9, **changes):
    """What a detector would report that knows the labels, or others."""
    rows = [
        {"scene": frame.scene, "frame": frame.frame, "class": "vehicle", "score": score}
        | dict(zip(BOX, box, strict=True))
        | {"ignored": 0}
        | changes
        for frame in frames
        for box in frame.boxes
    ]
    return pd.DataFrame(rows, columns=list(PREDICTION_TYPES)).astype(PREDICTION_TYPES)


def test_counts_of_a_perfect_detector_and_of_zones_without_labels(scene):
    frames = list(scene.frames("native"))
    rows = count_setting("native", 3, [scene], told(frames))
    assert set(rows["rules"]) == {"LET", "plain", "centre"}
    assert (rows["setting"].eq("native") & rows["seed"].eq(3)).all()
    best = rows[(rows["cutoff"] == 0) & (rows["breakdown"] == "type")]
    assert best["true_positives"].sum() == best["truths"].sum() == 2 * 4
    # Turned aside, both are wrong; but in frame 1 the place lies where nobody drew boxes.
    aside = told(frames, heading=0.0)
    aside["x"] += 4.0
    wrong = count_setting("native", 3, [scene], aside)
    wrong = wrong[(wrong["cutoff"] == 0) & (wrong["breakdown"] == "type")]
    assert wrong.groupby("rules")["false_positives"].sum().to_dict() == {
        "LET": 1, "plain": 2, "centre": 1
    }  # fmt: skip
    none = count_setting("native", 3, [scene], told([]))
    assert none["false_negatives"].max() == 1


def test_task_rows_of_a_perfect_detector(scene):
    detectors = {0: scene.store.folder, 1: "loss is nan"}
    rows = task_rows("truth", [scene], OFFSETS, detectors, lambda _, frames: told(frames))
    good, bad = rows[rows["seed"] == 0], rows[rows["seed"] == 1]
    assert len(good) == len(bad) == len(OFFSETS) * 2
    assert (good["value"] == good["count"]).all()
    assert good["count"].tolist() == [1] * 4
    assert bad["reason"].eq("loss is nan").all()
    assert bad["value"].isna().all()
    recorded = task_rows(RECORDED, [scene], OFFSETS, {0: scene.store.folder}, lambda _, f: told(f))
    assert recorded["offset"].eq(0).all()
    blind = task_rows("truth", [scene], OFFSETS, {0: scene.store.folder}, lambda *_: told([]))
    assert blind["value"].sum() == 0


def test_an_entrant_that_failed_somewhere_has_rows_with_its_reason(run, scene):
    rows = task_rows("broken-too", [scene], OFFSETS, {0: run}, lambda _, frames: told(frames))
    assert rows["reason"].str.contains("render.json is missing").all()


def test_let_metrics_look_from_the_cameras_mean_place(scene):
    np.testing.assert_allclose(scene.sensor(), [0, 0, 2.0], atol=1e-12)

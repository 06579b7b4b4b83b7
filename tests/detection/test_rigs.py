"""Frames as detectors of a setting see them, counted and moved aside, on the tiny scene."""

import numpy as np
import pandas as pd
import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_json
from geoevs.core.stamps import MADE_WITH
from geoevs.detection.rows import BOX, PREDICTION_TYPES
from geoevs.detection.setting_counts import count_setting
from geoevs.detection.task_rows import RECORDED, task_rows
from geoevs.detection.views import BETWEEN
from geoevs.methods.tiny import tiny_truth
from geoevs.projection import project_points
from geoevs.protocol.entries import failed
from geoevs.protocol.targets import ALL_CAMERAS
from tests.detection.conftest import COSTS, OFFSETS, PLACE, grey_views, stamp


def test_recorded_views_come_first_and_project_the_labelled_car(rig_scene):
    frames = list(rig_scene.frames("with-truth"))
    assert [frame.frame for frame in frames] == [0, 1]
    assert frames[1].seconds == pytest.approx(0.1)
    frame = frames[0]
    assert frame.images.shape == (3 + 20, 48, 72, 3)
    assert frame.recorded.tolist() == [True] * 3 + [False] * 20
    np.testing.assert_array_equal(frame.images[0], rig_scene.store.image("front", 0))
    # The same pixel by the vehicle's frame and by the world's.
    centre = np.append(frame.boxes[0, :3], 1)
    u, v, depth = frame.image_from_vehicle[0] @ centre
    world = (frame.world_from_vehicle @ centre)[None, :3]
    uv, z = project_points(world, rig_scene.store.camera("front", 0))
    np.testing.assert_allclose([u / depth, v / depth, depth], [*uv[0], z[0]])
    assert frame.classes.tolist() == [0]


def test_a_blind_detector_sees_grey_and_a_native_one_what_was_recorded(rig_scene):
    blind, native = (next(rig_scene.frames(setting)) for setting in ("blind", "native"))
    assert np.ptp(blind.images) == 0
    assert blind.images.shape == native.images.shape == (3, 48, 72, 3)
    for name in ("longer", "augmented"):
        np.testing.assert_array_equal(next(rig_scene.frames(name)).images, native.images)
    np.testing.assert_array_equal(blind.image_from_vehicle, native.image_from_vehicle)


def test_views_are_the_entrants(rig_scene):
    frame = next(rig_scene.frames("with-grey"))
    np.testing.assert_allclose(frame.images[3:], 0.2)
    truth = next(rig_scene.frames("with-truth"))
    views = [target for target in rig_scene.targets if target.split == BETWEEN]
    expected = tiny_truth(views[0].camera).rgb / 255.0
    np.testing.assert_allclose(truth.images[3], expected, atol=1e-6)


def test_missing_pictures_are_one_sentence(rig_run, rig_scene):
    key = next(target.key for target in rig_scene.targets if target.split == BETWEEN)
    grey_views(rig_run, "gaps", 51, leave_out=[key])
    with pytest.raises(
        GeoEvsError, match=rf"d/tiny: {key[:5]}.*: no picture of this view was left"
    ):
        list(rig_scene.frames("with-gaps"))
    folder = rig_run / layout.DETECTION_VIEWS.format(**PLACE, label="broken")
    outcome = failed("fit", "no memory", "fit.log") | COSTS | {MADE_WITH: stamp(rig_run)}
    write_json(folder / "render.json", {ALL_CAMERAS: outcome})
    with pytest.raises(GeoEvsError, match=r"d/tiny: fit: no memory \(see fit.log\)"):
        list(rig_scene.frames("with-broken"))


def test_pictures_of_other_targets_are_refused(rig_run, rig_scene):
    folder = grey_views(rig_run, "stale", 51)
    told = read_json(folder / "render.json")
    told[ALL_CAMERAS][MADE_WITH]["targets"] = "others"
    write_json(folder / "render.json", told)
    with pytest.raises(GeoEvsError, match=r"render.json was made with other targets than this run"):
        list(rig_scene.frames("with-stale"))


def test_where_nobody_knows_the_truth_it_is_one_sentence(rig_scene, monkeypatch):
    monkeypatch.setattr(layout, "DETECTION_TRUTH", "nowhere/{dataset}/{scene}")
    with pytest.raises(GeoEvsError, match=r"nobody knows what a camera at .* would see"):
        list(rig_scene.frames("with-truth"))


def test_the_moved_rig_carries_its_vehicle_frame_along(rig_scene):
    recorded = next(rig_scene.moved_frames(None, 0.0))
    moved = next(rig_scene.moved_frames("truth", 2.0))
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


def test_counts_of_a_perfect_detector_and_of_zones_without_labels(rig_scene):
    frames = list(rig_scene.frames("native"))
    rows = count_setting("native", 3, [rig_scene], told(frames))
    assert set(rows["rules"]) == {"LET", "plain", "centre"}
    assert (rows["setting"].eq("native") & rows["seed"].eq(3)).all()
    best = rows[(rows["cutoff"] == 0) & (rows["breakdown"] == "type")]
    assert best["true_positives"].sum() == best["truths"].sum() == 2 * 4
    # Turned aside, both are wrong; but in frame 1 the place lies where nobody drew boxes.
    aside = told(frames, heading=0.0)
    aside["x"] += 4.0
    wrong = count_setting("native", 3, [rig_scene], aside)
    wrong = wrong[(wrong["cutoff"] == 0) & (wrong["breakdown"] == "type")]
    assert wrong.groupby("rules")["false_positives"].sum().to_dict() == {
        "LET": 1, "plain": 2, "centre": 1
    }  # fmt: skip
    none = count_setting("native", 3, [rig_scene], told([]))
    assert none["false_negatives"].max() == 1


def test_task_rows_of_a_perfect_detector(rig_scene):
    detectors = {0: rig_scene.store.folder, 1: "loss is nan"}
    rows = task_rows("truth", [rig_scene], OFFSETS, detectors, lambda _, frames: told(frames))
    good, bad = rows[rows["seed"] == 0], rows[rows["seed"] == 1]
    assert len(good) == len(bad) == len(OFFSETS) * 2
    assert (good["value"] == good["count"]).all()
    assert good["count"].tolist() == [1] * 4
    assert bad["reason"].eq("loss is nan").all()
    assert bad["value"].isna().all()
    recorded = task_rows(
        RECORDED, [rig_scene], OFFSETS, {0: rig_scene.store.folder}, lambda _, f: told(f)
    )
    assert recorded["offset"].eq(0).all()
    blind = task_rows(
        "truth", [rig_scene], OFFSETS, {0: rig_scene.store.folder}, lambda *_: told([])
    )
    assert blind["value"].sum() == 0


def test_an_entrant_that_failed_somewhere_has_rows_with_its_reason(rig_run, rig_scene):
    rows = task_rows(
        "broken-too", [rig_scene], OFFSETS, {0: rig_run}, lambda _, frames: told(frames)
    )
    assert rows["reason"].str.contains("render.json is missing").all()


def test_let_metrics_look_from_the_cameras_mean_place(rig_scene):
    np.testing.assert_allclose(rig_scene.sensor(), [0, 0, 2.0], atol=1e-12)

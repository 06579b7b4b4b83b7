"""Masked targets, the masks that degrade them, and what methods and scores make of both."""

import math
from dataclasses import replace

import numpy as np
import pytest

from geoevs import layout
from geoevs.core.files import read_arrays
from geoevs.core.images import read_image, to_uint8, write_image
from geoevs.core.randomness import Rng
from geoevs.core.stamps import MADE_WITH
from geoevs.methods.contract import Budget, Views
from geoevs.methods.finding import make_method
from geoevs.protocol.condition_masks import (
    ConditionMask,
    ConditionMasks,
    RawReprojection,
    make_condition_masks,
)
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.regions import masked_regions
from geoevs.protocol.rows import score_frame
from geoevs.protocol.scoring import score_method
from geoevs.protocol.targets import FRONT_SIDE, make_targets, read_targets, write_targets
from geoevs.scenes.camera import angle_between

OK = {"status": "ok", "stage": "", "reason": "", "log": "", "threads": 1}
OK |= {"peak_memory": 9, "gpu_memory": 0}


@pytest.fixture(scope="module")
def masked(stage):
    return [target for target in stage.targets if target.masked]


def test_masked_targets_share_the_views_of_others(stage, masked):
    plain = {target.key: target for target in stage.targets if not target.masked}
    # Three cameras and four extrapolated views of the first of two frames.
    assert [target.split for target in masked] == ["masked-observed"] * 3 + [
        "masked-extrapolation"
    ] * 4
    assert len({target.key for target in masked} - set(plain)) == 7
    for target in masked:
        other = plain[target.unmasked.key]
        assert target.split == f"masked-{other.split}"
        assert (target.frame, target.sources) == (0, "all-cameras")
        assert target.pose_offset == other.pose_offset
        pose = other.camera.world_from_camera
        np.testing.assert_array_equal(target.camera.world_from_camera, pose)
        np.testing.assert_array_equal(
            stage.answers.truth(target),
            stage.answers.truth(other),
        )
    assert all(target.unmasked is target for target in plain.values())


def test_masks_come_from_the_configured_poses(stage, masked):
    for target in masked:
        front = stage.store.camera("front", target.frame)
        yaw = angle_between(target.mask_camera.optical_axis, front.optical_axis)
        assert min(abs(yaw - wanted) for wanted in (15, 20)) < 1e-9
        # All cameras of the tiny rig share one centre, and the ego heads along x.
        offset = target.mask_camera.centre - front.centre
        np.testing.assert_allclose(np.abs(offset), [0, 2, 0], atol=1e-9)
        side = "left" if target.mask_camera.yaw > 0 else "right"
        name = f"mask-{side}{round(yaw)}deg{round(offset[1]):+d}m"
        assert target.mask_camera.name == name


def test_the_seed_draws_each_targets_pose_by_itself(stage):
    def drawn(seed, **changes):
        targets = make_targets(stage.store, {**stage.protocol, **changes}, seed)
        return {target.key: target.mask_camera.name for target in targets if target.masked}

    assert drawn(0) == drawn(0)
    alone = drawn(0, lateral=[1.0])
    assert alone == {key: name for key, name in drawn(0).items() if key in alone}
    # Eight poses: 20 seeds leave out one of them for a target with a chance of 7 %.
    first = [drawn(seed)["masked-front/000000"] for seed in range(20)]
    assert 5 <= len(set(first)) <= 8


def test_masked_targets_survive_a_round_trip(masked, tmp_path):
    write_targets(tmp_path / "targets.json", masked)
    for target, again in zip(masked, read_targets(tmp_path / "targets.json"), strict=True):
        assert again.key == target.key
        assert again.mask_camera.name == target.mask_camera.name
        pose = target.mask_camera.world_from_camera
        np.testing.assert_array_equal(again.mask_camera.world_from_camera, pose)


@pytest.fixture(scope="module")
def reproject(stage):
    method = make_method("reproject", {})
    method.fit(Views(stage.store, stage.store.cameras, method.info.needs), Budget(), Rng(0))
    return method


def test_masks_are_the_supports_of_the_control_that_reprojects(stage, masked, reproject):
    masks = ConditionMasks(stage.answers.path(layout.MASKS))
    for target in masked:
        mask = masks[target.key]
        seen = reproject.render(target.camera, target.frame).support
        np.testing.assert_array_equal(mask.reprojected, seen)
        virtual = reproject.render(target.mask_camera, target.frame).support
        np.testing.assert_array_equal(mask.keep, virtual)
        assert mask.removed.any()
        assert mask.supported.mean() > 0.5


def test_a_lens_of_its_own_gets_a_cloud_of_its_own(stage, reproject):
    reprojection = RawReprojection(stage.store)
    wide = stage.store.camera("front", 0)
    # Nine times the pixels in each view: a cloud that is fine enough for one is not for the other.
    close = wide.resized(wide.height * 3, wide.width * 3)
    for camera in (wide, close, wide):
        expected = reproject.render(camera, 0).support
        np.testing.assert_array_equal(reprojection.validity(camera, 0), expected)


def test_the_masks_hold_nothing_that_scores(stage, masked):
    stored = read_arrays(stage.answers.path(layout.MASKS))
    names = {f"{target.key}/{name}" for target in masked for name in ("keep", "reprojected")}
    stored.pop(MADE_WITH)
    assert set(stored) == names
    assert {array.dtype.kind for array in stored.values()} == {"b"}


def test_other_sources_have_no_mask(stage, masked):
    target = replace(masked[0], sources=FRONT_SIDE)
    with pytest.raises(ValueError, match="front-side"):
        make_condition_masks([target], RawReprojection(stage.store))


def test_regions_by_hand():
    mask = ConditionMask(
        keep=np.array([[True, True, False, False]]),
        reprojected=np.array([[True, False, True, False]]),
    )
    found = masked_regions(mask, None, np.ones((1, 4, 3)), 1.0)
    assert {name: answer.mask.astype(int).tolist()[0] for name, answer in found.items()} == {
        "dense": [1, 1, 1, 1],
        "dense-supported": [1, 0, 0, 0],
        "dense-removed": [0, 0, 1, 0],
        "dense-never": [0, 1, 0, 1],
        "dense-unsupported": [0, 1, 1, 1],
    }
    assert {answer.support_ratio for answer in found.values()} == {0.25}
    assert masked_regions(mask, None, None, 1.0) == {}


@pytest.fixture
def scored(stage, masked, tmp_path):
    """Scores renders that err by one step in supported pixels, two in removed, four elsewhere."""
    entry, answers = MethodEntry("mine"), stage.linked(tmp_path, layout.TARGETS)
    renders = answers.renders(entry.label)
    for target in masked:
        mask = answers.mask(target)
        truth = to_uint8(stage.answers.truth(target))
        error = np.full(mask.keep.shape, 4, np.uint8)
        error[mask.supported], error[mask.removed] = 1, 2
        write_image(renders / f"{target.key}.png", truth + error[..., None])
    write_targets(answers.path(layout.TARGETS), masked)

    def score(**outcome):
        stage.seal(renders, {"all-cameras": {**OK, **outcome}})
        return score_frame(score_method(entry, answers, [1.0, 0.5], "f"))

    return score


def test_each_part_is_scored_by_itself(scored, masked):
    rows = scored(masked=True)
    for metric, step in (("psnr_supported", 1), ("psnr_removed", 2), ("psnr_never", 4)):
        mine = rows[(rows["metric"] == metric) & (rows["status"] == "ok")]
        np.testing.assert_allclose(mine["value"], 20 * math.log10(255 / step), rtol=1e-5)
    pixels = rows.pivot_table("valid_pixels", ["split", "target"], "metric", aggfunc="sum")
    unsupported = pixels["psnr_removed"] + pixels["psnr_never"]
    np.testing.assert_array_equal(pixels["psnr_unsupported"], unsupported)
    np.testing.assert_array_equal(pixels["psnr"], unsupported + pixels["psnr_supported"])
    dense = {
        "psnr",
        "ssim",
        "mae",
        "gms",
        "lpips",
        *(f"psnr_{part}" for part in ("supported", "removed")),
    }
    dense |= {"psnr_never", "psnr_unsupported"}
    metrics = {split: set(group["metric"]) for split, group in rows.groupby("split")}
    assert metrics == {
        "masked-observed": dense,
        "masked-extrapolation": {*dense, "sparse_psnr_removed"},
    }
    assert (rows["stressor"] == "").all()
    ratio = rows.groupby("target")["support_ratio"].unique()
    assert all(len(values) == 1 for values in ratio)


def test_the_sparse_score_is_of_hidden_reference_pixels(stage, scored, masked):
    rows = scored(masked=True)
    sparse = rows[rows["metric"] == "sparse_psnr_removed"].set_index("target")["valid_pixels"]
    references = read_arrays(stage.answers.path(layout.REFERENCES))
    masks = ConditionMasks(stage.answers.path(layout.MASKS))
    assert len(sparse) == 4
    assert sparse.sum() > 0
    for target in masked:
        if target.split == "masked-extrapolation":
            pixels = references[f"{target.unmasked.key}/pixels"]
            hidden = int(masks[target.key].removed.ravel()[pixels].sum())
            assert sparse[target.camera.name] == hidden


def test_methods_without_a_condition_map_have_no_rows(scored):
    assert len(scored(masked=False)) == 0
    failed = scored(status="failed", stage="fit")  # whose kind nobody knows
    assert len(failed) == len(scored(masked=True))
    assert (failed["status"] == "failed").all()


def test_a_method_gets_its_mask_as_an_array(attempt, stage, masked, tmp_path):
    fits, renders = attempt("reproject", "observed", "masked-observed")
    assert fits["all-cameras"]["masked"]
    assert renders["all-cameras"]["status"] == "ok"
    masks = ConditionMasks(stage.answers.path(layout.MASKS))
    for target in [target for target in masked if target.split == "masked-observed"]:
        picture = read_image(tmp_path / "renders" / f"{target.key}.png")
        plain = read_image(tmp_path / "renders" / f"{target.unmasked.key}.png")
        keep = masks[target.key].keep[..., None]
        np.testing.assert_array_equal(picture, np.where(keep, plain, 0))


def test_a_method_without_a_condition_map_is_not_asked(toy, attempt, tmp_path):
    fits, renders = attempt(toy("plain"), "observed", "masked-observed")
    assert fits["all-cameras"]["masked"] is renders["all-cameras"]["masked"] is False
    assert renders["all-cameras"]["status"] == "ok"
    folders = {path.parent.name for path in (tmp_path / "renders").rglob("*.png")}
    assert folders == {"front", "left", "right"}


@pytest.mark.parametrize("name", ["reference", "truth"])
def test_oracles_show_the_view_without_the_mask(attempt, stage, masked, tmp_path, name):
    splits = ("extrapolation", "masked-extrapolation")
    answers = stage.linked(tmp_path / "run", layout.TARGETS)
    stage.keep(answers.path(layout.TARGETS), *splits)
    _, renders = attempt(name, *splits, answers=answers)
    assert renders["all-cameras"]["status"] == "ok"
    for target in [target for target in masked if target.split == "masked-extrapolation"]:
        keys = (target.key, target.unmasked.key)
        first, second = (read_image(tmp_path / "renders" / f"{key}.png") for key in keys)
        np.testing.assert_array_equal(first, second)

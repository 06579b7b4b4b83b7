import math
from pathlib import Path

import numpy as np
import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_json
from geoevs.core.images import write_image
from geoevs.protocol.entries import REFERENCE, MethodEntry
from geoevs.protocol.metrics import METRICS
from geoevs.protocol.oracle import oracle_picture, oracle_step
from geoevs.protocol.reference import SparseReference
from geoevs.protocol.regions import regions
from geoevs.protocol.rows import SCORE_TYPES, cost_frame, score_frame
from geoevs.protocol.scoring import THINNED_METRICS, cost_rows, score_method
from geoevs.protocol.targets import read_targets
from geoevs.run import Answers

MASKED_ALONE = {"psnr_removed", "psnr_never", "psnr_unsupported", "sparse_psnr_removed"}
STABILITY_ALONE = {"psnr_moving", "psnr_still"}
COMMON = {"dataset": "d", "scene": "s", "fingerprint": "f"}
OK = {"status": "ok", "stage": "", "reason": "", "log": "", "threads": 2}
OK |= {"peak_memory": 9, "gpu_memory": 0}
FAILED = {**OK, "status": "failed", "stage": "fit", "reason": "no points", "log": "fit.log"}
KEEPS = [1.0, 0.5]


def reference(height=12, width=20, pixels=(), rank=(), footprint=None, reprojected=None):
    """A sparse reference of one colour."""
    count = len(pixels)
    return SparseReference(
        pixels=np.array(pixels, np.int64),
        rgb=np.full((count, 3), 0.5, np.float32),
        footprint=np.ones(count, bool) if footprint is None else np.array(footprint),
        rank=np.array(rank if len(rank) else np.zeros(count), np.float32),
        reprojected=np.zeros((height, width), bool) if reprojected is None else reprojected,
    )


def test_regions_by_hand():
    reprojected = np.zeros((1, 5), bool)
    reprojected[0, [1, 4]] = True
    sparse = reference(1, 5, [0, 1, 3, 4], [0.0, 0.25, 0.5, 0.75], [1, 1, 0, 1], reprojected)
    found = regions(sparse, np.ones((1, 5, 3)), keep=0.6)  # drops the last of the four
    masks = {name: answer.mask.astype(int).tolist()[0] for name, answer in found.items()}
    assert masks == {
        "reference": [1, 1, 0, 1, 0],
        "reference-new": [1, 0, 0, 1, 0],
        "reference-footprint": [1, 1, 0, 0, 0],
        "dense": [1, 1, 1, 1, 1],
        "dense-new": [1, 0, 1, 1, 0],
        "dense-supported": [0, 1, 0, 0, 1],
    }
    assert {answer.support_ratio for answer in found.values()} == {0.6}
    assert set(regions(sparse, None, 1.0)) == {"reference", "reference-new", "reference-footprint"}
    recorded = regions(None, np.ones((1, 5, 3)), 1.0)
    assert list(recorded) == ["dense"]
    assert recorded["dense"].support_ratio == 1.0
    assert regions(None, None, 1.0) == {}


def entry(name):
    return MethodEntry(name, "v", {}, 4)


@pytest.fixture(scope="module")
def answers(stage, tmp_path_factory):
    """A run with the reference's own renders, and one grey for all targets."""
    answers = stage.linked(tmp_path_factory.mktemp("run"))
    for sources in ("all-cameras", "front-side"):
        folder = str(answers.renders(entry(REFERENCE).label))
        oracle_step(REFERENCE, str(answers.run), "d", "s", sources, folder)
    grey = np.full((48, 72, 3), 115, np.uint8)
    for target in stage.targets:
        for name in ("grey", "failed"):
            write_image(answers.renders(entry(name).label) / f"{target.key}.png", grey)
    for name in ("reference", "grey", "failed"):
        outcome = FAILED if name == "failed" else OK
        stage.seal(answers.renders(entry(name).label), {"all-cameras": outcome, "front-side": OK})
    return answers


def scored(answers, name):
    # Opened anew, so that what a test has replaced is seen.
    answers = Answers(answers.run, **answers.place)
    return score_frame(score_method(entry(name), answers, KEEPS, "f"))


def test_every_target_has_every_metric_that_it_can(stage, answers):
    rows = scored(answers, "grey")
    assert list(rows.columns) == list(SCORE_TYPES)
    main = rows[rows["stressor"] == ""]
    dense = {"psnr", "ssim", "mae", "gms", "lpips"}
    for target in stage.targets:
        if target.masked:
            continue
        mine = main[(main["target"] == target.camera.name) & (main["frame"] == target.frame)]
        whole = set(METRICS) - MASKED_ALONE - STABILITY_ALONE - {"efficientnet_layers"}
        expected = dense if target.recorded else whole
        assert len(mine) == len(expected)
        assert set(mine["metric"]) == expected
        assert (mine["split"] == target.split).all()
        assert mine["pose_offset"].unique() == [pytest.approx(target.pose_offset)]
        assert mine["lateral_shift"].unique() == [target.lateral_shift]
        assert mine["level"].isna().all()
    assert (rows["method"] + rows["variant"] == "greyv").all()
    assert (rows["seed"] == 4).all()
    assert all((rows[name] == value).all() for name, value in COMMON.items())


def test_thinned_rows_are_of_extrapolation_alone(stage, answers):
    rows = scored(answers, "grey")
    thinned = rows[rows["stressor"] == "reference-thinning"]
    extrapolated = [target for target in stage.targets if target.split == "extrapolation"]
    assert len(thinned) == len(THINNED_METRICS) * len(extrapolated) == 4 * 8
    assert (thinned["split"] == "extrapolation").all()
    assert (thinned["level"] == 0.5).all()
    full = rows[(rows["stressor"] == "") & rows["metric"].isin(THINNED_METRICS)]
    pair = thinned.merge(full, on=["frame", "target", "metric"], suffixes=("", "_full"))
    halves = pair[pair["metric"] != "sparse_ssim"]
    np.testing.assert_allclose(halves["valid_pixels"], halves["valid_pixels_full"] / 2, atol=0.5)
    np.testing.assert_allclose(pair["support_ratio"] * 48 * 72, pair["valid_pixels"])


def test_the_reference_reaches_what_8_bits_allow(stage, answers):
    best, worst = (scored(answers, name) for name in ("reference", "grey"))
    # Rounding to 1 / 255 errs by at most half of it: 20 log10(2 * 255) = 54.2 dB at worst.
    for metric in ("sparse_psnr", "sparse_psnr_new", "sparse_psnr_footprint"):
        values = best[best["metric"] == metric]["value"]
        assert values.min() > 55
        assert worst[worst["metric"] == metric]["value"].max() < 25
    recorded = best[(best["metric"] == "psnr") & (best["split"] == "observed")]
    assert (recorded["value"] == math.inf).all()
    assert best[best["metric"] == "sparse_ssim"]["value"].min() > 0.999


def test_a_failed_render_is_rows_that_say_so(stage, answers):
    rows, fine = scored(answers, "failed"), scored(answers, "grey")
    assert len(rows) == len(fine)
    failed = rows["split"] != "interpolation"  # those came from other sources
    assert (rows["status"] == "failed").equals(failed)
    assert rows[failed]["value"].isna().all()
    for column in ("stage", "reason", "log"):
        assert rows[failed][column].unique().tolist() == [FAILED[column]]
        # What lpips needs may be missing here.
        assert rows[~failed & (rows["metric"] != "lpips")][column].unique().tolist() == [""]
    same = ["frame", "target", "metric", "valid_pixels", "support_ratio"]
    assert rows[same].equals(fine[same])


def test_an_empty_mask_is_a_row_without_a_value(answers, monkeypatch):
    class NoPoints:
        def __init__(self, path):
            pass

        def __getitem__(self, key):
            return reference(48, 72)

    monkeypatch.setattr("geoevs.run.References", NoPoints)
    rows = scored(answers, "grey")
    rows = rows[~rows["split"].str.startswith("masked")]
    sparse = rows["metric"].str.startswith("sparse")
    assert (rows[sparse]["status"] == "empty-mask").all()
    assert rows[sparse]["value"].isna().all()
    assert (rows[sparse][["valid_pixels", "support_ratio"]] == 0).all(axis=None)
    supported = rows["metric"] == "psnr_supported"  # nor does raw reprojection support a pixel
    assert (rows[supported]["status"] == "empty-mask").all()
    others = ~sparse & ~supported & (rows["metric"] != "lpips")  # its weights may be missing here
    assert (rows[others]["status"] == "ok").all()


def test_a_metric_without_weights_is_rows_that_say_so(answers, monkeypatch):
    monkeypatch.setattr("geoevs.protocol.weights.find_spec", lambda name: None)
    rows = scored(answers, "grey")
    learned = rows[rows["metric"] == "lpips"]
    assert len(learned) == len(rows[rows["metric"] == "psnr"])
    assert (learned["status"] == "unavailable").all()
    assert learned["value"].isna().all()
    assert learned["reason"].str.startswith("the package lpips is not installed (pip").all()


def test_without_truth_virtual_targets_have_sparse_metrics_alone(stage, answers, tmp_path):
    untold = stage.linked(tmp_path, layout.TRUTH)
    renders = untold.renders(entry("grey").label)
    renders.parent.mkdir(parents=True)
    renders.symlink_to(answers.renders(entry("grey").label))
    rows = scored(untold, "grey")
    virtual = rows[rows["split"].isin(["extrapolation", "pose-sweep"])]
    assert virtual["metric"].str.startswith("sparse").all()
    assert set(rows[rows["split"] == "interpolation"]["metric"]) == {
        "psnr",
        "ssim",
        "mae",
        "gms",
        "lpips",
    }


def test_the_oracle_is_black_where_nobody_knows(stage, tmp_path):
    target = next(target for target in stage.targets if target.split == "extrapolation")
    rgb = oracle_picture(REFERENCE, stage.linked(tmp_path, layout.TRUTH), target)
    black = (rgb == 0).all(axis=-1)
    assert 0.01 < 1 - black.mean() < 0.9


# What happens to one picture before or after it is sealed, and the reason that its rows get.
TAMPERED = {
    "not made": (False, Path.unlink, "no picture of this view was left"),
    "no picture": (
        False,
        lambda path: path.write_bytes(b"png"),
        "is not a whole PNG or JPEG",
    ),
    "another size": (False, lambda path: write_image(path, np.zeros((9, 9, 3))), "shape is (9, 9"),
    "a link": (False, lambda path: relink(path), "no picture of this view was left"),
    "removed": (True, Path.unlink, "was removed after it was rendered"),
    "replaced": (
        True,
        lambda path: write_image(path, np.ones((48, 72, 3))),
        "is another picture than was rendered; something wrote over it",
    ),
}


def relink(path):
    path.rename(path.with_suffix(".moved"))
    path.symlink_to(path.with_suffix(".moved"))


@pytest.mark.parametrize("kind", TAMPERED)
def test_a_picture_that_is_not_what_was_rendered_fails_its_view_alone(stage, tmp_path, kind):
    sealed, change, reason = TAMPERED[kind]
    answers = stage.linked(tmp_path)
    renders = answers.renders(entry("grey").label)
    for target in stage.targets:
        write_image(renders / f"{target.key}.png", np.full((48, 72, 3), 115, np.uint8))
    if not sealed:
        change(renders / "left/000001.png")
    stage.seal(renders, {"all-cameras": OK, "front-side": OK})
    if sealed:
        change(renders / "left/000001.png")
    rows = scored(answers, "grey")
    failed = rows["status"] == "failed"
    mine = (rows["target"] == "left") & (rows["frame"] == 1) & (rows["split"] == "observed")
    assert failed.equals(mine)
    assert rows[failed]["value"].isna().all()
    assert set(rows[failed]["stage"]) == {"render"}
    assert all(reason in text for text in rows[failed]["reason"])


def test_renders_of_an_earlier_version_are_named(stage, tmp_path):
    answers = stage.linked(tmp_path)
    outcomes = {"all-cameras": OK, "front-side": OK}
    write_json(answers.renders(entry("grey").label) / "render.json", outcomes)
    with pytest.raises(GeoEvsError, match=r"grey\.v\.seed4 does not say which pictures .* rerun$"):
        scored(answers, "grey")


def test_renders_of_other_sources_are_named(stage, tmp_path):
    answers = stage.linked(tmp_path)
    write_json(answers.renders(entry("grey").label) / "render.json", {"all-cameras": FAILED})
    with pytest.raises(GeoEvsError, match=r"render\.json has no outcome for front-side"):
        scored(answers, "grey")


@pytest.mark.parametrize("text", ["3", '[{"split": "observed"}]', "[1]", '{"a": 1}'])
def test_targets_of_the_wrong_shape_are_named(tmp_path, text):
    (tmp_path / "targets.json").write_text(text)
    with pytest.raises(GeoEvsError, match=r"targets\.json is no target list .*; delete it and"):
        read_targets(tmp_path / "targets.json")


def test_costs_by_hand(tmp_path):
    spent = {"fit_seconds": 2.0, "render_seconds": 0.5, "primitives": 3, "bytes": 7, "note": "n"}
    spent |= {"training_seconds": 120.0, "load_seconds": 1.5, "warm_up_seconds": 0.75}
    spent |= {"host": "a", "cpu": "EPYC"}
    outcomes = {"all-cameras": {**OK, **spent, "gpu_memory": 5}, "front-side": FAILED}
    who, answers = MethodEntry("m", "v", {}, 1), Answers(tmp_path, "d", "s")
    write_json(answers.renders(who.label) / "render.json", outcomes)
    rows = cost_frame(cost_rows(who, answers))
    fine, failed = rows.to_dict("records")
    assert fine == {
        **answers.place,
        **{"method": "m", "variant": "v", "seed": 1, "sources": "all-cameras"},
        **{"fit_seconds": 2.0, "render_seconds": 0.5, "peak_memory": 9, "gpu_memory": 5},
        **{"training_seconds": 120.0, "load_seconds": 1.5, "warm_up_seconds": 0.75},
        **{"primitives": 3, "parameters": 0, "bytes": 7, "device": "cuda", "threads": 2},
        **{"host": "a", "cpu": "EPYC"},
        **{"note": "n", "status": "ok", "stage": "", "reason": "", "log": ""},
    }
    assert (failed["status"], failed["reason"], failed["log"]) == ("failed", "no points", "fit.log")
    for part in ("fit", "training", "load", "warm_up", "render"):
        assert math.isnan(failed[f"{part}_seconds"])
    assert (failed["device"], failed["host"], failed["cpu"]) == ("cpu", "", "")

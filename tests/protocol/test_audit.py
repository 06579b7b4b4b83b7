"""The audit's rows, on the tiny scene whose truth is a closed form."""

import numpy as np
import pytest

from geoevs import layout
from geoevs.core.files import write_arrays
from geoevs.core.images import write_image
from geoevs.methods.tiny import tiny_truth
from geoevs.protocol import harm
from geoevs.protocol.audit import SHARES, SUPPORTS, TWINS, audit_rows
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.targets import write_targets

FINE = {"status": "ok", "stage": "", "reason": "", "log": "", "threads": 1}
FINE |= {"peak_memory": 0, "gpu_memory": 0}


@pytest.fixture(scope="module")
def rows(stage, tmp_path_factory):
    """Rows of a perfect method, of one that is 0.1 brighter, and of one that failed."""
    answers = stage.linked(tmp_path_factory.mktemp("run"), layout.TARGETS)
    targets = [t for t in stage.targets if t.split == "extrapolation" and t.frame == 0]
    write_targets(answers.path(layout.TARGETS), targets)
    depths = {n: tiny_truth(stage.store.camera(n, 0)).depth for n in stage.store.cameras}
    write_arrays(answers.path(layout.DEPTHS) / "000000.npz", depths)
    for method, status in (("perfect", "ok"), ("bright", "ok"), ("gone", "failed")):
        renders = answers.renders(method)
        for target in targets:
            picture = answers.truth(target) + 0.1 * (method == "bright")
            write_image(renders / f"{target.key}.png", picture)
        stage.seal(renders, {"all-cameras": {**FINE, "status": status}})
    entries = [MethodEntry(name) for name in ("perfect", "bright", "gone")]
    with pytest.MonkeyPatch.context() as patch:  # so that it is quick
        patch.setattr(harm, "HARMS", {"holes": (harm.holes, (0.1, 0.4))})
        return audit_rows(answers, entries, seed=0)


def test_every_metric_stands_beside_its_twin(rows):
    judged = rows[(rows["part"] == "agreement") & (rows["method"] == "bright")]
    assert set(judged["metric"]) <= set(TWINS)
    assert set(judged["share"]) == set(SHARES)
    assert judged[judged["metric"] == "sparse_psnr"]["dense"].to_numpy() == pytest.approx(
        20, abs=0.2
    )
    support = judged[judged["metric"] == "sparse_psnr"].groupby("share")["support_ratio"].mean()
    assert support[0.1] == pytest.approx(support[1.0] / 10, rel=0.1)
    assert "gone" not in set(rows["method"])


def test_support_alone_hardly_moves_psnr_but_inflates_zero_filled_ssim(rows):
    judged = rows[(rows["part"] == "random-support") & (rows["method"] == "bright")]
    bias = judged.assign(bias=judged["value"] - judged["dense"]).pivot_table(
        "bias", "metric", "share"
    )
    assert list(bias.columns) == sorted(SUPPORTS)
    assert bias[1.0].abs().max() < 1e-9
    assert abs(bias[0.05]["sparse_psnr"]) < 0.3
    assert bias[0.01]["sparse_ssim_zero_fill"] > abs(bias[0.2]["sparse_ssim"])


def test_wrong_pixels_are_few_and_cost_what_they_cost(rows):
    found = rows[rows["part"] == "reference"].groupby("metric")["value"].mean()
    assert 0 < found["pixel_wrong"] < 0.3
    assert found["footprint_leak"] <= found["pixel_leak"] <= found["pixel_wrong"]
    assert found["pixel_psnr_right"] > found["pixel_psnr"]


def test_photos_agree_with_what_other_cameras_coloured(rows):
    found = rows[(rows["part"] == "ceiling") & (rows["metric"] == "sparse_psnr")]
    assert set(found["target"]) == {"front", "left", "right"}
    assert (found["value"] > 25).all()  # the room is matt, its texture smooth
    assert (found["pixels"] > 0).all()


def test_a_method_that_reads_no_point_gains_nothing_by_them(rows):
    found = rows[rows["part"] == "conditioning"]
    bright = found[found["method"] == "bright"]
    assert np.abs(bright["value"] - bright["dense"]).max() < 0.5


def test_distances_under_harm_stand_beside_their_floor(rows):
    found = rows[rows["part"] == "harm"]
    assert "texture_energy" in set(found["metric"])
    for _, of_metric in found.groupby("metric"):
        assert of_metric["share"].tolist() == [0.1, 0.4]
        assert of_metric["value"].is_monotonic_increasing
        assert of_metric["dense"].nunique() == 1
        assert of_metric["value"].iloc[-1] > of_metric["dense"].iloc[-1]
    assert (found["target"] == "holes").all()
    assert (found["pixels"] == 6 * 48 * 72).all()

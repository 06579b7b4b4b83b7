import math
import sys

import numpy as np
import pandas as pd
import pytest

from geoevs.core.images import to_uint8, write_image
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.set_metrics import SET_METRICS, standardise, texture_features
from geoevs.protocol.set_scoring import SET_TYPES, DescribedViews, score_sets, set_frame

OK = {"status": "ok", "stage": "", "reason": "", "log": "", "threads": 1}
OK |= {"peak_memory": 0, "gpu_memory": 0}


@pytest.fixture(scope="module")
def run(stage, tmp_path_factory):
    """A run of the tiny scene: exact copies, flat greys, and one that failed from all cameras."""
    answers = stage.linked(tmp_path_factory.mktemp("run"))
    failed = {**OK, "status": "failed", "reason": "no points"}
    for label in ("copy", "grey.flat", "broken"):
        renders = answers.renders(label)
        outcome = failed if label == "broken" else OK
        for target in stage.targets:
            true = to_uint8(answers.truth(target))
            write_image(
                renders / f"{target.key}.png", true if label == "copy" else np.full_like(true, 128)
            )
        stage.seal(renders, {"all-cameras": outcome, "front-side": OK})
    return answers.run


@pytest.fixture
def scored(run):
    def of(label: str) -> pd.DataFrame:
        entry = MethodEntry.parse(label, {}, 0)
        return set_frame(score_sets(entry, run, "d", ["s"], 0.95)).set_index(["split", "metric"])

    return of


def test_copies_are_at_no_distance_and_greys_far(scored):
    copies, greys = scored("copy"), scored("grey.flat")
    assert list(copies.reset_index()[list(SET_TYPES)]) == list(SET_TYPES)
    for split in ("observed", "interpolation", "extrapolation"):
        exact, flat = (rows.loc[(split, "texture_energy")] for rows in (copies, greys))
        assert exact["value"] == pytest.approx(0.0, abs=1e-9)
        assert flat["value"] > 10
        if split != "interpolation":  # one view for each of two frames has no floor
            assert flat["value"] > 10 * abs(flat["floor"])
            assert exact["floor"] == flat["floor"]
        assert (flat["status"], flat["variant"]) == ("ok", "flat")
    assert "pose-sweep" not in copies.index.get_level_values(0)


def test_without_weights_rows_say_so(scored, monkeypatch):
    monkeypatch.setattr("geoevs.protocol.weights.find_spec", lambda name: None)
    row = scored("copy").loc[("observed", "fid")]
    assert row["status"] == "unavailable"
    assert math.isnan(row["value"])
    assert row["reason"].startswith("the package torch_fidelity is not installed (pip install")


def test_a_failed_method_is_rows_that_say_so(scored):
    rows = scored("broken")
    row = rows.loc[("observed", "texture_energy")]
    assert (row["status"], row["reason"], row["views"]) == ("failed", "no points", 0)
    assert row["failed"] > 0
    assert math.isnan(row["value"])
    assert rows.loc[("interpolation", "texture_energy"), "status"] == "ok"


def test_the_distance_is_that_of_all_images_at_once(stage, scored):
    answers = stage.answers
    views = [target for target in stage.targets if target.split == "observed"]
    true = np.array([texture_features(answers.truth(target)) for target in views])
    grey = np.full((*answers.truth(views[0]).shape[:2], 3), np.float32(128) / np.float32(255))
    flat = np.repeat(texture_features(grey)[None], len(views), axis=0)
    frames = np.array([f"s/{target.frame:06d}" for target in views])
    pair = standardise(flat, true), standardise(true, true)
    expected = SET_METRICS["texture_energy"].distance(*pair, frames, 0.95)
    row = scored("grey.flat").loc[("observed", "texture_energy")]
    assert (row["value"], row["low"], row["high"]) == pytest.approx(
        (expected.value, expected.low, expected.high), nan_ok=True, abs=0
    )


def test_no_image_is_kept():
    images = [np.full((16, 16, 3), value, np.float32) for value in (0.25, 0.75)]
    views = DescribedViews([texture_features])
    views.add("s/000000", *images)
    references = [sys.getrefcount(image) for image in images]
    views.add("s/000001", *images)
    assert [sys.getrefcount(image) for image in images] == references
    kept = np.array(views.features[texture_features])
    assert kept.shape == (2, 2, len(texture_features(images[0])))
    assert views.frames == ["s/000000", "s/000001"]

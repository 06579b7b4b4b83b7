import math
import sys
from functools import cache

import numpy as np
import pandas as pd
import pytest

from geoevs import layout
from geoevs.core.efficientnet_weights import PACKAGE, missing
from geoevs.core.images import to_uint8, write_image
from geoevs.protocol import learned_features
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.rows import score_frame
from geoevs.protocol.set_metrics import (
    SET_METRICS,
    efficientnet_features,
    standardise,
    texture_features,
)
from geoevs.protocol.set_scoring import (
    SET_SPLITS,
    SET_TYPES,
    DescribedViews,
    score_sets,
    set_frame,
    write_truth_features,
)
from geoevs.run import Answers

needs_weights = pytest.mark.skipif(bool(missing()), reason=missing())

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


@pytest.fixture(scope="module")
def rows_of(run, stage):
    """Both kinds of rows of an entrant, once for each."""
    protocol = {**stage.protocol, "reference_keep": [1.0]}

    @cache
    def of(label: str) -> tuple[pd.DataFrame, pd.DataFrame]:
        entry = MethodEntry.parse(label, {}, 0)
        sets, views = score_sets(entry, run, "d", ["s"], 0.95, protocol)
        return set_frame(sets).set_index(["split", "metric"]), score_frame(views)

    return of


@pytest.fixture
def scored(rows_of):
    return lambda label: rows_of(label)[0]


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


def test_without_weights_rows_say_so(rows_of, monkeypatch):
    for module in ("protocol.weights", "core.efficientnet_weights"):
        monkeypatch.setattr(f"geoevs.{module}.find_spec", lambda name: None)
    sets, views = rows_of.__wrapped__("copy")
    packages = {"fid": "torch_fidelity", "efficientnet_fd": PACKAGE, "efficientnet_kd": PACKAGE}
    for metric, package in packages.items():
        row = sets.loc[("observed", metric)]
        assert row["status"] == "unavailable"
        assert math.isnan(row["value"])
        assert row["reason"].startswith(f"the package {package} is not installed (pip install")
    assert sets.loc[("observed", "texture_energy"), "status"] == "ok"
    assert (views["status"] == "unavailable").all()
    assert views["value"].isna().all()
    assert views["reason"].str.startswith(f"the package {PACKAGE} is not installed (pip").all()


@needs_weights
def test_learned_distances_are_of_features_and_their_floor_of_instants(stage, scored):
    views = [target for target in stage.targets if target.split == "observed"]
    true = np.array([efficientnet_features(stage.answers.truth(target)) for target in views])
    grey = np.full((48, 72, 3), np.float32(128) / np.float32(255))
    flat = np.repeat(efficientnet_features(grey)[None], len(views), axis=0)
    even = np.array([target.frame == 0 for target in views])
    assert len(set(even)) == 2

    def kernel(a, b):
        return (a @ b / 1280 + 1) ** 3

    def u_statistic(x, y):
        pairs = [(i, j) for i in range(len(x)) for j in range(len(x)) if i != j]
        return np.mean(
            [
                kernel(x[i], x[j]) + kernel(y[i], y[j]) - kernel(x[i], y[j]) - kernel(x[j], y[i])
                for i, j in pairs
            ]
        )

    def frechet(x, y):
        # In the few directions that the pictures span, where covariances have square roots.
        together = np.concatenate([x, y]) - x.mean(axis=0)
        x, y = np.split(together @ np.linalg.svd(together, full_matrices=False)[2].T, 2)
        a, b = np.cov(x.T), np.cov(y.T)
        roots = np.sqrt(np.maximum(np.linalg.eigvals(a @ b).real, 0))
        mean = np.square(x.mean(axis=0) - y.mean(axis=0)).sum()
        return mean + np.trace(a + b) - 2 * roots.sum()

    rows = scored("grey.flat").loc["observed"]
    for metric, twin in (("efficientnet_kd", u_statistic), ("efficientnet_fd", frechet)):
        assert rows.loc[metric, "status"] == "ok"
        assert rows.loc[metric, "value"] == pytest.approx(twin(flat, true), rel=1e-4)
        assert rows.loc[metric, "floor"] == pytest.approx(twin(true[even], true[~even]), rel=1e-3)
        copy = scored("copy").loc[("observed", metric), "value"]
        assert copy == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(rows.loc["efficientnet_fd", "low"])


@needs_weights
def test_each_view_has_its_own_learned_distance(stage, rows_of):
    copies, greys = rows_of("copy")[1], rows_of("grey.flat")[1]
    assert set(greys["metric"]) == {"efficientnet_layers"}
    asked = [target for target in stage.targets if target.split in SET_SPLITS]
    found = list(greys[["frame", "target", "split"]].itertuples(index=False, name=None))
    assert found == [(target.frame, target.camera.name, target.split) for target in asked]
    assert (copies["value"] == 0).all()
    assert (greys["value"] > 1).all()
    assert (greys["status"] == "ok").all()
    assert (greys["valid_pixels"] == 48 * 72).all()
    assert greys["variant"].eq("flat").all()
    assert greys["fingerprint"].nunique() == 1
    broken = rows_of("broken")[1]
    failed = broken["split"] != "interpolation"
    assert (broken.loc[failed, "status"] == "failed").all()
    assert (broken.loc[failed, "reason"] == "no points").all()
    assert (broken.loc[~failed, "status"] == "ok").all()


@needs_weights
def test_true_pictures_are_seen_once_for_all_entrants(stage, run, rows_of, monkeypatch):
    answers = Answers(run, **stage.answers.place)
    write_truth_features(answers.path(layout.TRUTH_FEATURES), answers)
    before = [frame.reset_index() for frame in rows_of("grey.flat")]
    seen = []

    def compute(image, real=learned_features._computed):
        seen.append(image)
        return real(image)

    monkeypatch.setattr(learned_features, "_computed", compute)
    monkeypatch.setattr(learned_features, "_recent", {})
    again = [frame.reset_index() for frame in rows_of.__wrapped__("grey.flat")]
    assert len(seen) == 1  # the grey
    for frame, other in zip(before, again, strict=True):
        pd.testing.assert_frame_equal(frame, other)


def test_without_weights_no_features_are_kept(stage, tmp_path, monkeypatch):
    monkeypatch.setattr("geoevs.core.efficientnet_weights.find_spec", lambda name: None)
    write_truth_features(tmp_path / "kept", stage.answers)
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["pictures.json"]


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

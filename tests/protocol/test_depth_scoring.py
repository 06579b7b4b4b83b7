"""Depth scores of the tiny scene, whose depth is known exactly."""

import numpy as np
import pytest

from geoevs.geometry.depth_models import LidarDepth
from geoevs.methods.tiny import tiny_truth, write_tiny_scene
from geoevs.projection import zbuffer
from geoevs.protocol.depth_scoring import FARTHEST, Candidate, depth_scores
from geoevs.scenes.depths import write_depths
from geoevs.scenes.scene import Frame

PLACE = {"dataset": "d", "scene": "tiny-1"}


class Distorted:
    """Twice the true depth without LiDAR, exact with it; knows nothing in the top rows."""

    parameters = 7

    def depths(self, views, frame):
        factor = np.float32(1 if views.has("lidar") else 2)
        found = {name: tiny_truth(views.camera(name, frame)).depth for name in views.cameras}
        for depth in found.values():
            depth[:5] = 0
        return {name: factor * depth for name, depth in found.items()}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("scores") / "tiny")


def true_depths(scene, folder, change=lambda depth: depth):
    for number in scene.frames:
        cameras = {name: scene.camera(name, number) for name in scene.cameras}
        depths = {name: change(tiny_truth(camera).depth) for name, camera in cameras.items()}
        write_depths(folder, Frame(number, 0.0, cameras, {}, scene.points(number), depths))
    return folder


def values(rows, **where):
    for column, value in where.items():
        rows = rows[rows[column] == value]
    return rows.set_index(["frame", "camera"])["value"]


def test_dense_truth_scores_every_pixel_that_has_a_prediction(scene, tmp_path):
    candidates = [Candidate("mine", "pretrained", Distorted())]
    rows = depth_scores(scene, true_depths(scene, tmp_path), candidates, PLACE)
    # Two frames of three cameras, at two scales, in four metrics.
    assert len(rows) == 2 * 3 * 2 * 4
    assert values(rows, scale="none", metric="abs_rel").tolist() == [1.0] * 6
    assert values(rows, scale="none", metric="delta_1.25").tolist() == [0.0] * 6
    assert values(rows, scale="lidar", metric="rmse").tolist() == [0.0] * 6
    assert rows["truth"].unique().tolist() == ["dense"]
    # Five of 48 rows have no prediction: what is compared is the rest, and coverage says so.
    assert values(rows, metric="coverage").unique().tolist() == [43 / 48]
    counts = rows.groupby("metric")["valid_pixels"].unique().map(list).to_dict()
    assert counts.pop("coverage") == [48 * 72]
    assert list(counts.values()) == [[43 * 72]] * 3
    assert rows["parameters"].unique().tolist() == [7]
    assert (rows["seconds"] > 0).all()
    assert rows["seconds"].nunique() == 4  # one a frame and scale
    described = rows[["dataset", "scene", "model", "stage", "status"]].drop_duplicates()
    assert described.values.tolist() == [["d", "tiny-1", "mine", "pretrained", "ok"]]


def test_the_far_and_the_sky_do_not_count(scene, tmp_path):
    def change(depth):
        depth[40:] = 0
        depth[30:40] = FARTHEST + 0.1
        depth[20:30] = FARTHEST
        return depth

    candidates = [Candidate("mine", "pretrained", Distorted())]
    rows = depth_scores(scene, true_depths(scene, tmp_path, change), candidates, PLACE)
    assert values(rows, metric="coverage").unique().tolist() == [(30 - 5) / 30]
    assert rows.groupby("metric")["valid_pixels"].first()["abs_rel"] == (30 - 5) * 72


def test_without_dense_truth_the_scoring_lidar_is_truth(scene, tmp_path):
    candidates = [Candidate("mine", "fine-tuned", Distorted())]
    rows = depth_scores(scene, tmp_path, candidates, PLACE)
    assert rows["truth"].unique().tolist() == ["lidar"]
    counts = rows.drop_duplicates(["frame", "camera"]).set_index(["frame", "camera"])
    for number in scene.frames:
        points = scene.points(number)
        odd = points.xyz[points.beam % 2 == 1]
        for name in scene.cameras:
            seen = zbuffer(odd, scene.camera(name, number), visibility="footprint").mask[5:]
            assert counts.loc[(number, name), "valid_pixels"] == seen.sum() > 50
            every = zbuffer(odd, scene.camera(name, number), visibility="footprint").mask.sum()
            shares = values(rows, scale="none", metric="coverage")
            assert shares[number, name] == seen.sum() / every < 1
    # A point lies anywhere in its pixel, the truth is that of the centre.
    np.testing.assert_allclose(values(rows, scale="none", metric="abs_rel"), 1, atol=0.1)
    assert (values(rows, scale="lidar", metric="delta_1.25") > 0.95).all()


def test_completed_lidar_is_scored_at_its_own_scale_alone(scene, tmp_path):
    candidates = [Candidate("lidar", "control", LidarDepth())]
    rows = depth_scores(scene, true_depths(scene, tmp_path), candidates, PLACE)
    assert rows["scale"].unique().tolist() == ["lidar"]
    assert (values(rows, metric="abs_rel") < 0.1).all()
    assert (values(rows, metric="abs_rel") > 0).all()


def test_nothing_to_compare_is_a_row_that_says_so(scene, tmp_path):
    def nothing(depth):
        return np.zeros_like(depth)

    candidates = [Candidate("mine", "pretrained", Distorted())]
    rows = depth_scores(scene, true_depths(scene, tmp_path, nothing), candidates, PLACE)
    assert rows["status"].unique().tolist() == ["empty-mask"]
    assert rows["value"].isna().all()
    assert len(rows) == 48


def test_a_model_without_depth_covers_nothing(scene, tmp_path):
    class Blind(Distorted):
        def depths(self, views, frame):
            return {name: 0 * depth for name, depth in super().depths(views, frame).items()}

    candidates = [Candidate("mine", "pretrained", Blind())]
    rows = depth_scores(scene, true_depths(scene, tmp_path), candidates, PLACE)
    covered = rows["metric"] == "coverage"
    assert rows[covered]["value"].unique().tolist() == [0.0]
    assert rows[covered]["status"].unique().tolist() == ["ok"]
    assert rows[~covered]["value"].isna().all()
    assert rows[~covered]["status"].unique().tolist() == ["empty-mask"]

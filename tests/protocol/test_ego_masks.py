"""What the ego car hides counts in no colour, no condition and no score."""

import numpy as np
import pytest

from geoevs import layout
from geoevs.core.images import to_uint8, write_image
from geoevs.geometry.depth_models import LidarDepth, NetworkDepth
from geoevs.geometry.lifted import LiftedViews
from geoevs.methods.contract import Views
from geoevs.methods.tiny import HEIGHT, WIDTH, write_tiny_scene
from geoevs.projection import project_points
from geoevs.protocol.depth_scoring import COVERAGE, Candidate, depth_scores
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.scoring import score_method
from geoevs.protocol.set_scoring import score_sets
from geoevs.scenes.scene import SceneExtras

BONNET = np.zeros((HEIGHT, WIDTH), bool)
BONNET[36:, 10:60] = True
MASKS = SceneExtras({"front": BONNET, "left": BONNET[:, ::-1].copy()})
OK = {"status": "ok", "stage": "", "reason": "", "log": "", "threads": 1}
OK |= {"peak_memory": 0, "gpu_memory": 0}


@pytest.fixture(scope="module")
def masked(tmp_path_factory):
    """The tiny scene, whose front and left cameras see a bonnet."""
    return write_tiny_scene(tmp_path_factory.mktemp("masked") / "s", extras=MASKS)


class Flat(NetworkDepth):
    """Ten metres everywhere."""

    def predict(self, images, cameras):
        return np.full(images.shape[:3], 10.0, np.float32), None


def points_in(mask, points, camera):
    """(N,) bool: the points that lie in a pixel of the mask."""
    uv, _ = project_points(points.xyz, camera)
    inside = (
        np.isfinite(uv).all(axis=1) & (uv >= 0).all(axis=1) & (uv < (WIDTH, HEIGHT)).all(axis=1)
    )
    column, row = np.where(inside[:, None], uv, 0).astype(int).T
    return inside & mask[row, column]


def test_it_colours_no_point(masked, stage):
    front = masked.cameras.index("front")
    for frame in masked.frames:
        camera = masked.camera("front", frame)
        clean, points = stage.store.points(frame), masked.points(frame)
        hidden = points_in(BONNET, points, camera)
        assert (clean.camera[hidden] == front).any()
        assert not (points.camera[hidden] == front).any()
        seen = ~hidden & (clean.camera == front)
        np.testing.assert_array_equal(points.rgb[seen], clean.rgb[seen])


@pytest.mark.parametrize("model", [LidarDepth(), Flat()])
def test_it_is_in_no_condition(masked, model, tmp_path):
    views = Views(masked, masked.cameras, ("lidar",))
    lifted = LiftedViews.make(views, model)
    for depths in lifted.depths.values():
        for name, mask in MASKS.ego_masks.items():
            assert not depths[name][mask].any()
            assert depths[name][~mask].any()
        assert depths["right"].any()
    # A method that saves its views keeps the mask with them.
    views.save(tmp_path / "views")
    saved = Views.load(tmp_path / "views")
    np.testing.assert_array_equal(saved.without_ego("front", np.ones((HEIGHT, WIDTH))), ~BONNET)


def test_its_pixels_count_in_no_score(masked, stage, tmp_path):
    answers = stage.linked(tmp_path / "run", layout.SCENE)
    answers.path(layout.SCENE).parent.mkdir(parents=True)
    answers.path(layout.SCENE).symlink_to(masked.folder)
    rows = {}
    for label in ("clean", "painted"):
        renders = answers.renders(label)
        for target in answers.targets:
            image = to_uint8(answers.truth(target)) // 2
            mask = answers.ego_mask(target)
            assert (mask is None) == (target.recorded is False or "right" in target.key)
            if label == "painted" and mask is not None:
                image[mask] = (255, 0, 255)
            write_image(renders / f"{target.key}.png", image)
        stage.seal(renders, {"all-cameras": OK, "front-side": OK})
        entry = MethodEntry.parse(label, {}, 0)
        scores = score_method(entry, answers, [1.0, 0.5], "f")
        protocol = {**stage.protocol, "reference_keep": [1.0]}
        sets, views = score_sets(entry, answers.run, "d", ["s"], 0.95, protocol)
        rows[label] = [
            {name: value for name, value in row.items() if name != "method"}
            for row in (*scores, *sets, *views)
        ]
    assert len(rows["clean"]) > 50
    np.testing.assert_equal(rows["painted"], rows["clean"])
    whole = {row["target"]: row["valid_pixels"] for row in rows["clean"] if row.get("target")}
    assert whole["right"] == HEIGHT * WIDTH
    assert whole["front"] == HEIGHT * WIDTH - BONNET.sum()


def test_depth_is_not_scored_there(masked, stage):
    def coverage(scene):
        rows = depth_scores(
            scene, scene.folder / "none", [Candidate("flat", "s", Flat())], {}, lambda: None
        )
        shown = rows[(rows["metric"] == COVERAGE) & (rows["scale"] == "none")]
        return shown.set_index(["camera", "frame"])["valid_pixels"]

    Flat.parameters = 0
    clean, hidden = coverage(stage.store), coverage(masked)
    for frame in masked.frames:
        assert hidden["right", frame] == clean["right", frame]
        assert 0 < hidden["front", frame] < clean["front", frame]

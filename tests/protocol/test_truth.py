import numpy as np
import pytest

from geoevs import layout
from geoevs.core.files import read_arrays, read_json
from geoevs.core.images import read_image, to_uint8
from geoevs.methods.tiny import tiny_truth
from geoevs.protocol.truth import write_truth
from geoevs.scenes.scene import SceneRef


def test_truth_is_of_every_target_that_no_camera_recorded(stage):
    virtual = [t for t in stage.targets if t.split in ("extrapolation", "pose-sweep")]
    folder = stage.answers.path(layout.TRUTH)
    assert read_json(folder / "truth.json") == [target.key for target in virtual]
    assert len(list(folder.rglob("*.png"))) == len(virtual) == 2 * 4 + 4
    for target in virtual:
        rgb, depth = tiny_truth(target.camera)
        np.testing.assert_array_equal(read_image(folder / f"{target.key}.png"), rgb)
        np.testing.assert_array_equal(read_arrays(folder / f"{target.key}.npz")["depth"], depth)


def test_true_pixels_of_every_split(stage):
    expected = {
        "observed": lambda target: stage.store.image(target.camera.name, target.frame),
        "interpolation": lambda target: stage.store.image("front", target.frame),
        "extrapolation": lambda target: tiny_truth(target.camera).rgb / np.float32(255),
        "pose-sweep": lambda target: tiny_truth(target.camera).rgb / np.float32(255),
    }
    for target in [target for target in stage.targets if not target.masked]:
        found = stage.answers.truth(target)
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, expected[target.split](target))


class NoTruth:
    has_truth = False


class TooFew:
    has_truth = True

    def truth(self, scene, views):
        return [tiny_truth(camera) for camera, _ in views[1:]]


def test_a_source_without_truth_leaves_an_empty_list(stage, tmp_path):
    steps = []
    advance = lambda: steps.append(1)  # noqa: E731
    answers = stage.linked(tmp_path, layout.TRUTH)
    folder = answers.path(layout.TRUTH)
    write_truth(folder, NoTruth(), SceneRef("tiny"), stage.targets, advance)
    assert [path.name for path in folder.iterdir()] == ["truth.json"]
    assert read_json(folder / "truth.json") == []
    assert steps == []
    virtual = next(target for target in stage.targets if not target.recorded)
    assert answers.truth(virtual) is answers.depth(virtual) is None


def test_a_source_that_renders_too_few_leaves_nothing(stage, tmp_path):
    with pytest.raises(ValueError, match="shorter"):
        write_truth(tmp_path / "truth", TooFew(), SceneRef("tiny"), stage.targets, lambda: None)
    assert list(tmp_path.iterdir()) == []


def test_truth_has_8_bits(stage):
    virtual = next(target for target in stage.targets if not target.recorded)
    found = stage.answers.truth(virtual)
    np.testing.assert_array_equal(to_uint8(found) / np.float32(255), found)

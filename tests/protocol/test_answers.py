"""A scene's answers, opened under a run's folder."""

import re

import numpy as np
import pytest

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import tiny_truth
from geoevs.protocol.records import write_records
from geoevs.run import Answers


def test_nothing_is_opened_before_it_is_asked_for(stage, tmp_path):
    nowhere = Answers(tmp_path, "d", "s")
    assert nowhere.renders("geo-evs.v1") == tmp_path / "renders/d/s/geo-evs.v1"
    virtual = next(target for target in stage.targets if not target.recorded)
    files = {
        "scenes/d/s/scene.json": lambda: nowhere.scene,
        "targets/d/s.json": lambda: nowhere.targets,
        "references/d/s.npz": lambda: nowhere.reference(virtual),
        "masks/d/s.npz": lambda: nowhere.mask(virtual),
    }
    for file, ask in files.items():
        with pytest.raises(GeoEvsError, match=f"^{re.escape(str(tmp_path / file))} is missing"):
            ask()


def test_masked_targets_share_reference_truth_and_depth_with_their_view(stage):
    for target in stage.targets:
        reference = stage.answers.reference(target)
        assert (reference is None) == target.recorded
        if not target.recorded:
            shared = stage.answers.reference(target.unmasked)
            np.testing.assert_array_equal(reference.pixels, shared.pixels)
            truth = tiny_truth(target.camera)
            np.testing.assert_array_equal(stage.answers.depth(target), truth.depth)
            np.testing.assert_array_equal(stage.answers.truth(target) * 255, truth.rgb)


def test_a_targets_regions_are_those_of_its_kind(stage, tmp_path):
    def names(target):
        return {name.partition("-")[2] for name in stage.answers.regions(target)}

    virtual = {"", "new", "footprint", "supported"}
    masked = {"", "supported", "removed", "never", "unsupported"}
    for target in stage.targets:
        expected = {""} if target.recorded else virtual
        assert names(target) == (masked if target.masked else expected)
    # Not one of them needs the masks but those of masked targets.
    answers = stage.linked(tmp_path, layout.MASKS)
    write_records(answers.path(layout.MASKS), {})
    for target in stage.targets:
        if target.masked:
            with pytest.raises(GeoEvsError, match=r"masks/d/s\.npz is not whole"):
                answers.regions(target)
        else:
            assert answers.regions(target)

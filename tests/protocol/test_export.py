import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.protocol.export import export_views
from geoevs.protocol.targets import FRONT_SIDE, read_targets
from geoevs.scenes.store import Scene


def test_what_may_be_seen_is_exported_with_the_views_to_render(stage, tmp_path):
    export_views(tmp_path / "out", stage.store, stage.targets, "all-cameras")
    scene = Scene(tmp_path / "out/scene")
    assert scene.cameras == stage.store.cameras
    assert len(scene.tracks) == len(stage.store.tracks)
    points = scene.points(0)
    assert len(points) > 0
    assert not scene.info.rig.scores(points).any()
    views = read_targets(tmp_path / "out/cameras.json")
    assert {view.split for view in views} == {"observed", "extrapolation", "pose-sweep"}
    assert [view.key for view in views] == [
        target.key
        for target in stage.targets
        if target.sources == "all-cameras" and not target.masked
    ]


def test_interpolation_shows_the_sides_alone(stage, tmp_path):
    export_views(tmp_path / "out", stage.store, stage.targets, FRONT_SIDE)
    assert Scene(tmp_path / "out/scene").cameras == ("left", "right")
    views = read_targets(tmp_path / "out/cameras.json")
    assert {view.split for view in views} == {"interpolation"}


def test_unknown_sources_leave_nothing(stage, tmp_path):
    with pytest.raises(GeoEvsError, match="no set of sources 'front'; did you mean 'front-side'"):
        export_views(tmp_path / "out", stage.store, stage.targets, "front")
    assert list(tmp_path.iterdir()) == []

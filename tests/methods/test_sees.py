"""What a method sees of the recorded pictures, and that nothing else reaches it."""

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.check import check_adapter
from geoevs.methods.contract import Views
from geoevs.methods.tiny import with_hidden_black, write_tiny_scene
from geoevs.scenes.scene import SceneExtras
from geoevs.scenes.store import Scene


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("sees") / "scene")


def views(scene: Scene, sees: str, *needs: str) -> Views:
    return Views(scene, scene.cameras, needs, sees)


def test_hidden_pictures_are_refused(tiny):
    assert views(tiny, "views").image("left", 1).any()
    assert views(tiny, "first-frame").image("left", 0).any()
    for sees, frame in (("first-frame", 1), ("layout", 0), ("layout", 1)):
        with pytest.raises(GeoEvsError, match=f"in frame {frame}, but sees '{sees}'; leave it"):
            views(tiny, sees).image("left", frame)


@pytest.mark.parametrize("sees", ["first-frame", "layout"])
def test_the_colours_of_lidar_are_pixels(tiny, sees):
    assert len(views(tiny, "views", "lidar").lidar(0))
    with pytest.raises(GeoEvsError, match=f"LiDAR, whose colours are pixels, but sees '{sees}'"):
        views(tiny, sees, "lidar").lidar(0)


def test_the_map_is_a_need_and_tags_are_none(tiny):
    blind = views(tiny, "layout")
    assert blind.tags == ("room",)
    with pytest.raises(GeoEvsError, match="add 'map' to MethodInfo"):
        _ = blind.road_map
    road_map = views(tiny, "layout", "map").road_map
    np.testing.assert_array_equal(
        road_map.at(np.array([[0.0, 0.05], [0, -1], [0, 5], [0, 9]])),
        [[1, 1, 0, 0], [1, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]],
    )
    bare = write_tiny_scene(tiny.folder.parent / "bare", extras=SceneExtras())
    assert views(bare, "layout", "map").road_map is None


def test_a_saved_layout_holds_no_image(tiny, tmp_path):
    views(tiny, "layout", "map", "tracks").save(tmp_path / "saved")
    assert not [*(tmp_path / "saved").rglob("*.png")]
    loaded = Views.load(tmp_path / "saved")
    assert len(loaded.road_map.polygons) == 4
    assert len(loaded.tracks) == len(tiny.tracks)
    assert loaded.tags == ("room",)
    np.testing.assert_array_equal(loaded.camera("left", 1).K, tiny.camera("left", 1).K)
    assert len(loaded.lidar(1)) == 0
    with pytest.raises(GeoEvsError, match="has no image of camera 'left' in frame 1; it was saved"):
        loaded.image("left", 1)


def test_saved_views_hold_what_is_seen_and_declared(tiny, tmp_path):
    views(tiny, "first-frame").save(tmp_path / "saved")
    found = {path.name for path in (tmp_path / "saved").rglob("*.png")}
    assert found == {"000000.png"}
    loaded = Views.load(tmp_path / "saved")
    np.testing.assert_array_equal(loaded.image("left", 0), tiny.image("left", 0))
    assert loaded.road_map is None


def test_the_copy_for_the_leak_check_is_black_where_it_must_be(tiny, tmp_path):
    for sees, seen in (("layout", [False, False]), ("first-frame", [True, False])):
        dark = with_hidden_black(tiny, tmp_path / sees, sees)
        assert [dark.image("front", frame).any() for frame in dark.frames] == seen
        assert not dark.points(0).rgb.any()
        np.testing.assert_array_equal(dark.points(0).xyz, tiny.points(0).xyz)
        assert len(dark.road_map.polygons) == 4
        assert dark.stamp == tiny.stamp  # all but pixels is the same


LAYOUT = """
import numpy as np
from dataclasses import dataclass, field
from geoevs.methods.contract import FitReport, MethodInfo, Rendering, Views

@dataclass
class Method:
    info = MethodInfo("Layout", "diffusion", needs=("map", "tracks"), sees="layout")
    views: Views = field(init=False)
    colour: float = 0.0

    def fit(self, views, budget, rng):
        self.views = views
        self.colour = float(len(views.road_map.polygons) + len(views.tracks)) / 10
        return FitReport()

    def render(self, camera, frame):
        rgb = np.full((camera.height, camera.width, 3), self.colour)
        return Rendering(rgb)

    def render_together(self, cameras, frame):
        return [self.render(camera, frame) for camera in cameras]

    def save(self, folder):
        self.views.save(folder / "views")
        (folder / "colour.txt").write_text(repr(self.colour))

    @classmethod
    def load(cls, folder):
        method = cls()
        method.views = Views.load(folder / "views")
        method.colour = float((folder / "colour.txt").read_text())
        return method
"""
FIRST = ('needs=("map", "tracks"), sees="layout"', 'needs=("map", "tracks"), sees="first-frame"')
FIT = "        return FitReport()"
PEEKS = {
    "past the views": [(FIT, "        self.colour = float(views._scene.image('left', 0).mean())")],
    "in the folder": [
        (FIT, "        self.colour = views._scene.image_path('left', 0).stat().st_size / 1e9")
    ],
    "at coloured points": [(FIT, "        self.colour = float(views._scene.points(0).rgb.mean())")],
    "at a later frame": [
        FIRST,
        (FIT, "        self.colour = float(views._scene.image('left', 1).mean())"),
    ],
}


def changed(*changes) -> str:
    text = LAYOUT
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, f"{new}\n{FIT}" if old == FIT else new)
    return text


def statuses(name: str) -> dict[str, str]:
    return {check.name: check.status for check in check_adapter(name, {})}


def test_a_method_of_layouts_passes(adapter):
    assert set(statuses(adapter(LAYOUT)).values()) == {"passed"}


def test_a_method_may_use_what_it_sees(adapter):
    uses = (FIT, "        self.colour = float(views.image('left', 0).mean())")
    assert set(statuses(adapter(changed(FIRST, uses))).values()) == {"passed"}


@pytest.mark.parametrize("how", PEEKS)
def test_a_method_that_peeks_is_found(adapter, how):
    found = {check.name: check for check in check_adapter(adapter(changed(*PEEKS[how])), {})}
    assert {name for name, check in found.items() if check.status != "passed"} == {
        "hidden pictures"
    }
    sentence = found["hidden pictures"].sentence
    assert "are black, the rgb differs; read a scene through Views alone" in sentence


BROKEN = {
    "no such sight": (('sees="layout"', 'sees="all"'), "info", "make it one of views, first-frame"),
    "no such split": (
        ('sees="layout"', 'sees="layout", splits=("observd",)'),
        "info",
        "make it a tuple of observed",
    ),
    "splits are no tuple": (
        ('sees="layout"', 'sees="layout", splits="observed"'),
        "info",
        "make it a tuple of observed",
    ),
    "coloured points": (('("map", "tracks")', '("map", "lidar")'), "info", "needs has lidar"),
    "an image": ((FIT, "        views.image('left', 1)"), "fit", "but sees 'layout'"),
    "an undeclared map": (('("map", "tracks")', '("tracks",)'), "fit", "add 'map'"),
    "one view too few": (
        ("for camera in cameras]", "for camera in cameras[1:]]"),
        "joint views",
        "render_together returned 1 renderings of 2 cameras",
    ),
    "no list of views": (
        ("return [self.render(camera, frame) for camera in cameras]", "return None"),
        "joint views",
        "render_together returned NoneType",
    ),
    "a view of another size": (
        ("[self.render(camera, frame) for camera in cameras]", "[Rendering(np.zeros(3))] * 2"),
        "joint views",
        "rgb has shape",
    ),
    "joint noise": (
        (
            "[self.render(camera, frame) for camera in cameras]",
            "2 * [Rendering(np.random.rand(48, 72, 3))]",
        ),
        "determinism",
        "rgb of views rendered together",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_each_broken_method_fails_its_check(adapter, kind):
    change, check, sentence = BROKEN[kind]
    found = {check.name: check for check in check_adapter(adapter(changed(change)), {})}
    assert found[check].status == "failed"
    assert sentence in found[check].sentence

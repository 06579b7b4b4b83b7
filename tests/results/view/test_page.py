"""The page without a browser, through viser's own server."""

import queue
import re
import socket
import sys
import urllib.request
from types import SimpleNamespace

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.contract import Rendering
from geoevs.methods.tiny import write_tiny_scene
from geoevs.results.view import page as viewing


class Saved:
    """A scene of a run whose entrants draw one grey, one of which cannot be opened."""

    dataset, name = "d", "s"
    entrants = ("fast", "gone", "slow")

    def __init__(self, scene):
        self._scene, self.opened = scene, []

    def scene(self):
        return self._scene

    def with_part(self, name):
        assert name == "splats"
        return ["fast"]

    def load(self, label):
        self.opened.append(label)
        if label == "gone":
            raise GeoEvsError("gone cannot be opened")
        return self

    def render(self, camera, frame):
        return Rendering(np.full((camera.height, camera.width, 3), 51 * (frame + 1), np.uint8))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    return Saved(write_tiny_scene(tmp_path_factory.mktemp("page") / "tiny"))


@pytest.fixture
def port():
    with socket.socket() as free:
        free.bind((viewing.HOST, 0))
        return free.getsockname()[1]


class Watched(viewing.Page):
    """A page whose pictures can be waited for."""

    def __init__(self, saved, port):
        self.seen = queue.Queue()
        super().__init__(saved, port)

    def _show(self, picture):
        super()._show(picture)
        self.seen.put(picture.label)

    def wait(self):
        return self.seen.get(timeout=20)


@pytest.fixture
def page(saved, port):
    pytest.importorskip("viser", reason="viser, the extra `view`, is not installed")
    with Watched(saved, port) as page:
        assert page.wait() == "fast"
        yield page


def test_it_is_served_on_this_machine_alone_and_draws_before_a_browser_comes(page, port):
    assert page.address == f"http://127.0.0.1:{port}"
    assert page.server.get_host() == "127.0.0.1"
    with urllib.request.urlopen(page.address, timeout=20) as answer:
        assert b"<html" in answer.read()
    assert (page.images["fast"].image == 51).all()
    assert re.fullmatch(r"fast: \d+ ms", page.images["fast"].label)
    assert [label for label, image in page.images.items() if image.visible] == ["fast"]


def test_pictures_follow_the_camera_and_the_frame(page):
    moved = []
    page._follow(SimpleNamespace(camera=SimpleNamespace(on_update=moved.append)))
    view = {"wxyz": np.array([1.0, 0, 0, 0]), "position": np.zeros(3), "fov": 1.0, "aspect": 2.0}
    moved[0](SimpleNamespace(**view))
    assert page.wait() == "fast"
    assert page.images["fast"].image.shape == (48, 96, 3)  # as high as the scene's pictures
    moved[0](SimpleNamespace(**{**view, "position": np.array([0, 0, 2e4])}))  # beyond the world
    places = [thing.position[0] for thing in page.drawn[:3]]
    page.frame.value = 1
    assert page.wait() == "fast"
    assert (page.images["fast"].image == 102).all()
    # The cameras of the next frame, half a metre on.
    assert [thing.position[0] - 0.5 for thing in page.drawn[:3]] == pytest.approx(places)


def test_others_are_drawn_when_they_are_shown_and_say_why_not(page, saved):
    page.shown["slow"].value = True
    assert [page.wait(), page.wait()] == ["fast", "slow"]
    page.shown["gone"].value = True
    assert [page.wait() for _ in range(3)] == ["fast", "gone", "slow"]
    assert page.images["gone"].label == "gone: gone cannot be opened"
    assert all(image.visible for image in page.images.values())
    assert saved.opened.count("slow") == 1
    page.shown["fast"].value, page.behind.value = False, "nothing"
    assert not page.images["fast"].visible


def test_what_was_recorded_can_be_shown_and_hidden(page):
    names = [thing.name for thing in page.drawn]
    assert names == ["/cameras/front", "/cameras/left", "/cameras/right", "/boxes"]
    page.recorded["lidar"].value = page.recorded["map"].value = True
    page.recorded["cameras"].value = page.recorded["boxes"].value = False
    assert sorted(thing.name for thing in page.drawn) == ["/lidar", "/map"]


def test_a_port_in_use_is_one_sentence(saved, port):
    pytest.importorskip("viser", reason="viser, the extra `view`, is not installed")
    with socket.create_server((viewing.HOST, port)):
        words = f"^port {port} of this machine is in use or not allowed; choose another by --port$"
        with pytest.raises(GeoEvsError, match=words):
            viewing.Page(saved, port)


def test_without_viser_it_says_what_to_install(saved, port, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(GeoEvsError, match=r"needs viser, .* run `pip install 'viser>=1.1,<2'`"):
        viewing.Page(saved, port)


def test_a_run_that_is_none_is_one_sentence(geoevs, tmp_path):
    code, text, errors = geoevs("view", tmp_path / "no", "s")
    assert (code, text) == (1, "")
    assert errors == f"error: {tmp_path}/no is no run's folder; name a run, or give its path\n"

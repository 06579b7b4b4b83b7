"""Which entrants are drawn when, without a browser and without viser."""

import queue
import threading

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.contract import Rendering
from geoevs.methods.tiny import MOUNT, tiny_camera
from geoevs.results.view.live import LivePictures, Pose

CAMERA = tiny_camera("free", 0.0, MOUNT)


class Grey:
    """An entrant that draws its frame's grey; it may wait for a signal, or fail."""

    def __init__(self, gate=None, error=None):
        self.gate, self.error, self.began = gate, error, threading.Event()

    def render(self, camera, frame):
        self.began.set()
        if self.gate is not None:
            assert self.gate.wait(10)
        if self.error is not None:
            raise self.error
        return Rendering(np.full((camera.height, camera.width, 3), frame / 10))


@pytest.fixture
def start():
    """Makes live pictures of entrants, and the queue of what they show."""
    started = []

    def make(entrants, quick):
        shown = queue.Queue()
        live = LivePictures(lambda label: entrants[label](), quick, shown.put)
        started.append(live)
        return live, lambda: shown.get(timeout=10)

    yield make
    for live in started:
        live.close()


def test_quick_ones_come_first_and_then_the_others(start):
    live, shown = start({"slow": Grey, "fast": Grey, "unasked": Grey}, ["fast"])
    live.ask(Pose(CAMERA, 4), ["slow", "fast"])
    first, second = shown(), shown()
    assert (first.label, second.label) == ("fast", "slow")
    assert first.rgb.shape == (CAMERA.height, CAMERA.width, 3)
    assert (first.rgb == 102).all()  # 0.4 of 255


def test_slow_ones_of_an_old_pose_are_left_out(start):
    gate = threading.Event()
    slow, fast = Grey(gate), Grey()
    live, shown = start({"slow": lambda: slow, "fast": lambda: fast, "last": Grey}, ["fast"])
    live.ask(Pose(CAMERA, 1), ["fast", "slow", "last"])
    assert slow.began.wait(10)
    live.ask(Pose(CAMERA, 2), ["fast"])
    live.ask(Pose(CAMERA, 3), ["fast"])
    gate.set()
    seen = [shown() for _ in range(3)]
    assert [picture.label for picture in seen] == ["fast", "slow", "fast"]
    assert [int(picture.rgb[0, 0, 0]) for picture in seen] == [26, 26, 76]  # frames 1, 1, 3


@pytest.mark.parametrize("error", [ValueError("of shape"), SystemExit("of shape")])
def test_what_a_method_raises_is_a_reason(start, error):
    live, shown = start({"broken": lambda: Grey(error=error), "fine": Grey}, ["broken", "fine"])
    live.ask(Pose(CAMERA, 1), ["broken", "fine"])
    broken = shown()
    assert (broken.rgb, broken.reason) == (None, f"{type(error).__name__}: of shape")
    assert shown().label == "fine"


def test_an_entrant_is_opened_once_even_if_it_cannot_be(start):
    opened = []

    def refuse():
        opened.append(1)
        raise GeoEvsError("gone")

    live, shown = start({"gone": refuse}, ["gone"])
    for frame in (1, 2):
        live.ask(Pose(CAMERA, frame), ["gone"])
        assert shown().reason == "gone"
    assert opened == [1]

"""Pictures by several entrants of a pose that changes: quick ones at once, others when it rests."""

import threading
import time
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np

from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.images import to_uint8
from geoevs.methods.contract import Adapter
from geoevs.methods.returned import checked_rgb
from geoevs.scenes.camera import Camera

REST = 0.3
"""Seconds without another pose after which the camera counts as released."""


class Pose(NamedTuple):
    """What is asked for: a view and a moment."""

    camera: Camera
    frame: int


class Picture(NamedTuple):
    """What an entrant made of a pose in how many seconds, or the reason why it made nothing."""

    label: str
    rgb: np.ndarray | None  # [H, W, 3] uint8
    seconds: float
    reason: str = ""


class LivePictures:
    """Renders the newest pose that was asked for, in a thread of its own.

    All entrants are opened and drawn by that thread alone, one after the other, each opened when it
    is first asked for.

    Args:
        load: opens an entrant.
        quick: the entrants that are drawn at every pose; others wait until the pose rests.
        show: is given each picture.
    """

    def __init__(
        self,
        load: Callable[[str], Adapter],
        quick: Collection[str],
        show: Callable[[Picture], None],
    ) -> None:
        self._load, self._quick, self._show = load, quick, show
        self._opened: dict[str, Adapter | GeoEvsError] = {}
        self._changed = threading.Condition()
        self._asked: tuple[Pose, Sequence[str]] | None = None
        self._number, self._closed = 0, False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def ask(self, pose: Pose, labels: Sequence[str]) -> None:
        """Have a pose drawn by these entrants; what is not begun of an earlier one is left out."""
        with self._changed:
            self._asked = pose, tuple(labels)
            self._number += 1
            self._changed.notify()

    def close(self) -> None:
        """End the thread after the picture that it draws."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _work(self) -> None:
        done = 0
        while self._changes(done, None):
            with self._changed:
                done, asked = self._number, self._asked
            if self._closed or asked is None:
                return
            pose, labels = asked
            for label in (label for label in labels if label in self._quick):
                self._show(self._picture(label, pose))
            rest = REST
            for label in (label for label in labels if label not in self._quick):
                if self._changes(done, rest):
                    break
                self._show(self._picture(label, pose))
                rest = 0.0

    def _changes(self, done: int, seconds: float | None) -> bool:
        """Whether something else than `done` is asked for within some time; None: in the end."""
        with self._changed:
            return self._changed.wait_for(lambda: self._closed or self._number != done, seconds)

    def _picture(self, label: str, pose: Pose) -> Picture:
        try:
            adapter = self._adapter(label)
            begin = time.perf_counter()
            rendering = adapter.render(pose.camera, pose.frame)
            seconds = time.perf_counter() - begin
            return Picture(label, to_uint8(checked_rgb(rendering, pose.camera)), seconds)
        except (Exception, SystemExit) as error:  # a method may raise anything
            return Picture(label, None, 0.0, reason_of(error))

    def _adapter(self, label: str) -> Adapter:
        if label not in self._opened:
            try:
                self._opened[label] = self._load(label)
            except GeoEvsError as error:  # it would fail at every pose
                self._opened[label] = error
        adapter = self._opened[label]
        if isinstance(adapter, GeoEvsError):
            raise adapter
        return adapter

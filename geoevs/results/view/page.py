"""The page that `geoevs view` serves: viser's, on this machine alone."""

import threading
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.images import to_uint8
from geoevs.core.text import clean
from geoevs.protocol.saved import SavedScene
from geoevs.results.view.live import LivePictures, Picture, Pose
from geoevs.results.view.recorded import box_lines, free_camera, lidar, map_lines, vertical_fov

if TYPE_CHECKING:
    import viser

HOST = "127.0.0.1"
"""Nobody but users of this machine can open the page, or those who come through SSH."""

RECORDED = ("cameras", "lidar", "boxes", "map")
NOTHING = "nothing"

FRUSTUM, POINT = 0.6, 0.05
"""Metres: a frustum's length, a point's width."""

LINE = {"thickness": 2.0, "thickness_units": "screen"}
"""Lines have two pixels of the window, however far they are."""

LOOK = 10.0
"""Metres ahead of the first camera, about which the view turns."""

LONGEST_REASON = 200


def import_viser() -> ModuleType:
    """The viewer's library.

    Raises:
        GeoEvsError: it is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise GeoEvsError(
            "`geoevs view` needs viser, which is not installed; run `pip install 'viser>=1.1,<2'`"
        ) from error
    return viser


class Page:
    """A server of one scene: what was recorded, and pictures by entrants of the browser's pose.

    The pose is that of the browser that moved last. Entrants of Gaussians follow it, others are
    drawn when it rests. Texts of methods are shown in labels, which are no markup.

    Args:
        saved: the run's scene.
        port: of this machine.

    Raises:
        GeoEvsError: there is no viser, or the port cannot be had, or the scene cannot be read.
    """

    def __init__(self, saved: SavedScene, port: int) -> None:
        viser = import_viser()
        self._scene = saved.scene()
        self._front = self._scene.info.rig.front
        first = self._scene.camera(self._front, self._scene.frames[0])
        self._pose = Pose(first, self._scene.frames[0])
        self._changing = threading.Lock()
        self.drawn: list[viser.SceneNodeHandle] = []
        title = f"{saved.dataset}/{saved.name}"
        self.server: viser.ViserServer = viser.ViserServer(HOST, port, title, verbose=False)
        if self.server.get_port() != port:  # viser goes on to the next that is free
            self.server.stop()
            raise GeoEvsError(
                f"port {port} of this machine is in use or not allowed; choose another by --port"
            )
        self._start_at(first)
        quick = saved.with_part("splats")
        self._controls(saved.entrants, quick or saved.entrants[:1])
        self._show_recorded()
        self._pictures = LivePictures(saved.load, quick, self._show)
        self.server.on_client_connect(self._follow)
        self._ask()  # before there is a browser: entrants are opened and compiled by then

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        return f"http://{HOST}:{self.server.get_port()}"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pictures.close()
        self.server.stop()

    def _start_at(self, camera: Any) -> None:
        self.server.scene.set_up_direction("+z")
        start = self.server.initial_camera
        start.position = camera.centre
        start.look_at = camera.centre + LOOK * camera.optical_axis
        start.fov = vertical_fov(camera)

    def _controls(self, entrants: list[str], shown: list[str]) -> None:
        """The panel: the frame, what is drawn of what was recorded, and a picture by entrant."""
        gui, frames = self.server.gui, self._scene.frames
        gui.configure_theme(control_width="large", show_share_button=False, show_logo=False)
        self.frame = gui.add_slider("frame", 0, len(frames) - 1 or 1, 1, 0)
        self.frame.disabled = len(frames) == 1
        self.recorded = {
            name: gui.add_checkbox(name, name in ("cameras", "boxes")) for name in RECORDED
        }
        self.behind = gui.add_dropdown("window", [NOTHING, *entrants], initial_value=shown[0])
        empty = np.full((self._pose.camera.height, self._pose.camera.width, 3), 128, np.uint8)
        self.images = {
            label: gui.add_image(empty, label=label, visible=label in shown) for label in entrants
        }
        with gui.add_folder("entrants"):
            self.shown = {label: gui.add_checkbox(label, label in shown) for label in entrants}
        self.frame.on_update(lambda _: self._to_frame())
        for box in self.recorded.values():
            box.on_update(lambda _: self._show_recorded())
        for box in (*self.shown.values(), self.behind):
            box.on_update(lambda _: self._ask())

    def _follow(self, client: "viser.ClientHandle") -> None:
        """Draw what a browser sees, from now on."""

        @client.camera.on_update
        def _(camera: "viser.CameraHandle") -> None:
            height = self._scene.camera(self._front, self._pose.frame).height
            view = camera.wxyz, camera.position, camera.fov, camera.aspect
            try:
                self._pose = Pose(free_camera(*view, height), self._pose.frame)
            except GeoEvsError:  # beyond the world; the last picture stays
                return
            self._ask()

    def _to_frame(self) -> None:
        self._pose = self._pose._replace(frame=self._scene.frames[int(self.frame.value)])
        self._show_recorded()
        self._ask()

    def _ask(self) -> None:
        """Have the pose drawn by all entrants that are shown."""
        behind = self.behind.value
        for label, box in self.shown.items():
            self.images[label].visible = box.value
        if behind == NOTHING:
            self.server.scene.set_background_image(None)
        labels = [label for label, box in self.shown.items() if box.value or label == behind]
        self._pictures.ask(self._pose, labels)

    def _show(self, picture: Picture) -> None:
        """Put a picture into the panel, and behind the scene if it is to be there."""
        image = self.images[picture.label]
        if picture.rgb is None:
            image.label = clean(f"{picture.label}: {picture.reason}", LONGEST_REASON)
            return
        image.image = picture.rgb
        image.label = f"{picture.label}: {1000 * picture.seconds:.0f} ms"
        if picture.label == self.behind.value:
            self.server.scene.set_background_image(picture.rgb)

    def _show_recorded(self) -> None:
        """Draw what was recorded in the frame, as far as it is to be shown."""
        scene, frame, draw = self._scene, self._pose.frame, self.server.scene
        asked = [name for name, box in self.recorded.items() if box.value]
        with self._changing, self.server.atomic():
            for thing in self.drawn:
                thing.remove()
            self.drawn = []
            if "cameras" in asked:
                self.drawn += [self._frustum(name, frame) for name in scene.cameras]
            if "lidar" in asked:
                points = lidar(scene, frame)
                self.drawn.append(draw.add_point_cloud("lidar", *points, point_size=POINT))
            lines = {"boxes": lambda: box_lines(scene, frame), "map": lambda: map_lines(scene)}
            for name in lines.keys() & set(asked):
                self.drawn.append(draw.add_line_segments(name, *lines[name](), **LINE))

    def _frustum(self, name: str, frame: int) -> "viser.CameraFrustumHandle":
        from scipy.spatial.transform import Rotation  # slow to import

        camera = self._scene.camera(name, frame)
        xyzw = Rotation.from_matrix(camera.world_from_camera[:3, :3]).as_quat()
        return self.server.scene.add_camera_frustum(
            f"cameras/{name}",
            vertical_fov(camera),
            camera.width / camera.height,
            scale=FRUSTUM,
            **LINE,
            image=to_uint8(self._scene.image(name, frame)),
            wxyz=np.roll(xyzw, 1),
            position=camera.centre,
        )

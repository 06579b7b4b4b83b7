"""The `street` data source: procedural streets with dense truth at any pose and instant."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.randomness import keyed_rng
from geoevs.core.settings import Positive, Within
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import Frame, SceneExtras, SceneInfo, SceneRecord, SceneRef, Truth
from geoevs.scenes.sources.street.buildings import add_buildings
from geoevs.scenes.sources.street.finishes import make_finishes
from geoevs.scenes.sources.street.furniture import add_furniture
from geoevs.scenes.sources.street.ground import add_ground
from geoevs.scenes.sources.street.layout import LAYOUTS, make_street
from geoevs.scenes.sources.street.lidar import scan
from geoevs.scenes.sources.street.light import make_light
from geoevs.scenes.sources.street.mesh import MeshBuilder
from geoevs.scenes.sources.street.render import render_depth, render_image
from geoevs.scenes.sources.street.rig import MOUNTS, RIG, Ego, make_cameras
from geoevs.scenes.sources.street.stage import Scenes, Stage
from geoevs.scenes.sources.street.traffic import make_actors, make_tracks

KEPT_INSTANTS = 8  # about 40 MB each
INTERVAL = 0.1  # seconds between frames
LONGEST = 6.0  # seconds, after which the ego would come near the end of its street
FASTEST = 40.0  # m/s


class World:
    """One scene: its street, light, actors and vehicle; a pure function of its arguments."""

    def __init__(
        self, name: str, interval: float = INTERVAL, traffic_speed: float | None = None
    ) -> None:
        self.layout = name.partition("-")[0]
        self.name, self.interval = name, interval
        self._street = make_street(self.layout, keyed_rng(name, "street"))
        self.light = make_light(keyed_rng(name, "light"))
        self.ego = Ego(self._street, keyed_rng(name, "ego").uniform(8, 12))
        self.actors = make_actors(
            self._street, self.ego.speed, keyed_rng(name, "actors"), traffic_speed
        )
        self._ground = MeshBuilder()
        self.road_map = add_ground(self._ground, self._street, keyed_rng(name, "ground"))
        self._stage: Stage | None = None
        self._instants: dict[int, Scenes] = {}

    def at(self, frame: int) -> Scenes:
        """The Mitsuba scenes of a frame; the last few are kept, for callers that go to and fro."""
        if frame not in self._instants:
            if len(self._instants) == KEPT_INSTANTS:
                self._instants.pop(next(iter(self._instants)))
            self._instants[frame] = self._build_instant(frame)
        return self._instants[frame]

    def _build_instant(self, frame: int) -> Scenes:
        moving = MeshBuilder()
        for actor in self.actors:
            if actor.moving:
                actor.add_to(moving, frame * self.interval)
        return self._built().with_moving(moving.surfaces())

    def _built(self) -> Stage:
        if self._stage is None:
            still = self._ground
            gardens = add_buildings(still, self._street, keyed_rng(self.name, "buildings"))
            add_furniture(still, self._street, gardens, keyed_rng(self.name, "furniture"))
            for actor in self.actors:
                if not actor.moving:
                    actor.add_to(still, 0.0)
            finishes = make_finishes(keyed_rng(self.name, "finishes"))
            self._stage = Stage(self.light, finishes, still.surfaces())
        return self._stage


class Source:
    """Procedural streets; scenes are called `<layout>-<seed>`, such as `curve-101`.

    Args:
        height, width: pixels of every image; the field of view is always the same.
        frames: length of every scene.
        interval: seconds between frames; training needs few frames that differ much.
        lidar_azimuths: measurements of each of the 64 beams in a turn.
        samples: rays a pixel that an image is made of.
        traffic_speed: of all cars that drive, m/s; None leaves each its own.

    Raises:
        GeoEvsError: the frames are longer than a street lasts.
    """

    has_truth = True

    def __init__(
        self,
        height: int,
        width: int,
        *,
        frames: Annotated[int, Within(1, 60)] = 8,
        interval: Positive = INTERVAL,
        lidar_azimuths: Annotated[int, Within(1, 4000)] = 400,
        samples: Annotated[int, Within(1, 400)] = 25,
        traffic_speed: Annotated[float, Within(0, FASTEST)] | None = None,
    ) -> None:
        if not 0 < frames * interval <= LONGEST:
            raise GeoEvsError(
                f"street's options make {frames} frames of {interval} s each; streets last "
                f"{LONGEST:g} s, so lower 'frames' or 'interval'"
            )
        self._height, self._width, self._interval = height, width, interval
        self._traffic_speed = traffic_speed
        self._frames, self._azimuths, self._samples = frames, lidar_azimuths, samples
        self._world: World | None = None

    def check(self, scene: SceneRef) -> None:
        """Refuse names and frames that no street has.

        Raises:
            GeoEvsError: the name is not `<layout>-<seed>`, or the scene lacks one of the frames.
        """
        layout, dash, seed = scene.name.partition("-")
        if layout not in LAYOUTS or not dash or not seed.isdecimal():
            raise GeoEvsError(
                f"street scene '{scene.name}' is not of the form LAYOUT-SEED with a layout and a "
                f"whole number, such as straight-101; {did_you_mean(layout, LAYOUTS)}"
            )
        if scene.first is not None and scene.last is not None and scene.last >= self._frames:
            raise GeoEvsError(
                f"scene '{scene.name}' has no frame {max(scene.first, self._frames)}; its frames "
                f"are 0 to {self._frames - 1}, so choose a range of those or raise 'frames'"
            )

    def files(self, scene: SceneRef) -> Iterable[Path]:
        """None: a scene is made from its name and the options."""
        return ()

    def open(self, scene: SceneRef) -> SceneRecord:
        """Open a scene; each frame is rendered when it is iterated.

        Raises:
            GeoEvsError: see `check`.
        """
        self.check(scene)
        world = self._enter(scene)
        frames = [frame for frame in range(self._frames) if scene.holds(frame)]
        info = SceneInfo(
            name=scene.name,
            source="street",
            licence="CC0-1.0",
            rig=RIG,
            cameras=tuple(MOUNTS),
            redistribute=True,
            tags=(world.layout, world.light.mood),
        )
        return SceneRecord(
            info=info,
            tracks=make_tracks(world.actors, frames, world.interval),
            frames=self._record(world, frames),
            frame_count=len(frames),
            extras=SceneExtras(road_map=world.road_map),
        )

    def truth(self, scene: SceneRef, views: Sequence[tuple[Camera, int]]) -> Iterable[Truth]:
        """Dense RGB and depth at (camera, frame) pairs, rendered one by one as they are iterated.

        Raises:
            GeoEvsError: the scene's name is wrong, or the scene does not have one of the frames.
        """
        self.check(scene)
        world = self._enter(scene)
        for _, frame in views:
            if not (scene.holds(frame) and 0 <= frame < self._frames):
                raise GeoEvsError(
                    f"scene '{scene.name}' has no frame {frame}; ask for frames from 0 to "
                    f"{self._frames - 1} within the scene's range"
                )
        return self._render_truth(world, views)

    def _enter(self, scene: SceneRef) -> World:
        if self._world is None or self._world.name != scene.name:
            self._world = World(scene.name, self._interval, self._traffic_speed)
        return self._world

    def _record(self, world: World, frames: list[int]) -> Iterator[Frame]:
        for frame in frames:
            scenes, pose = world.at(frame), world.ego.pose(frame * world.interval)
            cameras = make_cameras(pose, self._height, self._width)
            images = {
                name: self._render(world, scenes, camera, frame, f"recorded/{name}")
                for name, camera in cameras.items()
            }
            rng = keyed_rng(world.name, frame, "lidar")
            points = scan(scenes.lit, pose, self._azimuths, rng)
            depths = {name: render_depth(scenes, camera) for name, camera in cameras.items()}
            yield Frame(frame, frame * world.interval, cameras, images, points, depths)

    def _render_truth(self, world: World, views: Sequence[tuple[Camera, int]]) -> Iterator[Truth]:
        for camera, frame in views:
            scenes = world.at(frame)
            rgb = self._render(world, scenes, camera, frame, "truth")
            yield Truth(rgb, render_depth(scenes, camera))

    def _render(
        self, world: World, scenes: Scenes, camera: Camera, frame: int, purpose: str
    ) -> np.ndarray:
        rng = keyed_rng(world.name, frame, purpose)
        return render_image(
            scenes, camera, world.light, world.actors, frame * world.interval, self._samples, rng
        )

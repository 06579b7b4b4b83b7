"""A scene as a source gives it, made a scene store whose LiDAR its own cameras coloured."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from geoevs.core.files import new_folder
from geoevs.core.progress import counted
from geoevs.core.stamps import NOTHING, Stamp
from geoevs.projection import colour_frame
from geoevs.scenes.checks import check_sensors
from geoevs.scenes.depths import write_depths
from geoevs.scenes.scene import Frame, SceneRecord
from geoevs.scenes.store import write_scene


def write_coloured_scene(
    folder: Path,
    depths: Path,
    record: SceneRecord,
    advance: Callable[[], None],
    made_with: Stamp = NOTHING,
) -> None:
    """Write a scene's store and, apart from it, what its source knows of the true depth.

    Args:
        folder: the store, whole or not at all.
        depths: the folder of true depths, whole or not at all; empty where nobody knows them.
        record: the scene; one frame of it is in memory at a time.
        advance: called after each frame, for a progress bar.
        made_with: what the store says that it was made with.

    Raises:
        GeoEvsError: something cannot be true of the scene, or its LiDAR cannot score methods or
            condition them (see `geoevs.scenes.checks`); or nothing can be written.
    """

    def coloured_frame(frame: Frame) -> Frame:
        coloured = colour_frame(frame, record.extras.ego_masks)
        where = f"frame {frame.frame} of scene '{record.info.name}'"
        check_sensors(record.info.rig, coloured.points, where)
        return coloured

    with new_folder(depths) as partial:
        coloured = (coloured_frame(frame) for frame in counted(record.frames, advance))
        frames = (write_depths(partial, frame) for frame in coloured)
        info = replace(record.info, made_with=made_with)
        write_scene(folder, info, record.tracks, frames, record.extras)

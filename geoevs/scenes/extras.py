"""What only some data sources know of a scene, and where its store keeps it.

ego/<camera>.png           white where the camera sees the car that carries it
map.npz                    the road map (see `geoevs.scenes.road_map.ARRAYS`)
no-label-zones.json        polygons without boxes, by frame
synced-tracks.parquet      boxes at the instants of the cameras, which `camera` names
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.files import (
    read_arrays,
    read_json,
    whole_file,
    write_arrays,
    write_bytes,
    write_json,
)
from geoevs.core.images import read_image, write_image
from geoevs.core.text import clean
from geoevs.scenes.checks import Where, check_tracks, frame_number, number
from geoevs.scenes.road_map import RoadMap, check_road_map, map_arrays, map_from_arrays
from geoevs.scenes.scene import TRACK_COLUMNS, SceneExtras

EGO, MAP, ZONES, SYNCED = "ego", "map.npz", "no-label-zones.json", "synced-tracks.parquet"


def write_extras(folder: Path, extras: SceneExtras) -> None:
    """Write what there is into a store that is being made."""
    for camera, mask in extras.ego_masks.items():
        picture = np.repeat(mask[..., None], 3, axis=2).astype(np.uint8) * 255
        write_image(folder / EGO / f"{camera}.png", picture)
    if extras.road_map is not None:
        write_arrays(folder / MAP, map_arrays(extras.road_map))
    if extras.no_label_zones:
        zones = {
            str(frame): [zone.tolist() for zone in polygons]
            for frame, polygons in extras.no_label_zones.items()
        }
        write_json(folder / ZONES, zones)
    if extras.synced_tracks is not None:
        columns = [*TRACK_COLUMNS, "camera"]
        write_bytes(folder / SYNCED, extras.synced_tracks[columns].to_parquet(index=False))


def check_extras(extras: SceneExtras, sizes: Mapping[str, tuple[int, int]], where: Where) -> None:
    """Check what a scene has besides views, points and boxes.

    Args:
        extras: as they were read or made.
        sizes: height and width by camera.
        where: they stand, for errors.

    Raises:
        GeoEvsError: a mask of a camera that there is not, or of another size; a map or zone that is
            none; boxes that cannot be, or of a camera that there is not.
    """
    for camera, mask in extras.ego_masks.items():
        _check_camera(camera, sizes, f"{where}: the mask of the ego car")
        if mask.dtype != bool or mask.shape != sizes[camera]:
            raise GeoEvsError(
                f"{where}: the mask of the ego car in camera '{camera}' is {mask.dtype} of shape "
                f"{mask.shape}; give bool of shape {sizes[camera]}"
            )
        if mask.all():
            raise GeoEvsError(
                f"{where}: camera '{camera}' sees nothing but the ego car; leave the camera out"
            )
    if extras.road_map is not None:
        check_road_map(extras.road_map, where)
    for frame, polygons in extras.no_label_zones.items():
        frame_number(frame, where)
        for polygon in polygons:
            _check_zone(polygon, f"{where}: a zone without boxes in frame {frame}")
    if extras.synced_tracks is not None:
        check_tracks(extras.synced_tracks, where)
        if "camera" not in extras.synced_tracks:
            raise GeoEvsError(
                f"{where}: boxes at cameras' instants have no column 'camera'; add it"
            )
        for camera in extras.synced_tracks["camera"].unique():
            _check_camera(camera, sizes, f"{where}: a box")


def _check_camera(camera: Any, sizes: Mapping[str, Any], who: str) -> None:
    if camera not in sizes:
        hint = did_you_mean(str(camera), sizes)
        raise GeoEvsError(f"{who} names camera '{clean(str(camera), 40)}'; {hint}")


def _check_zone(points: np.ndarray, who: str) -> None:
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise GeoEvsError(f"{who} has no points of 2 metres each; correct it")
    if points.dtype.kind != "f" or not np.isfinite(points).all():
        raise GeoEvsError(f"{who} has points that are NaN or infinite; correct it")


def read_ego_masks(folder: Path, sizes: Mapping[str, tuple[int, int]]) -> dict[str, np.ndarray]:
    """(H, W) bool by camera, of those that see the car that carries them.

    Raises:
        GeoEvsError: a file is no picture, or one of another size than its camera.
    """
    masks = {}
    for camera in sizes:
        path = folder / EGO / f"{camera}.png"
        if path.exists():
            masks[camera] = read_image(path)[..., 0] > 127
            check_extras(SceneExtras({camera: masks[camera]}), sizes, path)
    return masks


def read_map(folder: Path) -> RoadMap | None:
    """The road map of a store; None where its source has none.

    Raises:
        GeoEvsError: the file is damaged, or holds something else.
    """
    path = folder / MAP
    return map_from_arrays(read_arrays(path), path) if path.exists() else None


def read_zones(folder: Path) -> dict[int, list[np.ndarray]]:
    """Polygons (N, 2) without boxes, by frame; empty where its source has none.

    Raises:
        GeoEvsError: the file is damaged, or holds something else.
    """
    path = folder / ZONES
    if not path.exists():
        return {}
    described = read_json(path)
    if not isinstance(described, dict):
        raise GeoEvsError(f"{path} lists no zones by frame; remake the store")
    zones = {}
    for frame, polygons in described.items():
        if not (frame.isascii() and frame.isdecimal() and isinstance(polygons, list)):
            raise GeoEvsError(f"{path} has an entry that is no frame's; remake the store")
        zones[int(frame[:7])] = [_outline(polygon, path) for polygon in polygons]
    check_extras(SceneExtras(no_label_zones=zones), {}, path)
    return zones


def _outline(points: Any, path: Path) -> np.ndarray:
    """(N, D) float64 of a list of lists of numbers."""
    if not isinstance(points, list) or not all(isinstance(point, list) for point in points):
        raise GeoEvsError(f"{path} has points that are no lists of numbers; remake the store")
    if len({len(point) for point in points}) != 1:
        raise GeoEvsError(f"{path} has points of several lengths; remake the store")
    return np.array([[number(value, "a point", path) for value in point] for point in points])


def read_synced_tracks(folder: Path, sizes: Mapping[str, tuple[int, int]]) -> pd.DataFrame | None:
    """Boxes at the instants of the cameras; None where their source has none.

    Raises:
        GeoEvsError: the file is damaged, or holds boxes that cannot be.
    """
    path = folder / SYNCED
    if not path.exists():
        return None
    with whole_file(path):
        tracks = pd.read_parquet(path)
    check_extras(SceneExtras(synced_tracks=tracks), sizes, path)
    return tracks

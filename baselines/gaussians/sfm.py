"""Points from pycolmap's features, matching and triangulation, with the known poses (section 4.1).

Nothing about the cameras is estimated: calibration is data here, and a rig whose cameras overlap
little gives mappers too few matches to find poses from. Known poses also guide the matching, which
finds half as many points again as matching first and testing the epipolar geometry afterwards.
"""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from geoevs.core.images import to_uint8
from geoevs.methods.contract import Views
from geoevs.projection import project_points
from geoevs.scenes.camera import Camera, angle_between

# The values were chosen on three procedural streets, 40 views of 128 x 192 with known depth, where
# they give 1700 to 2500 points, of which nine in ten are within 10 % of it.

FEATURE_WIDTH = 384
"""Smaller images are enlarged to about this width: four times the features, hence the points."""

MOST_FEATURES = 2048
"""Most features of an image, the strongest: matching takes time by their square."""

FRAMES_APART = 2
"""Most frames between two images that are matched: at 1 m a frame, others add few points."""

WIDEST_ANGLE = 60.0
"""Degrees between the optical axes beyond which SIFT matches nothing, though views may overlap."""

EPIPOLAR_ERROR = 2.0
REPROJECTION_ERROR = 1.0
"""Largest reprojection error of a point, in pixels of the enlarged image."""

TRIANGULATION_ANGLE = 1.5
"""Least angle between the rays to a point, degrees: at 1 m of motion it is 40 m away."""

TRACK_LENGTH = 3
"""Fewest views that must agree on a point. Of points that two views agree on, half are wrong."""

ISOLATED = 0.1
"""A point is an outlier if its neighbours are farther from it than this part of its depth."""

NEIGHBOURS = 3


class Observed(NamedTuple):
    """An image as pycolmap knows it."""

    camera: Camera  # of the enlarged image
    frame: int
    image: np.ndarray  # [H, W, 3] float, the original
    lens: pycolmap.Camera
    keypoints: pycolmap.FeatureKeypoints
    descriptors: pycolmap.FeatureDescriptors


def triangulate(views: Views) -> tuple[np.ndarray, np.ndarray]:
    """Match the source views of nearby frames and triangulate what they share.

    Args:
        views: the source views; neither LiDAR nor tracks are read.

    Returns:
        xyz (N, 3) float32 in metres, in front of all cameras that see them, and rgb (N, 3)
        float32 in [0, 1], their mean colour; N is 0 where nothing could be triangulated.
    """
    # Two frames hold few tracks of three views: cameras of one frame hardly overlap.
    shortest = TRACK_LENGTH if len(views.frames) >= TRACK_LENGTH else 2
    with tempfile.TemporaryDirectory() as folder, _quiet():
        observed = _observe(views)
        tracks = _triangulate(observed, Path(folder))
    tracks = [track for track in tracks if len(track.images) >= shortest]
    xyz = np.array([track.xyz for track in tracks]).reshape(-1, 3)
    rgb, nearest = _colours_and_depths(xyz, [track.images for track in tracks], observed)
    keep = np.isfinite(xyz).all(axis=1) & (nearest > 0)
    keep[keep] = _near_others(xyz[keep], nearest[keep])
    return xyz[keep].astype(np.float32), rgb[keep].astype(np.float32)


class _Track(NamedTuple):
    xyz: np.ndarray  # [3]
    images: list[int]  # places in the list of observed images


def _observe(views: Views) -> list[Observed]:
    """All source views with their features, frame by frame."""
    options = pycolmap.FeatureExtractionOptions(num_threads=1, use_gpu=False)
    options.sift.max_num_features = MOST_FEATURES
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    observed = []
    for frame in views.frames:
        for name in views.cameras:
            camera, image = views.camera(name, frame), views.image(name, frame)
            factor = max(1, round(FEATURE_WIDTH / camera.width))
            fine = camera.resized(camera.height * factor, camera.width * factor)
            grey = cv2.cvtColor(to_uint8(image), cv2.COLOR_RGB2GRAY)
            grey = cv2.resize(grey, (fine.width, fine.height), interpolation=cv2.INTER_CUBIC)
            keypoints, descriptors = extractor.extract_from_uint8_array(grey)
            lens = pycolmap.Camera(
                camera_id=len(observed) + 1,
                model="PINHOLE",
                width=fine.width,
                height=fine.height,
                params=fine.K[[0, 1, 0, 1], [0, 1, 2, 2]],
            )
            observed.append(Observed(fine, frame, image, lens, keypoints, descriptors))
    return observed


def _triangulate(observed: list[Observed], folder: Path) -> list[_Track]:
    """Points by the database and the triangulation of pycolmap, which both need a folder."""
    reconstruction = pycolmap.Reconstruction()
    with pycolmap.Database.open(folder / "database.db") as database:
        for number, view in enumerate(observed, start=1):
            _add_view(number, view, reconstruction, database)
        matched = _match(observed, database)
    if not matched:
        return []  # pycolmap would stop at a database without matches
    options = pycolmap.IncrementalPipelineOptions(
        extract_colors=False, num_threads=1, random_seed=0, min_num_matches=1
    )
    options.triangulation.random_seed = 0
    options.triangulation.min_angle = TRIANGULATION_ANGLE
    options.triangulation.merge_max_reproj_error = REPROJECTION_ERROR
    options.triangulation.complete_max_reproj_error = REPROJECTION_ERROR
    options.triangulation.ignore_two_view_tracks = False  # see `triangulate`
    options.mapper.random_seed = 0
    options.mapper.filter_max_reproj_error = REPROJECTION_ERROR
    options.mapper.filter_min_tri_angle = TRIANGULATION_ANGLE
    triangulated = pycolmap.triangulate_points(
        reconstruction, folder / "database.db", folder, folder, options=options
    )
    return [
        _Track(point.xyz, sorted({element.image_id - 1 for element in point.track.elements}))
        for _, point in sorted(triangulated.points3D.items())
    ]


def _add_view(
    number: int,
    view: Observed,
    reconstruction: pycolmap.Reconstruction,
    database: pycolmap.Database,
) -> None:
    """Enter a view as a camera, rig, frame and image of its own, all with one number."""
    reconstruction.add_camera_with_trivial_rig(view.lens)
    image = pycolmap.Image(name=str(number), image_id=number, camera_id=number)
    pose = pycolmap.Rigid3d(view.camera.camera_from_world[:3])
    reconstruction.add_image_with_trivial_frame(image, pose)
    database.write_camera(view.lens, use_camera_id=True)
    database.write_rig(reconstruction.rig(number), use_rig_id=True)
    database.write_frame(reconstruction.frame(number), use_frame_id=True)
    database.write_image(reconstruction.image(number), use_image_id=True)
    database.write_keypoints(number, pycolmap.keypoints_to_matrix(view.keypoints))


def _match(observed: list[Observed], database: pycolmap.Database) -> int:
    """Match all pairs that may share something, along epipolar lines; the number of matches."""
    options = pycolmap.FeatureMatchingOptions(num_threads=1, use_gpu=False)
    matcher = pycolmap.FeatureMatcher.create(options, pycolmap.Device.cpu)
    matched = 0
    for (i, view), (j, other) in _pairs(observed):
        geometry = _known_geometry(view, other)
        matcher.match_guided(
            EPIPOLAR_ERROR,
            view.keypoints,
            view.descriptors,
            view.lens,
            other.keypoints,
            other.descriptors,
            other.lens,
            geometry,
        )
        if len(geometry.inlier_matches):
            database.write_two_view_geometry(i, j, geometry)
            matched += len(geometry.inlier_matches)
    return matched


def _pairs(observed: list[Observed]) -> Iterator[tuple[tuple[int, Observed], tuple[int, Observed]]]:
    """Pairs of numbered views with features, near in time and in direction, apart in position."""
    featured = [(n, view) for n, view in enumerate(observed, start=1) if len(view.keypoints)]
    for one, two in combinations(featured, 2):
        view, other = one[1], two[1]
        if (
            abs(view.frame - other.frame) <= FRAMES_APART
            and angle_between(view.camera.optical_axis, other.camera.optical_axis) < WIDEST_ANGLE
            and (view.camera.centre != other.camera.centre).any()
        ):
            yield one, two


def _known_geometry(view: Observed, other: Observed) -> pycolmap.TwoViewGeometry:
    """The epipolar geometry that the calibration gives."""
    pose = pycolmap.Rigid3d((other.camera.camera_from_world @ view.camera.world_from_camera)[:3])
    return pycolmap.TwoViewGeometry(
        config=int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED),
        cam2_from_cam1=pose,
        E=pycolmap.essential_matrix_from_pose(pose),
    )


def _colours_and_depths(
    xyz: np.ndarray,  # [N, 3]
    images: list[list[int]],
    observed: list[Observed],
) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) mean colours in the images that see the points, and (N,) their least depths there."""
    total, count = np.zeros((len(xyz), 3)), np.zeros(len(xyz))
    nearest = np.full(len(xyz), np.inf)
    for number, view in enumerate(observed):
        seen = np.array([n for n, seers in enumerate(images) if number in seers], int)
        height, width = view.image.shape[:2]
        uv, depth = project_points(xyz[seen], view.camera.resized(height, width))
        nearest[seen] = np.fmin(nearest[seen], np.nan_to_num(depth, nan=-np.inf))
        columns, rows = np.nan_to_num(uv).clip(0, [width - 1, height - 1]).astype(int).T
        total[seen] += view.image[rows, columns]
        count[seen] += 1
    return total / np.maximum(count, 1)[:, None], nearest


def _near_others(
    xyz: np.ndarray,  # [N, 3]
    depth: np.ndarray,  # [N]
) -> np.ndarray:
    """(N,) bool: points whose neighbours are near, by the measure of their distance."""
    if len(xyz) <= NEIGHBOURS:
        return np.zeros(len(xyz), bool)
    distance, _ = cKDTree(xyz).query(xyz, NEIGHBOURS + 1)  # the nearest is the point itself
    return distance[:, 1:].mean(axis=1) < ISOLATED * depth


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep pycolmap's log, but for its errors, off the terminal."""
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level

"""Where Gaussians start, on views of a wall."""

import json

import numpy as np
import pytest

from baselines.gaussians import initialisation
from baselines.gaussians.initialisation import scene_extent, starting_points, with_far_points
from baselines.gaussians.options import FEWEST
from geoevs.core.errors import GeoEvsError
from geoevs.projection import project_points

ASIDE = [(0.0, 0.5 * frame, 1.6) for frame in range(4)]
LIDAR = 4 * 48 * 72 // 8 // 2  # every eighth pixel of four views, of which half have a colour


def start(views, most=100_000, seed=0, **options):
    return starting_points(views, most, np.random.default_rng(seed), **options)


@pytest.mark.parametrize(
    ("coloured", "needs", "first", "count", "note"),
    [
        (False, ("sfm",), "sfm", 5000, "starts from 5000 random points; 0 points of SfM, too few"),
        (
            False,
            ("sfm", "lidar"),
            "sfm",
            LIDAR,
            f"starts from {LIDAR} LiDAR points; 0 points of SfM, too few",
        ),
        (True, ("sfm", "lidar"), "lidar", LIDAR, f"starts from {LIDAR} LiDAR points"),
        (True, ("sfm",), "random", 5000, "starts from 5000 random points"),
        (
            False,
            ("sfm", "lidar"),
            "sfm and lidar",
            LIDAR,
            f"starts from 0 points of SfM and {LIDAR} LiDAR points",
        ),
    ],
)
def test_the_first_source_that_has_enough(views_of_wall, coloured, needs, first, count, note):
    points = start(views_of_wall(ASIDE, coloured, needs), first=first)
    assert points.note == note
    assert points.xyz.shape == points.rgb.shape == (count, 3)
    assert points.xyz.dtype == points.rgb.dtype == np.float32


@pytest.mark.parametrize("first", ["sfm", "lidar"])  # LiDAR is not declared, hence passed over
def test_sfm_where_it_works(views_of_wall, first):
    points = start(views_of_wall(ASIDE), first=first)
    assert points.note == f"starts from {len(points.xyz)} points of SfM"
    assert len(points.xyz) >= FEWEST


@pytest.mark.parametrize("most", [100_000, 700, 200])
def test_sfm_stays_up_to_half_and_lidar_fills_what_is_left(views_of_wall, most):
    views = views_of_wall(ASIDE, needs=("sfm", "lidar"))
    sfm, lidar = (start(views, first=source).xyz for source in ("sfm", "lidar"))
    both = start(views, most, first="sfm and lidar")
    counts = {
        source: sum((xyz == row).all(axis=1).any() for row in both.xyz)
        for source, xyz in {"sfm": sfm, "lidar": lidar}.items()
    }
    assert counts["sfm"] == min(len(sfm), most // 2)
    assert counts["lidar"] == min(len(lidar), most - counts["sfm"])
    assert len(both.xyz) == counts["sfm"] + counts["lidar"]


def test_an_unknown_source_is_named(views_of_wall):
    with pytest.raises(GeoEvsError, match="cannot start from 'lidr'; did you mean 'lidar'"):
        start(views_of_wall(ASIDE), first="lidr")


def test_no_more_points_than_asked(views_of_wall):
    views = views_of_wall(ASIDE, needs=("lidar",))
    all_points, some = start(views, first="lidar"), start(views, most=50, first="lidar")
    assert some.note == f"starts from 50 of {LIDAR} LiDAR points"
    rows = [np.flatnonzero((all_points.xyz == xyz).all(axis=1))[0] for xyz in some.xyz]
    assert len(set(rows)) == 50
    np.testing.assert_array_equal(some.rgb, all_points.rgb[rows])


def test_random_points_spread_over_depths_along_the_views_rays(views_of_wall):
    views = views_of_wall(ASIDE[:1])
    points = start(views, first="random")
    camera = views.camera("front", 0)
    uv, depth = project_points(points.xyz, camera)
    assert depth.min() >= 2 - 1e-4
    assert depth.max() <= 100 + 1e-4
    # As many in every octave: the median is the geometric mean, with a standard error of 3 %.
    assert np.median(depth) == pytest.approx(np.sqrt(2 * 100), rel=0.1)
    columns, rows = np.floor(uv).astype(int).T
    np.testing.assert_array_equal(points.rgb, views.image("front", 0)[rows, columns])
    assert len(np.unique(rows * 72 + columns)) > 2000  # of 3456 pixels


def test_the_generator_decides(views_of_wall):
    views = views_of_wall(ASIDE[:1])
    first, again, other = (start(views, 900, seed, first="random").xyz for seed in (0, 0, 1))
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


def test_the_cache_spares_sfm(views_of_wall, tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    first = start(views_of_wall(ASIDE), cache=cache)
    calls = []
    nothing = np.zeros((0, 3), np.float32)
    monkeypatch.setattr(
        initialisation, "triangulate", lambda views: calls.append(views) or (nothing, nothing)
    )
    again = start(views_of_wall(ASIDE), cache=cache)
    assert not calls
    assert again.xyz.tobytes() == first.xyz.tobytes()
    assert again.rgb.tobytes() == first.rgb.tobytes()
    assert again.note == f"{first.note}, kept from before"
    # Other views have other points, and nothing found is kept too.
    for _ in range(2):
        assert "0 points of SfM" in start(views_of_wall(ASIDE[:3]), cache=cache).note
    assert len(calls) == 1


@pytest.mark.parametrize(
    ("place", "name", "other"),
    [
        (initialisation.pycolmap, "__version__", "0.0"),
        (initialisation, "code_hash", {"baselines.gaussians.sfm": "other"}.__getitem__),
    ],
)
def test_points_of_another_sfm_are_not_taken(
    views_of_wall, tmp_path, monkeypatch, place, name, other
):
    start(views_of_wall(ASIDE), cache=tmp_path)
    assert "kept from before" in start(views_of_wall(ASIDE), cache=tmp_path).note
    monkeypatch.setattr(place, name, other)
    assert "kept from before" not in start(views_of_wall(ASIDE), cache=tmp_path).note


def test_a_damaged_cache_is_named(views_of_wall, tmp_path):
    start(views_of_wall(ASIDE), cache=tmp_path)
    (kept,) = tmp_path.iterdir()
    kept.write_text(json.dumps("no archive"))
    with pytest.raises(GeoEvsError, match=rf"{kept.name} is not whole"):
        start(views_of_wall(ASIDE), cache=tmp_path)


@pytest.mark.parametrize(
    ("centres", "extent"),
    [
        # Their mean is (0, 20, 20), from which the last is sqrt(400 + 1600) away.
        ([(0, 0, 0), (0, 20, 0), (0, 20, 20), (0, 40, 60)], 1.1 * np.sqrt(2000)),
        ([(0, 0, 1), (0, 0.2, 1)], 20.0),
    ],
)
def test_extent(views_of_wall, centres, extent):
    assert scene_extent(views_of_wall(centres)) == pytest.approx(extent)


def test_far_points_come_behind(views_of_wall):
    views = views_of_wall(ASIDE)
    points = start(views)
    more = with_far_points(points, 500, views, np.random.default_rng(0))
    assert more.note == f"{points.note}; 500 far ones"
    count = len(points.xyz)
    assert len(more.xyz) == len(more.rgb) == count + 500
    np.testing.assert_array_equal(more.xyz[:count], points.xyz)
    assert more.xyz[count:, 0].min() >= 50 - 1e-3
    assert more.xyz[count:, 0].max() <= 200 + 1e-3

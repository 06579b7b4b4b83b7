"""PandaSet's map: labelled points become polygons, and none of those that score the scene."""

import os
from pathlib import Path

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.road_map import SURFACES
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.sources.pandaset.road_map import LABELS
from geoevs.scenes.sources.pandaset.source import Source
from geoevs.scenes.sources.pandaset.unpickle import read_table

DRIVABLE, MARKING, CROSSING, SIDEWALK = range(len(SURFACES))
STEP = 0.5
FRONT, SCORING = 1, 0


def patch(low, high, label, sensor, z=1.5):
    """Points half a metre apart over a rectangle: x, y, z, label, sensor."""
    x, y = np.meshgrid(*(np.arange(a, b, STEP) for a, b in zip(low, high, strict=True)))
    rest = np.broadcast_to([z, label, sensor], (x.size, 3))
    return np.column_stack([x.ravel(), y.ravel(), rest])


ROAD = patch((5, -4), (25, 4), 7, FRONT)
LINE = patch((5, 0), (25, 0.4), 8, FRONT)
WALK = patch((5, 4.5), (25, 7), 11, FRONT)
CAR = patch((10, -3), (14, -1), 13, FRONT)
FAR = patch((1005, -4), (1025, 4), 7, FRONT)
HIDDEN = patch((30, -4), (40, 4), 7, SCORING)


@pytest.fixture
def labelled(pandaset, pandaset_files):
    """Writes labelled sweeps of the frames 3 and 4."""

    def write(frame, *patches, labels="class", drop=0, kind=np.int64):
        points = np.concatenate(patches)
        rows = dict(zip("xyz", points[:, :3].T, strict=True))
        rows |= {"i": np.ones(len(points)), "t": np.ones(len(points))}
        rows |= {"d": points[:, 4].astype(np.int64)}
        packed = pandaset_files.old_pickle({name: np.array(row) for name, row in rows.items()})
        pandaset_files.write_gzip(pandaset / f"777/lidar/{frame:02d}.pkl.gz", packed)
        packed = pandaset_files.old_pickle({labels: points[drop:, 3].astype(kind)})
        path = pandaset / f"777/annotations/semseg/{frame:02d}.pkl.gz"
        return pandaset_files.write_gzip(path, packed)

    return write


def opened(folder: Path, scene: str = "777"):
    return Source(16, 24, folder=str(folder)).open(SceneRef.parse(scene))


def test_labels_become_polygons_and_gaps_are_closed(pandaset, labelled):
    labelled(3, ROAD, LINE, WALK, CAR)
    road_map = opened(pandaset).extras.road_map
    places = np.array([[15.3, -2.2], [20.1, 0.1], [15, 5.6], [15, 9], [30, 0], [-5, 0]])
    expected = np.zeros((6, 4), bool)
    expected[:2, DRIVABLE] = expected[1, MARKING] = expected[2, SIDEWALK] = True
    np.testing.assert_array_equal(road_map.at(places), expected)
    for polygon in road_map.polygons:
        np.testing.assert_allclose(polygon.corners[:, 2], 1.5)


def test_points_that_score_the_scene_are_in_no_map_of_it(pandaset, labelled):
    labelled(3, ROAD, HIDDEN)
    labelled(4, ROAD, HIDDEN)
    seen, hidden = np.array([[10.0, -1.0]]), np.array([[35.0, 0.0]])
    whole = opened(pandaset).extras.road_map
    assert whole.at(seen)[0, DRIVABLE]
    assert not whole.at(hidden).any()
    # Frame 4 is not the scene's, so its points score nothing there.
    assert opened(pandaset, "777@3-3").extras.road_map.at(hidden)[0, DRIVABLE]
    labelled(4, ROAD)
    assert not opened(pandaset, "777@3-3").extras.road_map.at(hidden).any()


def test_a_hole_in_the_road_stays_one(pandaset, labelled):
    island = (np.abs(ROAD[:, :2] - [15, 0]) < 2).all(axis=1)
    labelled(3, ROAD[~island])
    road_map = opened(pandaset).extras.road_map
    assert [len(polygon.rings) for polygon in road_map.polygons] == [2]
    assert not road_map.at(np.array([[15.0, 0.0]])).any()


@pytest.mark.parametrize("patches", [(), (HIDDEN,), (CAR,), (FAR,)])
def test_without_labels_of_ground_nearby_there_is_no_map(pandaset, labelled, patches):
    if patches:
        labelled(3, *patches)
    assert opened(pandaset).extras.road_map is None


@pytest.mark.parametrize(
    ("broken", "sentence"),
    [
        ({"labels": "klass"}, "has no column 'class'"),
        ({"drop": 1}, "labels for the"),
        ({"kind": object}, "something else than numbers in 'class'"),
    ],
)
def test_broken_labels_are_named(pandaset, labelled, broken, sentence):
    path = labelled(3, ROAD, **broken)
    with pytest.raises(GeoEvsError, match=sentence) as error:
        opened(pandaset)
    assert str(path) in str(error.value)


def test_the_real_map_is_where_the_real_road_is():
    if "GEOEVS_PANDASET" not in os.environ:
        pytest.skip("set GEOEVS_PANDASET to the folder that holds PandaSet's sequence 002")
    folder = Path(os.environ["GEOEVS_PANDASET"])
    road_map = opened(folder, "002@59-70").extras.road_map
    sweep = read_table(folder / "002/lidar/64.pkl.gz")
    labels = read_table(folder / "002/annotations/semseg/64.pkl.gz")["class"].to_numpy()
    # Pandar64, none of whose points made the map.
    xyz = sweep.loc[sweep["d"] == 0, ["x", "y", "z"]].to_numpy()[::4]
    labels = labels[(sweep["d"] == 0).to_numpy()][::4]
    found = road_map.at(xyz[:, :2])
    road, walk = (np.isin(labels, LABELS[name]) for name in ("drivable", "sidewalk"))
    mapped = found.any(axis=1)
    assert found[road & mapped, DRIVABLE].mean() > 0.97
    assert found[walk & mapped, SIDEWALK].mean() > 0.8
    a, b, c = road_map.ground(xyz[road, :2].mean(axis=0))
    x, y, z = xyz[road & mapped].T
    assert abs(np.median(z - a * x - b * y - c)) < 0.05

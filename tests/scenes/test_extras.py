"""What only some sources know: it comes back from the store, and what cannot be is refused."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import HEIGHT, WIDTH, write_tiny_scene
from geoevs.scenes.extras import MAP, SYNCED, ZONES
from geoevs.scenes.scene import Exposure, Frame, MapFeature, SceneExtras
from geoevs.scenes.store import Scene, write_scene

BONNET = np.zeros((HEIGHT, WIDTH), bool)
BONNET[40:] = True


def tracks_of(camera: str) -> pd.DataFrame:
    box = {"frame": 0, "track": "a", "label": "car", "x": 7.5, "y": 2.0, "z": 0.7}
    size = {"length": 2.0, "width": 2.0, "height": 1.4, "yaw": 3.0, "moving": True}
    return pd.DataFrame([{**box, **size, "camera": camera}])


EXTRAS = SceneExtras(
    ego_masks={"front": BONNET},
    map_features=[
        MapFeature("crosswalk", "polygon", np.array([[1.0, 2, 0], [3, 2, 0], [3, 4, 0.25]])),
        MapFeature("stop_sign", "point", np.array([[5.0, -2, 1]])),
    ],
    no_label_zones={1: [np.array([[0.0, 0], [9, 0], [9, 9]])]},
    synced_tracks=tracks_of("left"),
)


def test_a_store_gives_back_what_its_source_knew(tmp_path):
    scene = write_tiny_scene(tmp_path / "s", extras=EXTRAS)
    assert list(scene.ego_masks) == ["front"]
    np.testing.assert_array_equal(scene.ego_masks["front"], BONNET)
    for found, given in zip(scene.map_features, EXTRAS.map_features, strict=True):
        assert found[:2] == given[:2]
        np.testing.assert_array_equal(found.points, given.points)
    assert list(scene.no_label_zones) == [1]
    np.testing.assert_array_equal(scene.no_label_zones[1][0], EXTRAS.no_label_zones[1][0])
    pd.testing.assert_frame_equal(scene.synced_tracks, EXTRAS.synced_tracks)
    some = scene.extras(("front",))
    assert list(some.ego_masks) == ["front"]
    assert some.synced_tracks.empty


def test_a_store_without_them_has_no_files_of_them(tmp_path):
    scene = write_tiny_scene(tmp_path / "s")
    assert scene.extras(scene.cameras).synced_tracks is None
    assert (scene.ego_masks, scene.map_features, scene.no_label_zones) == ({}, [], {})
    assert {path.name for path in scene.folder.iterdir()} >= {"scene.json", "tracks.parquet"}
    assert not {"ego", MAP, ZONES, SYNCED} & {path.name for path in scene.folder.iterdir()}


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"ego_masks": {"rear": BONNET}}, "names camera 'rear'; one of"),
        ({"ego_masks": {"front": BONNET[1:]}}, r"camera 'front' is bool of shape \(47, 72\)"),
        ({"ego_masks": {"front": BONNET.astype(int)}}, "camera 'front' is int64"),
        ({"ego_masks": {"front": BONNET | True}}, "sees nothing but the ego car"),
        ({"map_features": [MapFeature("../x", "point", np.ones((1, 3)))]}, "kind of map feature"),
        ({"map_features": [MapFeature("lane", "circle", np.ones((1, 3)))]}, "is no 'circle'"),
        ({"map_features": [MapFeature("lane", "point", np.ones((1, 2)))]}, "points of 3 metres"),
        ({"no_label_zones": {0: [np.array([[0.0, np.nan]])]}}, "NaN or infinite"),
        ({"no_label_zones": {-1: [np.ones((3, 2))]}}, "frame -1 is no whole number"),
        ({"synced_tracks": tracks_of("rear")}, "a box names camera 'rear'"),
        ({"synced_tracks": tracks_of("left").assign(length=-1.0)}, "'length' of 1 boxes"),
    ],
)
def test_what_cannot_be_is_not_written(tmp_path, changed, sentence):
    with pytest.raises(GeoEvsError, match=sentence):
        write_tiny_scene(tmp_path / "s", extras=replace(EXTRAS, **changed))
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("file", "content", "sentence"),
    [
        (MAP, "{}", "lists no map features"),
        (MAP, '[{"kind": "lane"}]', "no map feature"),
        (MAP, '[{"kind": "lane", "shape": "point", "points": 3}]', "no lists of numbers"),
        (MAP, '[{"kind": "lane", "shape": "point", "points": [[1, 2], [1]]}]', "several lengths"),
        (MAP, '[{"kind": "lane", "shape": "point", "points": [["a", 2, 3]]}]', "no finite number"),
        (MAP, '[{"kind": 3, "shape": "point", "points": [[1, 2, 3]]}]', "kind of map feature '3'"),
        (ZONES, "[]", "lists no zones"),
        (ZONES, '{"x": []}', "no frame's"),
        (ZONES, '{"1": [[]]}', "several lengths"),
        (ZONES, '{"12345678": []}', "no whole number"),
        (SYNCED, "nothing", SYNCED),
        ("ego/front.png", "nothing", "front.png"),
    ],
)
def test_a_damaged_file_is_one_sentence(tmp_path, file, content, sentence):
    scene = write_tiny_scene(tmp_path / "s", extras=EXTRAS)
    (scene.folder / file).write_text(content, encoding="utf-8")
    scene = Scene(scene.folder)
    with pytest.raises(GeoEvsError, match=re.escape(str(scene.folder / file))) as error:
        scene.extras(scene.cameras)
    assert sentence in str(error.value)


def test_exposures_come_back_and_must_be_in_order(tmp_path):
    tiny = write_tiny_scene(tmp_path / "tiny")
    when = {"front": Exposure(0.02, 0.0, 0.04)}
    cameras = {name: tiny.camera(name, 0) for name in tiny.cameras}
    images = {name: tiny.image(name, 0) for name in tiny.cameras}
    frame = Frame(0, 0.0, cameras, images, tiny.points(0), exposures=when)
    write_scene(tmp_path / "s", tiny.info, tiny.tracks, iter([frame]))
    scene = Scene(tmp_path / "s")
    assert scene.exposure("front", 0) == when["front"]
    assert scene.exposure("left", 0) is None
    path = tmp_path / "s/transforms.json"
    text = path.read_text(encoding="utf-8")
    for exposure, sentence in ([0.05, 0.0, 0.04], "does not lie"), ([0.0], "no list of time"):
        described = json.loads(text)
        described["frames"][0]["exposure"] = exposure
        path.write_text(json.dumps(described), encoding="utf-8")
        with pytest.raises(GeoEvsError, match=f"camera 'front' in frame 0.*{sentence}"):
            Scene(tmp_path / "s")

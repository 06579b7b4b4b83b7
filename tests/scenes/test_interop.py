"""The store's point file and the COLMAP model: what other tools read of a scene."""

import json
from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from geoevs.core.images import read_image
from geoevs.methods.contract import Views
from geoevs.methods.tiny import FRAMES, HEIGHT, WIDTH, write_tiny_scene
from geoevs.projection import project_points
from geoevs.scenes.interop import VERTEX, ThinnedPoints, write_ply
from geoevs.scenes.scene import PointCloud, Rig


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("store") / "tiny")


def read_ply(path):
    """Header lines, and points as the header describes them."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    kinds = {"float": "<f4", "uchar": "u1"}
    properties = [line.split()[1:] for line in lines if line.startswith("property ")]
    return lines, np.frombuffer(body, [(name, kinds[kind]) for kind, name in properties])


def conditioning(scene):
    """(N, 3) positions and colours of all coloured points of even beams, in order."""
    clouds = [scene.points(frame) for frame in scene.frames]
    clouds = [cloud.select((cloud.beam % 2 == 0) & (cloud.camera >= 0)) for cloud in clouds]
    return [np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in ("xyz", "rgb")]


def test_a_store_names_its_points_and_none_of_them_scores(scene):
    described = json.loads((scene.folder / "transforms.json").read_text())
    assert described["ply_file_path"] == "points.ply"
    lines, points = read_ply(scene.folder / "points.ply")
    xyz, rgb = conditioning(scene)
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", f"element vertex {len(xyz)}"]
    assert lines[3:] == [
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {colour}" for colour in ("red", "green", "blue")),
    ]
    assert len(points) == len(xyz) > 1000
    np.testing.assert_array_equal(np.stack([points[a] for a in "xyz"], axis=1), xyz)
    colours = np.stack([points[name] for name in ("red", "green", "blue")], axis=1)
    np.testing.assert_allclose(colours, rgb * 255, atol=0.501)


def test_what_a_method_sees_has_points_only_with_lidar(scene, tmp_path):
    Views(scene, scene.cameras, ("lidar",)).save(tmp_path / "with")
    Views(scene, scene.cameras, ()).save(tmp_path / "without")
    same = (scene.folder / "points.ply").read_bytes()
    assert (tmp_path / "with/points.ply").read_bytes() == same
    assert not (tmp_path / "without/points.ply").exists()
    assert "ply_file_path" not in json.loads((tmp_path / "without/transforms.json").read_text())


@pytest.mark.parametrize(("most", "stride"), [(100, 1), (99, 2), (50, 2), (49, 4), (13, 8)])
def test_too_many_points_are_thinned_by_an_even_stride(most, stride):
    thinned = ThinnedPoints(Rig("a", "b", "c", "sensor"), most)
    number = 0
    for count in (1, 0, 7, 30, 62):  # 100 in all
        xyz = np.zeros((count, 3))
        xyz[:, 0] = number + np.arange(count)
        number += count
        cloud = PointCloud.uncoloured(xyz, np.ones(count), np.zeros(count))
        thinned.add(replace(cloud, camera=np.zeros(count, np.int8)))
    assert thinned.vertices["x"].tolist() == list(range(0, 100, stride))


def test_points_of_a_file_are_as_they_were_given(tmp_path):
    vertices = np.array([(1.5, -2, 3, 0, 128, 255)], VERTEX)
    write_ply(tmp_path / "a.ply", vertices)
    _, points = read_ply(tmp_path / "a.ply")
    assert points.tolist() == [(1.5, -2.0, 3.0, 0, 128, 255)]


def test_colmap_opens_a_scene_and_projects_as_its_cameras_do(scene, tmp_path, geoevs):
    out = tmp_path / "colmap"
    assert geoevs("export-colmap", scene.folder, "--out", out) == (0, "", "")
    model = pycolmap.Reconstruction(out / "sparse/0")
    assert len(model.cameras) == len(scene.cameras)  # their K are the same in all frames
    assert len(model.images) == len(scene.cameras) * len(FRAMES)
    points = np.array([point.xyz for point in model.points3D.values()])
    xyz, _ = conditioning(scene)
    np.testing.assert_allclose(points[np.lexsort(points.T)], xyz[np.lexsort(xyz.T)], atol=1e-9)
    for image in model.images.values():
        name, file = image.name.split("/")
        camera = scene.camera(name, int(file.removesuffix(".png")))
        assert (image.camera.height, image.camera.width) == (HEIGHT, WIDTH)
        expected, depth = project_points(points[:500], camera)
        local = (image.cam_from_world() * points[:500])[depth > 0.1]
        np.testing.assert_allclose(
            image.camera.img_from_cam(local), expected[depth > 0.1], rtol=0, atol=1e-6
        )
        np.testing.assert_array_equal(
            read_image(out / "images" / image.name),
            read_image(scene.image_path(name, int(file[:6]))),
        )


def test_a_missing_store_is_one_sentence(geoevs, tmp_path):
    code, _, errors = geoevs("export-colmap", tmp_path, "--out", tmp_path / "out")
    assert code == 1
    assert errors == f"error: {tmp_path}/scene.json is missing; make or copy it there\n"
    assert not (tmp_path / "out").exists()

"""Layout images by hand: where rays meet the ground, what covers what, and no recorded pixel."""

import numpy as np
import pytest

from geoevs.conditions.layout import (
    CAR,
    CHANNELS,
    CROSSING,
    DRIVABLE,
    MARKING,
    NEARNESS,
    PEDESTRIAN,
    RAY,
    SIDEWALK,
    Layout,
    kind_of,
)
from geoevs.conditions.layout_sheet import false_colour, layout_sheet
from geoevs.methods.contract import Views
from geoevs.methods.tiny import tiny_camera, write_tiny_scene
from geoevs.scenes.boxes import Box
from geoevs.scenes.camera import Camera
from geoevs.scenes.road_map import Polygon, RoadMap
from geoevs.scenes.scene import SceneExtras

HEIGHT = 1.5


def camera(yaw=0.0, rows=60, columns=80, x=0.0, y=0.0):
    """A level camera 1.5 m up: 45 degrees of half a field of view across."""
    made = tiny_camera("c", yaw, np.array([x, y, HEIGHT]))
    K = [[40.0, 0, 40], [0, 40.0, 30], [0, 0, 1]]
    return Camera(K, made.world_from_camera, rows, columns, "c")


def box(x, y=0.0, label="car", length=4.0, width=2.0, height=1.5, yaw=0.0):
    return Box(0, "t", label, x, y, height / 2, length, width, height, yaw, False)


def band(surface, low, high, near=2.0, far=39.0, z=0.0):
    ring = [[near, low, z], [far, low, z], [far, high, z], [near, high, z]]
    return Polygon(surface, [np.array(ring, float)])


def layout(*boxes, polygons=(), yaw=0.0):
    road_map = RoadMap(polygons) if polygons else None
    return Layout(road_map, boxes, np.array([0, 0, HEIGHT]), yaw)


@pytest.mark.parametrize(
    ("label", "kind"),
    [
        ("car", "car"),
        ("vehicle.bus.rigid", "car"),
        ("Semi-truck", "car"),
        ("cyclist", "car"),
        ("Other Vehicle - Construction Vehicle", "car"),
        ("Personal Mobility Device", "car"),
        ("Pedestrian with Object", "pedestrian"),
        ("human.pedestrian.construction_worker", "pedestrian"),
        ("static_object.bicycle_rack", ""),
        ("Construction Signs", ""),
        ("sign", ""),
        ("scarecrow", ""),
        ("", ""),
    ],
)
def test_labels_of_all_sources_have_a_kind(label, kind):
    assert kind_of(label) == kind


def test_rays_meet_the_ground_where_geometry_says():
    lane = layout(polygons=[band("drivable", -3, 3), band("marking", -3, 3, 10, 20)])
    image = lane.image(camera())
    assert image.shape == (60, 80, CHANNELS)
    assert image.dtype == np.float32
    # The ray of row r falls (r + 0.5 - 30) / 40 a metre, so it meets the ground 60 / (r - 29.5)
    # metres ahead: rows 30.. see 120, 40, 24, 17.1, 13.3, 10.9, 9.2 m and so on.
    middle = image[:, 40]
    distance = 60 / (np.arange(60) - 29.5)
    known = (distance > 2) & (distance < 39)
    np.testing.assert_array_equal(middle[:, DRIVABLE], known)
    np.testing.assert_array_equal(middle[:, MARKING], (distance > 10) & (distance < 20))
    assert not image[..., [CAR, PEDESTRIAN, NEARNESS, SIDEWALK]].any()
    # 13.3 m ahead 3 m aside are 9 columns from the middle.
    (columns,) = np.nonzero(image[34, :, DRIVABLE])
    assert abs(columns.min() - 31) <= 1
    assert abs(columns.max() - 48) <= 1


def test_left_is_left_and_a_turned_car_sees_the_same():
    polygons = [band("sidewalk", 3, 6), band("drivable", -3, 3)]
    image = layout(polygons=polygons).image(camera())
    assert image[36, :40, SIDEWALK].any()
    assert not image[36, 40:, SIDEWALK].any()
    # The raster turns with the car; what a camera sees of the world does not.
    turned = layout(polygons=polygons, yaw=33.0).image(camera())
    assert (turned[..., :RAY] == image[..., :RAY]).mean() > 0.97


def test_a_road_that_climbs_is_seen_higher():
    polygon = band("drivable", -3, 3)
    polygon.rings[0][:, 2] = 0.1 * polygon.rings[0][:, 0]  # 10 percent, from the car's wheels on
    flat, hill = (layout(polygons=[p]).image(camera()) for p in (band("drivable", -3, 3), polygon))
    # The far end, at 39 m: 3.9 m up, 2.4 m above the camera, and 1.5 m below it on the flat.
    top = [int(np.nonzero(image[:, 40, DRIVABLE])[0][0]) for image in (flat, hill)]
    assert top == [pytest.approx(30 + 1.5, abs=1), pytest.approx(30 - 2.5, abs=1)]


def test_a_crossing_without_stripes_is_half_a_marking():
    image = layout(polygons=[band("crossing", -3, 3), band("marking", -3, 0)]).image(camera())
    assert image[36, 45, MARKING] == 1
    assert image[36, 35, MARKING] == CROSSING


def test_a_box_covers_the_ground_and_farther_boxes():
    road = [band("drivable", -9, 9, far=100.0)]
    image = layout(box(20.0), box(10.0, label="pedestrian"), polygons=road).image(camera())
    # The near face of the car is 18 m away: 4.4 columns wide, 3.3 rows high, from the ground up.
    assert image[31, 40, PEDESTRIAN] == 1
    assert image[31, 40, CAR] == 0
    assert image[31, 40, NEARNESS] == pytest.approx(0.4)
    assert image[31, 40, DRIVABLE] == 0
    alone = layout(box(20.0), polygons=road).image(camera())
    rows, columns = np.nonzero(alone[..., CAR])
    assert abs(columns.min() - 37.3) <= 1
    assert abs(columns.max() - 41.7) <= 1
    assert abs(rows.min() - 29.5) <= 1
    assert abs(rows.max() - 32.8) <= 1
    assert (alone[rows, columns, NEARNESS] == np.float32(0.2)).all()


def test_boxes_too_far_behind_or_of_no_kind_are_left_out():
    for away in (box(83.0), box(-20.0), box(10.0, 60.0)):
        assert not layout(away).image(camera())[..., CAR].any()
    assert layout(box(79.0)).image(camera())[..., CAR].any()


def test_a_box_that_reaches_behind_the_camera_is_cut():
    beside = layout(box(0.0, -2.0, length=8.0)).image(camera(yaw=-60.0))
    assert beside[..., CAR].mean() > 0.3
    assert beside[..., NEARNESS].max() == 1
    # The camera in the middle of a bus sees nothing else.
    assert layout(box(0.0, length=9.0, height=3.0)).image(camera())[..., CAR].all()


def test_rays_are_told_from_the_car_not_from_the_world():
    image = layout(yaw=90.0).image(camera(yaw=90.0))
    ahead = image[29:31, 39:41, RAY:].mean(axis=(0, 1))
    np.testing.assert_allclose(ahead, [1, 0.5, 0.5], atol=1e-3)
    assert (image[:, :40, RAY + 1] > 0.5).all()  # to the left
    assert (image[:30, :, RAY + 2] > 0.5).all()  # up
    lengths = np.linalg.norm(2 * image[..., RAY:] - 1, axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-5)


def test_corners_and_camera_numbers_are_of_the_car():
    there = Layout(None, [box(3.0, 6.0, yaw=90.0)], np.array([3.0, 1, HEIGHT]), 90.0)
    corners = there.corners()[0]
    # Five metres ahead, along the heading, on the ground.
    np.testing.assert_allclose(corners.mean(axis=0), [5, 0, 0.75 - HEIGHT], atol=1e-9)
    np.testing.assert_allclose(np.ptp(corners, axis=0), [4, 2, 1.5], atol=1e-9)
    np.testing.assert_allclose(corners[:4, 0], 7)  # its front
    numbers = there.camera_numbers(camera(yaw=90.0, x=3.0, y=2.0))
    np.testing.assert_allclose(numbers[:, :3], [[0.5, 0, 0.5], [0, 2 / 3, 0.5], [0, 0, 1]])
    # Right is against the left, down against up; the car is 1 m behind this camera.
    axes = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    np.testing.assert_allclose(numbers[:, 3:6], axes, atol=1e-9)
    np.testing.assert_allclose(numbers[:, 6], [0, 0, -1], atol=1e-9)
    assert layout().corners().shape == (0, 8, 3)


def test_from_above_boxes_stand_on_the_map():
    people = box(4.0, 3.0, label="pedestrian", length=1.0, width=1.0)
    seen = layout(box(5.0, yaw=45.0), people, polygons=[band("drivable", -3, 3)]).bev(16.0, 64)
    assert seen.shape == (64, 64, 6)
    # A cell is 25 cm; 5 m ahead are 20 cells above the middle.
    assert seen[32 - 20, 32, 4]
    assert seen[32 - 16, 32 - 12, 5]
    assert not seen[40:, :, :].any()
    share = seen[..., 4].sum() / 16
    assert 8 <= share < 10  # 8 square metres, and the cells on its edge


def test_without_map_or_boxes_there_are_rays_alone():
    image = layout().image(camera())
    assert not image[..., :RAY].any()
    assert image[..., RAY:].all()
    assert not layout().bev(20.0, 8).any()


def test_a_layout_is_of_what_a_method_declared(tmp_path):
    scene = write_tiny_scene(tmp_path / "tiny")
    whole = Layout.of(Views(scene, scene.cameras, ("tracks", "map"), "layout"), 1)
    assert len(whole.boxes) == 1
    np.testing.assert_allclose(whole.place, scene.camera("front", 1).centre)
    assert whole.yaw == pytest.approx(0, abs=1e-9)
    image = whole.image(scene.camera("front", 1))
    assert image[..., CAR].any()
    assert image[..., DRIVABLE].any()
    blind = Layout.of(Views(scene, scene.cameras, (), "layout"), 1)
    assert (blind.road_map, blind.boxes) == (None, [])
    # The heading, where the split withholds the front camera, or all but one.
    for cameras, yaw in ((("left", "right"), 0), (("left",), 45)):
        found = Layout.of(Views(scene, cameras, (), "layout"), 0)
        assert found.yaw == pytest.approx(yaw, abs=1e-9)


def test_a_sheet_has_all_cameras_from_left_to_right(tmp_path):
    scene = write_tiny_scene(tmp_path / "tiny")
    sheet = layout_sheet(scene, 0)
    assert sheet.shape == (3 * 52, 3 * 76 + 156, 3)
    for column, name in enumerate(("left", "front", "right")):
        shown = sheet[:48, 76 * column : 76 * column + 72]
        np.testing.assert_array_equal(shown, np.rint(255 * scene.image(name, 0)))
    bare = write_tiny_scene(tmp_path / "bare", extras=SceneExtras())
    assert layout_sheet(bare, 0).shape == sheet.shape


def test_colours_tell_near_from_far():
    near, far = (false_colour(layout(box(x)).image(camera())) for x in (6.0, 40.0))
    assert near[31, 40, 2] > far[31, 40, 2] > 0
    assert not near[:20].any()

"""The procedural streets: what they promise about geometry, light, motion and repetition."""

import subprocess
import sys

import drjit
import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import TRACK_COLUMNS, SceneRef, load_source
from geoevs.scenes.sources.street.finishes import make_finishes
from geoevs.scenes.sources.street.layout import LAYOUTS, make_street
from geoevs.scenes.sources.street.lidar import RANGE_NOISE, scan
from geoevs.scenes.sources.street.light import make_light
from geoevs.scenes.sources.street.mesh import MeshBuilder, icosphere
from geoevs.scenes.sources.street.people import SIZE as SIZE_OF_PERSON
from geoevs.scenes.sources.street.people import Person
from geoevs.scenes.sources.street.render import (
    Lattice,
    lattice_shifts,
    pixel_rays,
    render_depth,
    render_image,
)
from geoevs.scenes.sources.street.rig import Ego, make_cameras
from geoevs.scenes.sources.street.source import INTERVAL, LONGEST, Source, World
from geoevs.scenes.sources.street.stage import Stage, mitsuba
from geoevs.scenes.sources.street.traffic import make_actors

SIZE = (24, 36)
OPTIONS = {"frames": 2, "lidar_azimuths": 40, "samples": 4}
STREET = SceneRef("straight-7")


@pytest.fixture(scope="module")
def source():
    return Source(*SIZE, **OPTIONS)


@pytest.fixture(scope="module")
def frames(source):
    return list(source.open(STREET).frames)


@pytest.fixture(scope="module")
def world(source):
    return source._enter(STREET)  # shared, because building a street takes seconds


@pytest.fixture(scope="module")
def scenes(world):
    return world.at(0)


def level_camera(height=2.0, fx=30.0, fy=30.0, cx=20.0, cy=12.0, rows=24, columns=40):
    """A camera above the origin that looks along world x."""
    pose = np.eye(4)
    pose[:3] = [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, height]]
    return Camera([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], pose, rows, columns)


def stage_of(builder):
    rng = np.random.default_rng(0)
    light = make_light(rng)
    return light, Stage(light, make_finishes(rng), builder.surfaces()).with_moving({})


def square(builder, low, high, z, colour):
    (x0, y0), (x1, y1) = low, high
    corners = np.array([[[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]])
    builder.quads("matte", corners, colour)


def psnr(one, other):
    return 10 * np.log10(255**2 / np.mean((one.astype(float) - other.astype(float)) ** 2))


def into(points, camera):
    """Pixel coordinates and depth of world points."""
    local = points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    pixels = local @ camera.K.T
    return pixels[:, :2] / pixels[:, 2:], local[:, 2]


def test_a_scene_is_a_pure_function_of_its_name(frames):
    again = next(Source(*SIZE, **OPTIONS).open(STREET).frames)
    for name, image in frames[0].images.items():
        assert again.images[name].tobytes() == image.tobytes()
    assert again.points.xyz.tobytes() == frames[0].points.xyz.tobytes()


def test_thread_count_does_not_matter(source, frames):
    threads = drjit.thread_count()
    drjit.set_thread_count(1)
    try:
        alone = next(source.open(STREET).frames)
    finally:
        drjit.set_thread_count(threads)
    assert alone.images["front"].tobytes() == frames[0].images["front"].tobytes()


def test_another_seed_is_another_street(world):
    other = World("straight-8")
    assert not np.allclose(other.light.to_sun, world.light.to_sun)
    assert len(other.actors) != len(world.actors) or any(
        one.start != another.start for one, another in zip(other.actors, world.actors, strict=True)
    )


def test_truth_at_a_recorded_pose_is_the_recording_up_to_its_sampling(source, frames):
    cameras, images = frames[0].cameras, frames[0].images
    truth = list(source.truth(STREET, [(camera, 0) for camera in cameras.values()]))
    for name, one in zip(cameras, truth, strict=True):
        assert one.rgb.tobytes() != images[name].tobytes()
        assert psnr(one.rgb, images[name]) > 17  # four rays a pixel as wide as a door


def test_the_sampling_error_falls_with_the_samples(world, scenes):
    camera = make_cameras(world.ego.pose(0.0), 48, 72)["side_left"]

    def pair(samples):
        both = [
            render_image(scenes, camera, world.light, world.actors, 0.0, samples, rng)
            for rng in map(np.random.default_rng, (1, 2))
        ]
        return psnr(*both)

    assert pair(25) > max(38, pair(4) + 5)


def test_frames_differ_because_ego_and_traffic_move(frames):
    first, second = frames
    moved = np.linalg.norm(first.cameras["front"].centre - second.cameras["front"].centre)
    assert 0.8 <= moved <= 1.2  # 8 to 12 m/s, a tenth of a second apart
    assert second.timestamp == pytest.approx(INTERVAL)


def test_the_rig_looks_where_waymos_does(frames):
    cameras = frames[0].cameras
    yaws = {name: camera.yaw - cameras["front"].yaw for name, camera in cameras.items()}
    expected = {"front": 0, "front_left": 45, "front_right": -45, "side_left": 90}
    assert yaws == pytest.approx({**expected, "side_right": -90})
    for camera in cameras.values():
        assert camera.optical_axis[2] == pytest.approx(0)
        assert 1.9 < camera.centre[2] < 2.3
        width = 2 * np.degrees(np.arctan(camera.width / 2 / camera.K[0, 0]))
        assert width == pytest.approx(50)
    centres = np.array([camera.centre for camera in cameras.values()])
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)[np.triu_indices(5, 1)]
    assert apart.min() > 0.1
    assert apart.max() < 1.0


def test_field_of_view_is_the_same_at_every_shape():
    wide, square_ = (make_cameras(np.eye(4), 64, w)["front"] for w in (96, 64))
    assert wide.K[0, 0] == pytest.approx(wide.K[1, 1])
    np.testing.assert_allclose(square_.K, wide.resized(64, 64).K)


@pytest.mark.parametrize(("fx", "fy"), [(30.0, 30.0), (30.0, 41.0)])
def test_depth_is_along_the_optical_axis_at_pixel_centres(fx, fy):
    builder = MeshBuilder()
    square(builder, (-50, -400), (800, 400), 0.0, (0.5, 0.5, 0.5))
    camera = level_camera(height=2.0, fx=fx, fy=fy, cy=11.5)
    _, scenes = stage_of(builder)
    depth = render_depth(scenes, camera)
    # Ground 2 m below a level camera: row v sees depth z where (v + 0.5 - cy) / fy = 2 / z.
    rows = np.arange(13, 24)
    expected = 2.0 * fy / (rows + 0.5 - 11.5)
    np.testing.assert_allclose(depth[rows], np.tile(expected[:, None], 40), rtol=1e-4)
    assert (depth[:11] == 0).all()  # sky


@pytest.mark.parametrize(("fx", "fy"), [(60.0, 60.0), (60.0, 41.0), (37.0, 60.0)])
def test_pictures_show_things_where_the_camera_projects_them(fx, fy):
    builder = MeshBuilder()
    square(builder, (-50, -400), (800, 400), 0.0, (0.02, 0.02, 0.02))
    square(builder, (11, 1), (13, 3), 0.2, (0.8, 0.8, 0.8))
    camera = level_camera(height=6.0, fx=fx, fy=fy, cx=23.0, cy=2.0, rows=48, columns=44)
    light, scenes = stage_of(builder)
    image = render_image(scenes, camera, light, [], 0.0, 9, np.random.default_rng(1)).astype(float)
    weight = np.clip(image.mean(axis=2) - 100, 0, None)
    weight[:8] = 0  # the sky
    rows, columns = np.mgrid[:48, :44] + 0.5
    seen = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
    spread = np.linspace(-1, 1, 21)
    grid = np.stack([*np.meshgrid(12 + spread, 2 + spread), np.full((21, 21), 0.2)], axis=-1)
    pixels, depth = into(grid.reshape(-1, 3), camera)
    area = depth**-3  # of a pixel's worth of ground
    np.testing.assert_allclose(seen, (pixels * area[:, None]).sum(0) / area.sum(), atol=0.25)


def test_every_ray_counts_for_the_pixel_it_falls_in():
    camera = level_camera(fx=30.0, fy=47.0, rows=25, columns=41)
    for shift in lattice_shifts(5, np.random.default_rng(0)):
        lattice = Lattice(camera, shift)
        assert lattice.rays.min() >= 1
        width = int(np.ceil(41 * 47 / 30 - 1e-6))
        assert lattice.rays.sum() == 25 * width
        places = np.broadcast_to((np.arange(width) + shift[0]) * 30 / 47, (25, width))
        pixel = lattice.per_pixel(np.floor(places)[..., None])[..., 0] / lattice.rays[..., 0]
        np.testing.assert_array_equal(pixel[:, :40], np.tile(np.arange(40), (25, 1)))


def test_lattice_shifts_share_no_row_and_no_column():
    shifts = lattice_shifts(25, np.random.default_rng(0))
    for axis in (0, 1):
        gaps = np.diff(np.sort(shifts[:, axis]))
        np.testing.assert_allclose(gaps, 1 / 25)


def test_the_mirrored_sky_lies_where_the_sky_is():
    builder = MeshBuilder()
    square(builder, (-5, -5), (-4, -4), -3.0, (0.5, 0.5, 0.5))
    light, scenes = stage_of(builder)
    camera = level_camera(cy=40.0, rows=40)  # looks up
    rays = pixel_rays(camera)[:24]  # well above the horizon
    expected = light.sky(rays / np.linalg.norm(rays, axis=-1, keepdims=True))
    lattice = Lattice(camera, np.array([0.5, 0.5]))
    seen = lattice.see(scenes.mirror, "glow")[:24]
    np.testing.assert_allclose(seen, expected, atol=0.03)
    assert expected.std(axis=(0, 1)).min() > 0.02  # so that a turned sky would not pass


def test_lidar_lies_on_the_surfaces_that_depth_sees(world, scenes):
    points = scan(scenes.lit, world.ego.pose(0.0), 300, np.random.default_rng(0))
    errors = []
    for camera in make_cameras(world.ego.pose(0.0), 96, 144).values():
        depth = render_depth(scenes, camera)
        pixels, z = into(points.xyz.astype(float), camera)
        place = pixels - 0.5
        left = np.floor(place).astype(int)
        inside = (z > 0) & (left >= 0).all(axis=1) & (left < [143, 95]).all(axis=1)
        (u, v), (a, b) = left[inside].T, (place - left)[inside].T
        # One over depth is linear in the image on every plane.
        corners = [(v, u, (1 - a) * (1 - b)), (v, u + 1, a * (1 - b)), (v + 1, u, (1 - a) * b),
                   (v + 1, u + 1, a * b)]  # fmt: skip
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = sum(weight / depth[r, c] for r, c, weight in corners)
        errors.append(np.abs(z[inside] - 1 / inverse))
    errors = np.concatenate(errors)
    assert len(errors) > 5000
    assert 0.3 * RANGE_NOISE < np.median(errors) < 1.2 * RANGE_NOISE


def test_people_fit_their_boxes():
    person = Person(np.random.default_rng(3))
    for distance in np.linspace(0, 2, 9):
        (body,) = person.mesh(distance).surfaces().values()
        corners = body.corners.reshape(-1, 3)
        assert (np.abs(corners[:, :2]).max(axis=0) <= np.array(SIZE_OF_PERSON[:2]) / 2 + 0.02).all()
        assert corners[:, 2].min() > -0.06
        assert corners[:, 2].max() < SIZE_OF_PERSON[2] + 0.02


def test_lidar_has_64_beams_from_the_top_and_loses_more_on_glass(world, scenes):
    points = scan(scenes.lit, world.ego.pose(0.0), 60, np.random.default_rng(0))
    assert points.beam.min() >= 0
    assert points.beam.max() == 63
    assert (points.camera == -1).all()
    height = [points.xyz[points.beam == beam, 2].mean() for beam in (8, 40, 63)]
    assert height[0] > height[1] > height[2]
    assert 0.6 * 64 * 60 < len(points) < 0.98 * 64 * 60


def test_a_static_point_has_one_colour_in_two_cameras(source, world):
    cameras = make_cameras(world.ego.pose(0.0), 96, 144)
    pair = [cameras["front"], cameras["front_left"]]
    one, other = source.truth(STREET, [(camera, 0) for camera in pair])
    rays = pixel_rays(pair[0])
    points = (pair[0].centre + one.depth[..., None] * rays)[one.depth > 0]
    pixels, z = into(points, pair[1])
    u, v = np.floor(pixels).astype(int).T
    inside = (z > 0) & (u >= 0) & (u < 144) & (v >= 0) & (v < 96)
    seen = np.zeros(len(points), bool)
    seen[inside] = np.abs(other.depth[v[inside], u[inside]] / z[inside] - 1) < 0.01
    assert seen.sum() > 200
    colour = one.rgb[one.depth > 0][seen].astype(float)
    apart = np.abs(colour - other.rgb[v[seen], u[seen]])
    assert np.median(apart) <= 6


def test_tracks_move_as_they_say(source):
    tracks = source.open(STREET).tracks
    assert tuple(tracks.columns) == TRACK_COLUMNS
    assert sorted(tracks.frame.unique()) == [0, 1]
    first, second = (tracks[tracks.frame == i].set_index("track") for i in (0, 1))
    moved = np.linalg.norm(first[["x", "y"]] - second.loc[first.index, ["x", "y"]], axis=1)
    assert (moved[first.moving] > 0.05).all()
    assert (moved[~first.moving] == 0).all()
    assert set(first[first.moving].label) == {"car", "pedestrian"}
    heading = np.radians(first.yaw)
    step = second.loc[first.index, ["x", "y"]].to_numpy() - first[["x", "y"]].to_numpy()
    ahead = step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)
    np.testing.assert_allclose(ahead, moved, atol=0.01)  # everybody walks and drives forward


def test_moving_boxes_hold_the_points_of_their_cars(world):
    time = 5 * INTERVAL
    scenes = world.at(5)
    points = scan(scenes.lit, world.ego.pose(time), 500, np.random.default_rng(0)).xyz
    found = 0
    for actor in world.actors:
        if actor.label != "car" or not actor.moving:
            continue
        place = actor.at(time)
        cos, sin = np.cos(place.yaw), np.sin(place.yaw)
        local = (points[:, :2] - [place.x, place.y]) @ np.array([[cos, -sin], [sin, cos]])
        beside = np.abs(local) - np.array(actor.size[:2]) / 2
        near = (beside < 0.5).all(axis=1) & (points[:, 2] > 0.25)
        if near.sum() < 20:
            continue
        found += 1
        assert (beside[near] < 3 * RANGE_NOISE + 0.02).all(axis=1).mean() > 0.98
        assert points[near, 2].max() < actor.size[2] + 0.1
    assert found >= 1


@pytest.mark.parametrize("layout", LAYOUTS)
def test_nobody_comes_near_the_ego_and_it_keeps_its_lane(layout):
    for seed in range(6):
        street = make_street(layout, np.random.default_rng(seed))
        ego = Ego(street, 12.0)
        actors = make_actors(street, ego.speed, np.random.default_rng(seed))
        for frame in range(0, round(LONGEST / INTERVAL), 6):
            pose = ego.pose(frame * INTERVAL)
            for actor in actors:
                place = actor.at(frame * INTERVAL)
                local = (np.array([place.x, place.y, 0]) - pose[:3, 3]) @ pose[:3, :3]
                half = np.array(actor.size[:2]) / 2
                clear = np.abs(local[:2]) - half
                # Half a vehicle's width aside, and 3 m beyond its ends.
                assert clear[0] > 5.0 or clear[1] > 1.0, (layout, seed, frame, actor.track)


@pytest.mark.parametrize("layout", ["curve", "junction"])
def test_there_is_ground_everywhere_and_no_house_on_the_road(layout):
    world = World(f"{layout}-3")
    scenes = world.at(0)
    pose = world.ego.pose(0.0)
    for name, camera in make_cameras(pose, 24, 36).items():
        depth = render_depth(scenes, camera)
        assert (depth[13:] > 0).all(), name
    ahead = pose[:3, 3] + pose[:3, 0] * np.arange(4, 16)[:, None] + [0, 0, 2.6]
    down = make_cameras(pose, 24, 36)["front"].world_from_camera.copy()
    down[:3, :3] = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]]).T
    for centre in ahead:
        down[:3, 3] = centre
        camera = Camera([[40, 0, 0.5], [0, 40, 0.5], [0, 0, 1]], down, 1, 1)
        assert render_depth(scenes, camera)[0, 0] == pytest.approx(2.6, abs=0.02)


def test_no_surface_is_inside_out(world, scenes):
    mi = mitsuba()
    facing = []
    for camera in make_cameras(world.ego.pose(0.0), 24, 36).values():
        for ray in pixel_rays(camera).reshape(-1, 3):
            hit = scenes.lit.ray_intersect(mi.Ray3f(camera.centre, ray))
            if hit.is_valid():
                facing.append(np.dot(hit.n, ray) < 0)
    # Surfaces glow on their outside only. Leaves may show the rim between their two sides.
    assert np.mean(facing) > 0.997


def test_spheres_are_closed_and_face_outward():
    ball = icosphere(1)
    assert len(ball) == 80
    volume = np.einsum("ni,ni->n", ball[:, 0], np.cross(ball[:, 1], ball[:, 2])).sum() / 6
    assert 0.85 * 4 / 3 * np.pi < volume < 4 / 3 * np.pi


def test_ranges_of_frames_are_honoured(source, frames):
    record = source.open(SceneRef(STREET.name, 1, 1))
    assert record.frame_count == 1
    assert set(record.tracks.frame) == {1}
    (only,) = record.frames
    assert only.frame == 1
    assert only.images["front"].tobytes() == frames[1].images["front"].tobytes()


@pytest.mark.parametrize(
    ("name", "hint"),
    [("strait-1", "did you mean 'straight'"), ("straight", "straight-101"), ("curve-x", "SEED")],
)
def test_a_name_that_is_no_street_is_explained(source, name, hint):
    with pytest.raises(GeoEvsError, match=hint):
        source.open(SceneRef(name))


def test_frames_that_do_not_exist_are_refused(source):
    for first, last in ((5, 9), (1, 2)):
        with pytest.raises(GeoEvsError, match=f"no frame {max(first, 2)}; its frames are 0 to 1"):
            source.open(SceneRef(STREET.name, first, last))
    with pytest.raises(GeoEvsError, match="no frame 2"):
        source.truth(STREET, [(level_camera(), 2)])


def test_options_out_of_range_are_refused():
    with pytest.raises(GeoEvsError, match="99 for its option 'traffic_speed'; choose from 0 to 40"):
        load_source("street", 8, 8, {"traffic_speed": 99})
    with pytest.raises(GeoEvsError, match="0 for its option 'frames'; choose from 1 to 60"):
        load_source("street", *SIZE, {"frames": 0})


def test_mitsuba_is_imported_only_to_render():
    code = (
        "import sys; from geoevs.scenes.sources.street.source import Source; Source(8, 8);"
        "sys.exit('mitsuba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_frames_may_lie_farther_apart():
    near, far = Source(*SIZE, frames=2), Source(*SIZE, frames=2, interval=1.5)
    ref = SceneRef("straight-8", 1, 1)
    moved = [next(source.open(ref).frames) for source in (near, far)]
    assert [frame.timestamp for frame in moved] == [pytest.approx(0.1), pytest.approx(1.5)]
    start = next(near.open(SceneRef("straight-8", 0, 0)).frames).cameras["front"].centre
    reach = [np.linalg.norm(frame.cameras["front"].centre - start) for frame in moved]
    assert reach[1] == pytest.approx(15 * reach[0], rel=1e-6)


def test_traffic_takes_the_speed_it_is_given():
    street = make_street("junction", np.random.default_rng(7))
    usual, fast, still = (
        make_actors(street, 10.0, np.random.default_rng(8), speed) for speed in (None, 20.0, 0.0)
    )
    driving = [actor.moving and actor.label == "car" for actor in usual]
    assert sum(driving) > 3
    for one, other, parked, drives in zip(usual, fast, still, driving, strict=True):
        assert one.at(0.0) == other.at(0.0)
        assert np.allclose(one.at(0.0), parked.at(0.0))  # and faces the same way
        assert abs(other.speed) == (20.0 if drives else abs(one.speed))
        assert np.sign(other.speed) == np.sign(one.speed)
        assert parked.speed == (0.0 if drives else one.speed)


def test_a_scene_longer_than_its_street_is_refused():
    with pytest.raises(GeoEvsError, match="streets last 6 s"):
        Source(*SIZE, frames=60, interval=0.2)


def test_recorded_depth_is_the_truth_at_the_recorded_pose():
    source = Source(*SIZE, frames=1)
    frame = next(source.open(SceneRef("straight-8")).frames)
    truth = next(iter(source.truth(SceneRef("straight-8"), [(frame.cameras["front"], 0)])))
    np.testing.assert_array_equal(frame.depths["front"], truth.depth)

"""The validity operator: expected values derived by hand, and one answer from every path."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from geoevs.core.errors import GeoEvsError
from geoevs.projection import (
    FOOTPRINT_RADIUS,
    FOOTPRINT_TOLERANCE,
    ZBuffer,
    colour_points,
    project_points,
    rasterize_points,
    unproject_depth,
    validity,
    visible,
    zbuffer,
)
from geoevs.projection.kernels import BLOCK, lens_of, project_torch, zbuffer_numba, zbuffer_torch
from geoevs.projection.reference import zbuffer_reference
from geoevs.scenes.camera import Camera
from geoevs.scenes.scene import PointCloud

# x forward along world x, y to the left, z up: a camera that looks along world x.
FORWARD = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])


def simple_camera(height: int = 4, width: int = 6, focal: float = 2.0) -> Camera:
    """At the origin, world axes; the optical axis hits the corner between the middle pixels."""
    return Camera(
        [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.eye(4), height, width
    )


def turned_camera(rng: np.random.Generator, height: int, width: int) -> Camera:
    """Any pose, and unequal focal lengths."""
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = rng.normal(size=3)
    fx, fy = rng.uniform(0.5, 3, 2) * width
    K = [[fx, 0, width / 2], [0, fy, height / 3], [0, 0, 1]]
    return Camera(K, pose, height, width)


def same_bits(found: ZBuffer, expected: tuple) -> bool:
    """Whether two z-buffers are equal to the last bit, types and shapes included."""
    pairs = zip(map(np.asarray, found), map(np.asarray, expected), strict=True)
    return all(
        a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in pairs
    )


# A kernel compiles at its first call, which says nothing about the later ones.
UNTIMED = settings(deadline=None)

# Few values, so that pixels and depths coincide; and those that arithmetic trips over.
LATTICE = st.sampled_from([-1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0])
STRANGE = st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300, 5e-324, -0.0])


def clouds(values: st.SearchStrategy) -> st.SearchStrategy:
    """(N, 3) float64 points, N from 0 up."""
    return st.integers(0, 60).flatmap(lambda n: hnp.arrays(np.float64, (n, 3), elements=values))


CLOUDS = st.one_of(
    clouds(LATTICE), clouds(st.one_of(LATTICE, STRANGE)), clouds(st.floats(width=64))
)


class TestProjectPoints:
    def test_by_hand(self) -> None:
        camera = Camera([[100, 0, 50], [0, 200, 40], [0, 0, 1]], np.eye(4), 80, 100)
        uv, depth = project_points(np.array([[0.5, -0.2, 4.0], [0, 0, 7.0]]), camera)
        # u = 100 * 0.5 / 4 + 50, v = 200 * -0.2 / 4 + 40
        np.testing.assert_array_equal(uv, [[62.5, 30.0], [50.0, 40.0]])
        np.testing.assert_array_equal(depth, [4.0, 7.0])

    def test_posed_camera_sees_left_on_the_left_and_up_above(self) -> None:
        pose = FORWARD.copy()
        pose[:3, 3] = [10, 20, 2]
        camera = Camera([[100, 0, 50], [0, 100, 40], [0, 0, 1]], pose, 80, 100)
        # 5 m ahead, 1 m to the left (world +y) and 0.5 m up of the camera's centre
        uv, depth = project_points(np.array([[15, 21, 2.5]]), camera)
        np.testing.assert_allclose(uv, [[50 - 100 / 5, 40 - 50 / 5]], rtol=1e-14)
        np.testing.assert_allclose(depth, [5.0], rtol=1e-14)

    @pytest.mark.parametrize("z", [-1.0, 0.0, -0.0, np.inf, np.nan])
    def test_no_pixel_without_a_positive_finite_depth(self, z: float) -> None:
        for x in (0.0, 1.0):
            uv, depth = project_points(np.array([[x, x, z]]), simple_camera())
            assert np.isnan(uv).all()
            np.testing.assert_array_equal(depth, [z])

    def test_no_pixel_where_the_depth_overflows(self) -> None:
        pose, half = np.eye(4), np.sqrt(0.5)
        pose[:3, :3] = [[half, 0, half], [0, 1, 0], [-half, 0, half]]
        camera = Camera(simple_camera().K, pose, 4, 6)
        points = np.array([[1.5e308, 0, 1.5e308]])  # on the axis, 2.1e308 m away
        uv, depth = project_points(points, camera)
        assert depth == np.inf
        assert np.isnan(uv).all()
        assert not zbuffer(points, camera).mask.any()

    @UNTIMED
    @given(CLOUDS, st.integers(0, 2**32))
    def test_same_bits_on_every_path(self, points: np.ndarray, seed: int) -> None:
        camera = turned_camera(np.random.default_rng(seed), 5, 7)
        uv, depth = project_points(points, camera)
        tensor_uv, tensor_depth = project_points(torch.from_numpy(points), camera)
        ops_uv, ops_depth = project_torch(torch.from_numpy(points), lens_of(camera))
        for other_uv, other_depth in ((tensor_uv, tensor_depth), (ops_uv, ops_depth)):
            np.testing.assert_array_equal(uv, other_uv.numpy(), strict=True)
            np.testing.assert_array_equal(depth, other_depth.numpy(), strict=True)

    @pytest.mark.parametrize("shape", [(3,), (4, 2), (2, 3, 3)])
    def test_refuses_other_shapes(self, shape: tuple) -> None:
        with pytest.raises(GeoEvsError, match=r"reshape them to \(N, 3\)"):
            project_points(np.zeros(shape), simple_camera())


class TestUnprojectDepth:
    def test_by_hand(self) -> None:
        depth = np.zeros((4, 6), np.float32)
        depth[1, 4] = 8.0
        points, pixels = unproject_depth(depth, simple_camera())
        # pixel centre (4.5, 1.5), 1.5 right of and 0.5 above the centre (3, 2), focal length 2
        np.testing.assert_array_equal(points, [[1.5 / 2 * 8, -0.5 / 2 * 8, 8.0]])
        np.testing.assert_array_equal(pixels, [1 * 6 + 4])
        assert points.dtype == np.float64
        assert pixels.dtype == np.int64

    def test_lifts_only_positive_finite_depth(self) -> None:
        depth = np.ones((4, 6))
        depth[0, :4] = [0, -1, np.nan, np.inf]
        _, pixels = unproject_depth(depth, simple_camera())
        np.testing.assert_array_equal(pixels, np.arange(4, 24))

    @UNTIMED
    @given(st.integers(0, 2**32))
    def test_projects_back_to_the_pixels_it_came_from(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        camera = turned_camera(rng, 5, 7)
        depth = rng.uniform(0.1, 80, (5, 7)) * (rng.random((5, 7)) < 0.7)
        points, pixels = unproject_depth(depth, camera)
        uv, _ = project_points(points, camera)
        centres = np.stack([pixels % 7 + 0.5, pixels // 7 + 0.5], 1)
        np.testing.assert_allclose(uv, centres, atol=1e-9)
        again = zbuffer(points, camera)
        np.testing.assert_array_equal(again.mask, depth > 0)
        np.testing.assert_allclose(again.depth, depth, rtol=1e-12, atol=1e-12)

    def test_tensors_give_the_same_bits(self) -> None:
        rng = np.random.default_rng(0)
        camera = turned_camera(rng, 5, 7)
        depth = rng.uniform(-1, 80, (5, 7)).astype(np.float32)
        expected = unproject_depth(depth, camera)
        found = unproject_depth(torch.from_numpy(depth).requires_grad_(), camera)
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_array_equal(a.numpy(), b, strict=True)

    def test_refuses_a_map_of_another_size(self) -> None:
        with pytest.raises(GeoEvsError, match="the depth map is 6 x 4 but"):
            unproject_depth(np.ones((6, 4)), simple_camera())


class TestZBuffer:
    def test_front_most_wins_and_ties_go_to_the_lower_index(self) -> None:
        points = np.array([[0.1, 0.1, 9.0], [0.1, 0.1, 5.0], [0.2, 0.2, 5.0], [0.1, 0.1, 7.0]])
        index, depth = found = zbuffer(points, simple_camera())
        expected = np.full((4, 6), -1)
        expected[2, 3] = 1
        np.testing.assert_array_equal(index, expected)
        np.testing.assert_array_equal(depth, np.where(expected < 0, 0.0, 5.0))
        np.testing.assert_array_equal(found.mask, expected >= 0)

    @pytest.mark.parametrize(
        ("x", "y", "pixel"),
        [
            (-3.0, -2.0, (0, 0)),  # u = 0 and v = 0 are in the frame
            (3.0, 0.0, None),  # u = W is not
            (0.0, 2.0, None),  # v = H is not
            (3 - 1e-12, 2 - 1e-12, (3, 5)),
            (np.nextafter(-3, -4), 0.0, None),
            (1e300, 0.0, None),
            (0.0, -1e300, None),
        ],
    )
    def test_border_of_the_frame(self, x: float, y: float, pixel: tuple | None) -> None:
        points, camera = np.array([[x, y, 2.0]]), simple_camera()
        index, _ = found = zbuffer(points, camera)
        filled = [tuple(map(int, place)) for place in np.argwhere(index >= 0)]
        assert filled == ([] if pixel is None else [pixel])
        # As plain Python the same lines check their indices: nothing is written out of bounds.
        assert same_bits(zbuffer_numba.py_func(points, lens_of(camera)), found)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("axis", [0, 1, 2])
    def test_points_that_are_not_finite_are_never_valid(self, bad: float, axis: int) -> None:
        points = np.array([[0.0, 0.0, 2.0]])
        points[0, axis] = bad
        for camera in (simple_camera(), Camera(simple_camera().K, FORWARD, 4, 6)):
            assert not zbuffer(points, camera).mask.any()

    def test_smallest_depth_there_is_counts(self) -> None:
        index, depth = zbuffer(np.array([[0, 0, 1.0], [0, 0, 5e-324]]), simple_camera())
        assert index[2, 3] == 1
        assert depth[2, 3] == 5e-324

    def test_behind_and_empty(self) -> None:
        for points in (np.zeros((0, 3)), np.array([[0.0, 0.0, -2.0], [0.0, 0.0, 0.0]])):
            index, depth = zbuffer(points, simple_camera())
            assert (index == -1).all()
            assert (depth == 0).all()

    @UNTIMED
    @given(CLOUDS, st.integers(0, 2**32), st.booleans())
    @example(np.array([[0.0, 0.0, 1.0]] * 3), 0, False)
    def test_every_path_gives_the_same_bits(
        self, points: np.ndarray, seed: int, single: bool
    ) -> None:
        camera = turned_camera(np.random.default_rng(seed), 5, 7)
        if single:
            with np.errstate(over="ignore"):
                points = points.astype(np.float32)
        tensor = torch.from_numpy(points)
        expected = zbuffer_reference(points, camera)
        assert same_bits(zbuffer(points, camera), expected)
        assert same_bits(zbuffer(tensor, camera), expected)
        assert same_bits(zbuffer_torch(tensor, lens_of(camera)), expected)

    @pytest.mark.parametrize("count", [1, BLOCK - 1, BLOCK, BLOCK + 1, 5 * BLOCK + 17])
    def test_crowded_pixels_across_blocks(self, count: int) -> None:
        rng = np.random.default_rng(count)
        points = rng.integers(-4, 5, (count, 3)) * [0.5, 0.5, 1.0]
        camera = simple_camera()
        expected = zbuffer_reference(points, camera)
        assert same_bits(zbuffer(points, camera), expected)
        assert same_bits(zbuffer_torch(torch.from_numpy(points), lens_of(camera)), expected)

    @pytest.mark.parametrize(
        "layout",
        [
            lambda points: np.asfortranarray(points),
            lambda points: np.concatenate([points, points], 1)[:, :3],
            lambda points: points[::-1][::-1],
            lambda points: points.astype(">f8"),
            lambda points: points.astype(np.float16),
            lambda points: torch.from_numpy(points).to(torch.bfloat16),
            lambda points: torch.from_numpy(points).half().requires_grad_(),
            lambda points: torch.from_numpy(points).int(),
        ],
    )
    def test_layout_and_number_type_do_not_matter(self, layout) -> None:
        points = np.random.default_rng(0).integers(-4, 5, (99, 3)).astype(np.float64)
        assert same_bits(zbuffer(layout(points), simple_camera()), zbuffer(points, simple_camera()))

    def test_frozen_input_is_read(self) -> None:
        points = np.array([[0.0, 0.0, 2.0]])
        points.setflags(write=False)
        assert zbuffer(points, simple_camera()).mask.sum() == 1

    @UNTIMED
    @given(st.integers(0, 2**32))
    def test_order_of_points_changes_only_their_numbers(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        camera = simple_camera()
        points = rng.uniform([-9, -9, 1], [9, 9, 9], (80, 3))
        shuffle = rng.permutation(80)
        index, depth = zbuffer(points, camera)
        other = zbuffer(points[shuffle], camera)
        np.testing.assert_array_equal(other.depth, depth)
        np.testing.assert_array_equal(
            np.where(other.mask, shuffle[other.index], -1), np.where(index < 0, -1, index)
        )

    def test_unknown_visibility(self) -> None:
        with pytest.raises(GeoEvsError, match="did you mean 'pixel'"):
            zbuffer(np.zeros((1, 3)), simple_camera(), "pixels")

    def test_does_not_import_torch(self) -> None:
        lines = "import sys, geoevs.projection; sys.exit('torch' in sys.modules)"
        assert subprocess.run([sys.executable, "-c", lines], check=False).returncode == 0


class TestFootprint:
    def wall_behind_posts(self) -> tuple[np.ndarray, Camera]:
        """Posts 10 m away, every 4th column; a wall at 30 m shows in the columns between."""
        camera = simple_camera(height=3, width=13, focal=10.0)
        depth = np.zeros((3, 13))
        depth[1, ::4] = 10.0
        depth[1, [2, 6]] = 30.0
        return unproject_depth(depth, camera)[0], camera

    def test_removes_background_that_leaks_between_foreground(self) -> None:
        points, camera = self.wall_behind_posts()
        assert zbuffer(points, camera).mask.sum() == 6
        found = zbuffer(points, camera, "footprint")
        np.testing.assert_array_equal(np.argwhere(found.mask), [[1, 0], [1, 4], [1, 8], [1, 12]])
        np.testing.assert_array_equal(visible(points, camera, "footprint"), points[:, 2] < 20)

    def test_window_and_tolerance_by_hand(self) -> None:
        camera = simple_camera(height=1, width=9, focal=10.0)

        def survives(gap: int, depth: float) -> bool:
            pair = np.zeros((1, 9))
            pair[0, 0], pair[0, gap] = 10.0, depth
            points, _ = unproject_depth(pair, camera)
            return bool(zbuffer(points, camera, "footprint").mask[0, gap])

        edge = 10.0 / (1 - FOOTPRINT_TOLERANCE)
        assert survives(FOOTPRINT_RADIUS, edge * 0.999)
        assert not survives(FOOTPRINT_RADIUS, edge * 1.001)
        assert survives(FOOTPRINT_RADIUS + 1, edge * 1.001)

    @UNTIMED
    @given(CLOUDS, st.integers(0, 2**32))
    def test_is_part_of_the_pixel_rule_and_the_same_on_every_path(
        self, points: np.ndarray, seed: int
    ) -> None:
        camera = turned_camera(np.random.default_rng(seed), 9, 11)
        plain = zbuffer(points, camera)
        found = zbuffer(points, camera, "footprint")
        np.testing.assert_array_equal(found.index, np.where(found.mask, plain.index, -1))
        np.testing.assert_array_equal(found.depth, np.where(found.mask, plain.depth, 0))
        tensor = torch.from_numpy(points)
        assert same_bits(zbuffer(tensor, camera, "footprint"), found)
        ops = ZBuffer(*zbuffer_torch(tensor, lens_of(camera)))
        assert same_bits(validity._drop_leaks_torch(ops), found)


class TestRasterize:
    @pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint8])
    def test_values_of_valid_points_and_zero_elsewhere(self, dtype: type) -> None:
        points = np.array([[0.1, 0.1, 9.0], [0.1, 0.1, 5.0], [0, 0, -1.0], [-1.9, -1.9, 2.0]])
        values = np.array([[1, 2], [3, 4], [5, 6], [7, 8]], dtype)
        image, mask, depth = rasterize_points(points, values, simple_camera())
        expected = np.zeros((4, 6, 2), dtype)
        expected[2, 3] = 3, 4
        expected[0, 1] = 7, 8  # u = 2 * -1.9 / 2 + 3 = 1.1, v = 0.1
        np.testing.assert_array_equal(image, expected, strict=True)
        np.testing.assert_array_equal(mask, expected.any(-1), strict=True)
        np.testing.assert_array_equal(depth > 0, mask)

    def test_no_points_give_a_black_image(self) -> None:
        image, mask, _ = rasterize_points(
            np.zeros((0, 3)), np.zeros((0, 2), np.uint8), simple_camera()
        )
        np.testing.assert_array_equal(image, np.zeros((4, 6, 2), np.uint8), strict=True)
        assert not mask.any()

    def test_tensors(self) -> None:
        rng = np.random.default_rng(0)
        points, values = rng.uniform(-3, 3, (99, 3)), rng.random((99, 3), np.float32)
        expected = rasterize_points(points, values, simple_camera())
        tensors = torch.from_numpy(points), torch.from_numpy(values)
        for found, array in zip(rasterize_points(*tensors, simple_camera()), expected, strict=True):
            np.testing.assert_array_equal(found.numpy(), array, strict=True)

    @pytest.mark.parametrize("shape", [(2,), (3, 1)])
    def test_refuses_values_that_do_not_pair_up(self, shape: tuple) -> None:
        with pytest.raises(GeoEvsError, match="give each point one row"):
            rasterize_points(np.zeros((2, 3)), np.zeros(shape), simple_camera())


class TestVisible:
    @UNTIMED
    @given(CLOUDS)
    def test_is_what_survives_in_the_z_buffer(self, points: np.ndarray) -> None:
        camera = simple_camera()
        index, _ = zbuffer(points, camera)
        expected = np.isin(np.arange(len(points)), index)
        np.testing.assert_array_equal(visible(points, camera), expected, strict=True)
        seen = visible(torch.from_numpy(points), camera)
        np.testing.assert_array_equal(seen.numpy(), expected, strict=True)


class TestColourPoints:
    def cloud(self, *points: list[float]) -> PointCloud:
        return PointCloud.uncoloured(np.array(points), np.zeros(len(points)), range(len(points)))

    def test_bilinear_by_hand(self) -> None:
        image = np.zeros((4, 6, 3), np.uint8)
        image[1, 2], image[1, 3], image[2, 2], image[2, 3] = 0, 51, 102, 204
        # u = 3.25, v = 2.25: 0.75 of the way from column 2's centre to 3's, and from row 1 to 2
        coloured = colour_points(
            self.cloud([0.25, 0.25, 2.0]), {"a": simple_camera()}, {"a": image}
        )
        upper, lower = 0.75 * 51, 0.25 * 102 + 0.75 * 204
        expected = (0.25 * upper + 0.75 * lower) / 255
        np.testing.assert_allclose(coloured.rgb, [[expected] * 3], rtol=1e-6)
        assert coloured.rgb.dtype == np.float32

    def test_border_is_clamped(self) -> None:
        image = np.random.default_rng(0).random((4, 6, 3), np.float32)
        corners = self.cloud([-2.9, -1.9, 2.0], [2.9, 1.9, 2.0])
        coloured = colour_points(corners, {"a": simple_camera()}, {"a": image})
        np.testing.assert_array_equal(coloured.rgb, [image[0, 0], image[3, 5]])

    def test_nearest_axis_wins_whatever_the_order(self) -> None:
        straight = simple_camera()
        aside = straight.world_from_camera.copy()
        turn = np.radians(10)
        aside[:3, :3] = [
            [np.cos(turn), 0, np.sin(turn)],
            [0, 1, 0],
            [-np.sin(turn), 0, np.cos(turn)],
        ]
        right = Camera(straight.K, aside, 4, 6)  # its axis leans towards +x
        cameras = {"straight": straight, "right": right}
        images = {name: np.full((4, 6, 3), i + 1, np.uint8) for i, name in enumerate(cameras)}
        cloud = self.cloud([0.1, 0, 5.0], [3.0, 0.3, 5.0], [0, 0, -1.0])
        forth = colour_points(cloud, cameras, images)
        back = colour_points(cloud, dict(reversed(cameras.items())), images)
        np.testing.assert_array_equal(forth.camera, np.array([0, 1, -1], np.int8), strict=True)
        np.testing.assert_array_equal(back.camera, [1, 0, -1])
        np.testing.assert_array_equal(forth.rgb, back.rgb)
        np.testing.assert_allclose(forth.rgb[:, 0], np.array([1, 2, 0]) / 255, rtol=1e-6)

    def test_equal_angles_go_to_the_first_camera(self) -> None:
        cameras = {"a": simple_camera(), "b": simple_camera()}
        images = {name: np.ones((4, 6, 3), np.float32) for name in cameras}
        assert colour_points(self.cloud([0, 0, 5.0]), cameras, images).camera.tolist() == [0]

    def test_occluded_points_stay_black_and_old_colours_go(self) -> None:
        cloud = self.cloud([0, 0, 5.0], [0, 0, 9.0], [99.0, 0, 1.0])
        images = {"a": np.ones((4, 6, 3), np.float32)}
        first = colour_points(cloud, {"a": simple_camera()}, images)
        np.testing.assert_array_equal(first.camera, [0, -1, -1])
        np.testing.assert_array_equal(first.rgb, [[1] * 3, [0] * 3, [0] * 3])
        again = colour_points(first, {}, {})
        np.testing.assert_array_equal(again.camera, [-1] * 3)
        assert not again.rgb.any()
        np.testing.assert_array_equal(again.beam, cloud.beam)

    @pytest.mark.parametrize("images", [{}, {"a": np.zeros((6, 4, 3))}])
    def test_refuses_missing_or_missized_images(self, images: dict) -> None:
        with pytest.raises(GeoEvsError, match="camera 'a' needs a 4 x 6 RGB image"):
            colour_points(self.cloud([0, 0, 5.0]), {"a": simple_camera()}, images)

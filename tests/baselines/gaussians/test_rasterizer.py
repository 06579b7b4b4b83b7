"""The rasterizer: pictures by hand, by the twin, and by gsplat's own reference."""

import sys
import types
from pathlib import Path

import numba
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.gaussians.constants import ALPHA_CAP, BLUR, SH_C0, TRANSMITTANCE_THRESHOLD
from baselines.gaussians.gsplat_backend import rasterize_gsplat
from baselines.gaussians.rasterizer import blending_weights, rasterize_gaussians
from baselines.gaussians.reference import rasterize_reference
from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera

# Made once with gsplat 1.6.0 at 90d7b4b (Apache 2.0), in float64: `_fully_fused_projection`,
# `_spherical_harmonics`, `_isect_tiles`, `_isect_offset_encode` and `accumulate` of its
# gsplat/cuda/_torch_impl.py, gradients by autograd of (rgb * by_rgb).sum(). The pairs of Gaussians
# and pixels that go into `accumulate`, which gsplat finds on CUDA only, came from a Python loop by
# the rule of its RasterizeToIndices3DGSSerialBatch.cu; nerfacc's two sums from ten lines of torch.
# 250 random Gaussians, with some behind the camera, at its lens and fully opaque; 40 x 60 pixels.
GOLDEN = Path(__file__).parent / "gsplat_golden.npz"

PARAMETERS = ("means", "quats", "scales", "opacities", "sh")
UNTIMED = settings(deadline=None, max_examples=25)

Gaussians = dict[str, torch.Tensor]


def straight_camera(height: int = 24, width: int = 40, focal: float = 30.0) -> Camera:
    """At the origin, world axes, the optical axis through the middle of the frame."""
    K = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]
    return Camera(K, np.eye(4), height, width)


def turned_camera(rng: np.random.Generator, height: int = 21, width: int = 37) -> Camera:
    """Any pose, unequal focal lengths, no whole number of tiles."""
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = rng.normal(size=3)
    K = [[1.1 * width, 0, 0.6 * width], [0, 1.4 * height, 0.4 * height], [0, 0, 1]]
    return Camera(K, pose, height, width)


def in_world(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Points of the camera's own frame, in the world."""
    return points @ camera.world_from_camera[:3, :3].T + camera.world_from_camera[:3, 3]


def random_gaussians(rng: np.random.Generator, camera: Camera, count: int, k: int = 4) -> Gaussians:
    """Of some pixels each, in and around the view, 1 to 6 m away."""
    z = rng.uniform(1, 6, (count, 1))
    slope = rng.uniform(-0.6, 0.6, (count, 2)) * [camera.width, camera.height]
    x, y = slope[:, :1] / camera.K[0, 0] * z, slope[:, 1:] / camera.K[1, 1] * z
    arrays = (
        in_world(camera, np.hstack([x, y, z])),
        rng.normal(size=(count, 4)),
        z * np.exp(rng.normal(-2.5, 0.7, (count, 3))),
        rng.uniform(0, 1, count),
        rng.normal(0, 0.7, (count, k, 3)),
    )
    tensors = (torch.from_numpy(array).float() for array in arrays)
    return dict(zip(PARAMETERS, tensors, strict=True))


def one_gaussian(**changes: list) -> Gaussians:
    """Round, 0.1 m, on the optical axis 2 m away."""
    values = {
        "means": [[0.0, 0.0, 2.0]],
        "quats": [[1.0, 0.0, 0.0, 0.0]],
        "scales": [[0.1, 0.1, 0.1]],
        "opacities": [0.8],
        "sh": [[[0.5, 0.0, -0.5]]],
    }
    return {name: torch.tensor(value) for name, value in (values | changes).items()}


def draw_and_differentiate(
    draw, gaussians: Gaussians, camera: Camera, background: torch.Tensor | None, seed: int = 0
) -> tuple:
    """The pictures, and the gradients of their product with random cotangents, all float64."""
    leaves = [gaussians[name].clone().requires_grad_() for name in PARAMETERS]
    behind = None if background is None else background.clone().requires_grad_()
    drawn = draw(*leaves, camera, behind)
    generator = torch.Generator().manual_seed(seed)
    loss = sum(
        (picture * torch.randn(picture.shape, generator=generator)).sum() for picture in drawn[:3]
    )
    loss.backward()
    grads = {name: leaf.grad.double() for name, leaf in zip(PARAMETERS, leaves, strict=True)}
    grads["means2d"] = drawn.footprints.means2d_grad.double()
    if behind is not None:
        grads["background"] = behind.grad.double()
    return [picture.detach().double() for picture in drawn[:3]], grads, drawn.footprints.radii


def check_against_twin(
    gaussians: Gaussians, camera: Camera, background: torch.Tensor | None = None, tolerance=2e-4
) -> None:
    """Pictures, radii and every gradient, the gradients by the norm of the difference."""
    found, grads, radii = draw_and_differentiate(rasterize_gaussians, gaussians, camera, background)
    expected, expected_grads, expected_radii = draw_and_differentiate(
        rasterize_reference, gaussians, camera, background
    )
    for picture, twin in zip(found, expected, strict=True):
        assert picture.shape == twin.shape
        torch.testing.assert_close(picture, twin, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(radii.double(), expected_radii, rtol=1e-2, atol=0)
    for name, twin in expected_grads.items():
        assert torch.isfinite(grads[name]).all(), name
        assert (grads[name] - twin).norm() <= tolerance * twin.norm(), name


class TestByHand:
    def test_one_gaussian(self) -> None:
        camera = straight_camera(5, 7, focal=20.0)
        drawn = rasterize_gaussians(*one_gaussian().values(), camera)
        # One standard deviation is 20 * 0.1 / 2 = 1 pixel, and the blur widens it.
        variance = 1.0 + BLUR
        colour = 0.5 + SH_C0 * np.array([0.5, 0.0, -0.5])
        for row, column in ((2, 3), (2, 1), (4, 5)):
            squared = (column + 0.5 - 3.5) ** 2 + (row + 0.5 - 2.5) ** 2
            alpha = 0.8 * np.exp(-0.5 * squared / variance)
            np.testing.assert_allclose(drawn.opacity[row, column], alpha, rtol=1e-5)
            np.testing.assert_allclose(drawn.rgb[row, column], alpha * colour, rtol=1e-5)
            np.testing.assert_allclose(drawn.depth[row, column], 2.0, rtol=1e-5)
        # alpha is 1 / 255 at 1.14 * sqrt(2 * log(255 * 0.8)) = 3.718 pixels, on every axis
        np.testing.assert_allclose(drawn.footprints.radii, [3.718], rtol=1e-3)

    def test_nothing_under_the_threshold(self) -> None:
        drawn = rasterize_gaussians(*one_gaussian().values(), straight_camera(16, 16, focal=20.0))
        # the centre is (8, 8): 3.5 columns aside alpha is 0.0058, 4.5 aside 0.0003
        opacity = drawn.opacity[8]
        assert (opacity[4:12] > 1 / 255).all()
        assert not opacity[:4].any()
        assert not opacity[12:].any()
        assert not drawn.depth[8, :4].any()

    def test_front_to_back_over_a_background(self) -> None:
        near, far = (
            one_gaussian(opacities=[0.6]),
            one_gaussian(means=[[0, 0, 3.0]], sh=[[[1.0] * 3]]),
        )
        both = [torch.cat([far[name], near[name]]) for name in PARAMETERS]
        background = torch.tensor([0.0, 0.5, 1.0])
        drawn = rasterize_gaussians(*both, straight_camera(5, 7, focal=20.0), background)
        front, back = 0.5 + SH_C0 * np.array([0.5, 0.0, -0.5]), 0.5 + SH_C0
        weights = 0.6, 0.4 * 0.8
        expected = weights[0] * front + weights[1] * back + 0.4 * 0.2 * np.array([0, 0.5, 1])
        np.testing.assert_allclose(drawn.rgb[2, 3], expected, rtol=1e-5)
        np.testing.assert_allclose(drawn.opacity[2, 3], sum(weights), rtol=1e-5)
        depth = (weights[0] * 2 + weights[1] * 3) / sum(weights)
        np.testing.assert_allclose(drawn.depth[2, 3], depth, rtol=1e-5)

    def test_first_of_equal_depths_lies_in_front(self) -> None:
        pair = one_gaussian(), one_gaussian(sh=[[[9.0] * 3]])
        camera = straight_camera(5, 7, focal=20.0)
        for first, second in (pair, pair[::-1]):
            both = [torch.cat([first[name], second[name]]) for name in PARAMETERS]
            colours = 0.5 + SH_C0 * both[4][:, 0]
            expected = 0.8 * colours[0] + 0.2 * 0.8 * colours[1]
            torch.testing.assert_close(rasterize_gaussians(*both, camera).rgb[2, 3], expected)

    def test_pixel_is_finished_before_the_gaussian_that_would_close_it(self) -> None:
        stack = {name: torch.cat([value] * 3) for name, value in one_gaussian().items()}
        stack["opacities"] = torch.ones(3)
        stack["means"] = torch.tensor([[0, 0, 2.0], [0, 0, 2.1], [0, 0, 2.2]])
        drawn = rasterize_gaussians(*stack.values(), straight_camera(5, 7, focal=20.0))
        # The second would leave 0.01 * 0.01, which is not over the threshold in float32.
        assert np.float32(1 - ALPHA_CAP) ** 2 <= TRANSMITTANCE_THRESHOLD * (1 + 1e-6)
        np.testing.assert_allclose(drawn.opacity[2, 3], ALPHA_CAP, rtol=1e-6)
        np.testing.assert_allclose(drawn.depth[2, 3], 2.0, rtol=1e-6)

    def test_colour_depends_on_the_direction(self) -> None:
        sh = torch.zeros(1, 4, 3)
        sh[0, 1, 0], sh[0, 2, 1], sh[0, 3, 2] = 0.3, 0.3, -0.3
        gaussians = one_gaussian(means=[[1.0, -2.0, 2.0]]) | {"sh": sh}
        drawn = rasterize_gaussians(*gaussians.values(), straight_camera(60, 60, focal=20.0))
        # The unit ray is (1, -2, 2) / 3; the basis is C1 * (-y, z, -x).
        expected = 0.5 + 0.4886025119029199 * 0.3 * np.array([2, 2, 1]) / 3
        row, column = 30 - 20, 30 + 10
        colour = drawn.rgb[row, column] / drawn.opacity[row, column]
        np.testing.assert_allclose(colour, expected, rtol=1e-5)

    def test_weights_add_up_to_the_opacity(self) -> None:
        rng = np.random.default_rng(3)
        camera = turned_camera(rng)
        gaussians = random_gaussians(rng, camera, 60)
        with torch.no_grad():
            weights = blending_weights(*[gaussians[name] for name in PARAMETERS[:4]], camera)
        opacity = rasterize_gaussians(*gaussians.values(), camera).opacity
        assert (weights >= 0).all()
        torch.testing.assert_close(weights.sum(), opacity.sum())
        alone = blending_weights(*list(one_gaussian().values())[:4], straight_camera())
        single = rasterize_gaussians(*one_gaussian().values(), straight_camera()).opacity.sum()
        torch.testing.assert_close(alone, single[None])


class TestAgainstTwin:
    @pytest.mark.parametrize("k", [1, 4])
    @pytest.mark.parametrize("seed", range(3))
    def test_random_gaussians(self, seed: int, k: int) -> None:
        rng = np.random.default_rng(seed)
        camera = turned_camera(rng)
        background = torch.from_numpy(rng.random(3)).float()
        check_against_twin(random_gaussians(rng, camera, 80, k), camera, background)

    @UNTIMED
    @given(st.integers(0, 2**32), st.integers(1, 40), st.integers(1, 40), st.integers(1, 30))
    def test_any_frame(self, seed: int, height: int, width: int, count: int) -> None:
        rng = np.random.default_rng(seed)
        camera = turned_camera(rng, height, width)
        # The gradients of depth blow up float32's rounding where opacity is low.
        check_against_twin(random_gaussians(rng, camera, count), camera, tolerance=2e-3)

    @pytest.mark.parametrize(
        "change",
        [
            {"scales": [100.0, 100.0, 100.0]},
            {"scales": [5.0, 1e-4, 1e-4]},
            {"scales": [1e-4, 1e-4, 30.0]},
            {"scales": [0.0, 0.0, 0.0]},
            {"opacities": 1.0},
            {"opacities": 0.004},
            {"opacities": 0.0},
            {"quats": [1e-3, -2e-3, 0.0, 1e-3]},
            {"quats": [30.0, 10.0, -50.0, 2.0]},
        ],
    )
    def test_extreme_parameters(self, change: dict) -> None:
        rng = np.random.default_rng(5)
        camera = turned_camera(rng)
        gaussians = random_gaussians(rng, camera, 40)
        for name, value in change.items():
            gaussians[name][::4] = torch.tensor(value)
        check_against_twin(gaussians, camera, tolerance=1e-3)

    @pytest.mark.parametrize(
        "place",
        [
            [0.0, 0.0, -2.0],  # behind
            [0.0, 0.0, 0.005],  # before the near plane
            [0.02, -0.01, 0.02],  # just beyond it
            [50.0, 0.0, 2.0],  # out of the picture
            [3.0, -2.0, 1.0],  # beyond the margin, reaching in
        ],
    )
    def test_extreme_places(self, place: list) -> None:
        rng = np.random.default_rng(6)
        camera = turned_camera(rng)
        gaussians = random_gaussians(rng, camera, 40)
        where = torch.from_numpy(in_world(camera, np.array(place))).float()
        gaussians["means"][::4] = where + 1e-4 * torch.arange(10.0)[:, None]
        gaussians["scales"][::4] *= 3
        check_against_twin(gaussians, camera, tolerance=1e-3)

    def test_all_out_of_sight(self) -> None:
        background = torch.tensor([0.1, 0.2, 0.3])
        gaussians = one_gaussian(means=[[0.0, 0.0, -2.0]])
        check_against_twin(gaussians, straight_camera(), background)
        drawn = rasterize_gaussians(*gaussians.values(), straight_camera(), background)
        assert (drawn.rgb == background).all()
        assert not drawn.opacity.any()
        assert not drawn.footprints.radii.any()

    def test_none_at_all(self) -> None:
        none = {name: value[:0] for name, value in one_gaussian().items()}
        check_against_twin(none, straight_camera(), torch.tensor([0.1, 0.2, 0.3]))

    def test_hidden_gaussians_have_no_gradient(self) -> None:
        wall = one_gaussian(means=[[0, 0, 1.0]], scales=[[9.0] * 3], opacities=[1.0])
        # Two walls of alpha 0.99 leave exactly the threshold or a rounding less; three, surely.
        hidden = one_gaussian(means=[[0, 0, 3.0]])
        scene = {
            name: torch.cat([wall[name]] * 3 + [hidden[name]]).requires_grad_()
            for name in PARAMETERS
        }
        drawn = rasterize_gaussians(*scene.values(), straight_camera())
        (drawn.rgb.sum() + drawn.depth.sum()).backward()
        assert scene["sh"].grad[0].any()
        assert not any(scene[name].grad[-1].any() for name in PARAMETERS)


class TestGolden:
    def test_same_as_gsplat(self) -> None:
        golden = dict(np.load(GOLDEN))
        camera = Camera(golden["K"], golden["world_from_camera"], *golden["depth"].shape)
        leaves = [torch.from_numpy(golden[name]).requires_grad_() for name in PARAMETERS]
        drawn = rasterize_gaussians(*leaves, camera, torch.from_numpy(golden["background"]))
        for picture, name in zip(drawn[:3], ("rgb", "depth", "opacity"), strict=True):
            np.testing.assert_allclose(picture.detach(), golden[name], atol=1e-5, err_msg=name)
        (drawn.rgb * torch.from_numpy(golden["by_rgb"])).sum().backward()
        for leaf, name in zip(leaves, PARAMETERS, strict=True):
            expected = golden[f"{name}_grad"]
            error = np.linalg.norm(leaf.grad.numpy() - expected) / np.linalg.norm(expected)
            assert error < 1e-4, name


class TestDeterminism:
    def bytes_of(self, chunks: int, monkeypatch: pytest.MonkeyPatch) -> tuple[list, list[bytes]]:
        rng = np.random.default_rng(7)
        camera = turned_camera(rng, 50, 70)
        gaussians = random_gaussians(rng, camera, 400)
        with monkeypatch.context() as patch:
            patch.setattr(numba, "get_num_threads", lambda: chunks)
            pictures, grads, radii = draw_and_differentiate(
                rasterize_gaussians, gaussians, camera, None
            )
        tensors = [*pictures, radii, *grads.values()]
        return tensors, [tensor.numpy().tobytes() for tensor in tensors]

    @pytest.mark.parametrize("chunks", [1, 2, 7])
    def test_same_bytes_again_and_same_values_by_any_number_of_threads(
        self, chunks: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        tensors, first = self.bytes_of(chunks, monkeypatch)
        _, second = self.bytes_of(chunks, monkeypatch)
        assert first == second
        single, bytes_single = self.bytes_of(1, monkeypatch)
        assert first[:4] == bytes_single[:4]  # pictures and radii: to the last bit
        for tensor, other in zip(tensors, single, strict=True):
            torch.testing.assert_close(tensor, other, rtol=1e-4, atol=1e-4 * other.abs().max())

    @UNTIMED
    @given(st.integers(0, 2**32))
    def test_order_of_gaussians_does_not_matter(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        camera = turned_camera(rng)
        gaussians = random_gaussians(rng, camera, 50)
        shuffle = torch.from_numpy(rng.permutation(50))
        shuffled = {name: value[shuffle] for name, value in gaussians.items()}
        pictures, grads, _ = draw_and_differentiate(rasterize_gaussians, gaussians, camera, None)
        others, other_grads, _ = draw_and_differentiate(rasterize_gaussians, shuffled, camera, None)
        assert all(torch.equal(a, b) for a, b in zip(pictures, others, strict=True))
        assert all(torch.equal(grads[name][shuffle], other_grads[name]) for name in PARAMETERS)


class TestInput:
    @UNTIMED
    @given(
        st.sampled_from(["means", "quats", "scales", "opacities"]),
        st.sampled_from([np.nan, np.inf, -np.inf]),
        st.integers(0, 2**32),
    )
    def test_gaussians_that_are_not_finite_are_not_drawn(
        self, name: str, bad: float, seed: int
    ) -> None:
        rng = np.random.default_rng(seed)
        camera = turned_camera(rng)
        gaussians = random_gaussians(rng, camera, 20)
        broken = {name: torch.cat([value, value[:5]]) for name, value in gaussians.items()}
        broken[name].view(25, -1)[20:, 0] = bad
        pictures, _, _ = draw_and_differentiate(rasterize_gaussians, gaussians, camera, None)
        others, grads, radii = draw_and_differentiate(rasterize_gaussians, broken, camera, None)
        assert all(torch.equal(a, b) for a, b in zip(pictures, others, strict=True))
        assert not radii[20:].any()
        assert not any(grads[name][20:].any() for name in PARAMETERS)

    def test_zero_quaternion_is_not_drawn(self) -> None:
        drawn = rasterize_gaussians(*one_gaussian(quats=[[0.0] * 4]).values(), straight_camera())
        assert not drawn.opacity.any()

    def test_number_type_comes_back(self) -> None:
        leaves = [value.double().requires_grad_() for value in one_gaussian().values()]
        rasterize_gaussians(*leaves, straight_camera()).rgb.sum().backward()
        assert all(leaf.grad.dtype == torch.float64 for leaf in leaves)

    @pytest.mark.parametrize("change", ["means", "rgb"])
    def test_what_backward_needs_must_not_change(self, change: str) -> None:
        gaussians = {name: value.requires_grad_() for name, value in one_gaussian().items()}
        drawn = rasterize_gaussians(*gaussians.values(), straight_camera())
        loss = drawn.rgb.sum() + drawn.depth.sum()
        with torch.no_grad():
            (drawn.rgb if change == "rgb" else gaussians["means"]).add_(0.1)
        with pytest.raises(RuntimeError, match="modified by an inplace operation"):
            loss.backward()

    def test_strided_tensors(self) -> None:
        rng = np.random.default_rng(8)
        camera = turned_camera(rng)
        gaussians = random_gaussians(rng, camera, 30)
        strided = [torch.stack([value, value], -1)[..., 0] for value in gaussians.values()]
        assert torch.equal(
            rasterize_gaussians(*strided, camera).rgb,
            rasterize_gaussians(*gaussians.values(), camera).rgb,
        )

    @pytest.mark.parametrize(
        ("changes", "sentence"),
        [
            ({"quats": [[1.0, 0.0, 0.0]]}, r"quats has shape \(1, 3\); give it as \(1, 4\)"),
            ({"opacities": [[0.5]]}, r"opacities has shape \(1, 1\); give it as \(1\)"),
            ({"means": [[1.0, 0.0]]}, r"means has shape \(1, 2\); give it as \(1, 3\)"),
            ({"sh": [[0.5, 0.5, 0.5]]}, r"sh has shape \(1, 3\); give it as \(1, K, 3\)"),
            ({"sh": [[[0.5] * 3] * 3]}, "sh has 3 coefficients a Gaussian; give it 1 .* or 4"),
        ],
    )
    def test_refuses_shapes_that_do_not_pair_up(self, changes: dict, sentence: str) -> None:
        with pytest.raises(GeoEvsError, match=sentence):
            rasterize_gaussians(*one_gaussian(**changes).values(), straight_camera())

    def test_refuses_tensors_on_two_devices(self) -> None:
        gaussians = one_gaussian()
        gaussians["scales"] = gaussians["scales"].to("meta")
        with pytest.raises(GeoEvsError, match="scales is on meta but means on cpu"):
            rasterize_gaussians(*gaussians.values(), straight_camera())


class TestGsplatBackend:
    def test_says_what_is_missing(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "gsplat", None)
        with pytest.raises(GeoEvsError, match="pip install gsplat"):
            rasterize_gsplat(*one_gaussian().values(), straight_camera(), None)

    def test_arguments_and_results(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A stand-in with gsplat's signature and shapes, which draws with ours."""

        def rasterization(
            means, quats, scales, opacities, colors, viewmats, Ks, width, height, **how
        ):
            assert how["render_mode"] == "RGB+ED"
            assert (how["sh_degree"] + 1) ** 2 == colors.shape[1]
            pose = torch.linalg.inv(viewmats[0]).double().numpy()
            camera = Camera(Ks[0].double().numpy(), pose, height, width)
            means2d = torch.zeros(1, len(means), 2, requires_grad=True) * 1
            drawn = rasterize_gaussians(
                means, quats, scales, opacities, colors, camera, how["backgrounds"][0]
            )
            rgb = drawn.rgb + 3 * means2d.sum()
            pictures = torch.cat([rgb, drawn.depth[..., None]], 2)[None]
            radii = torch.tensor([[[2, 5]]], dtype=torch.int32)
            return pictures, drawn.opacity[None, ..., None], {"means2d": means2d, "radii": radii}

        monkeypatch.setitem(
            sys.modules, "gsplat", types.SimpleNamespace(rasterization=rasterization)
        )
        gaussians, background = one_gaussian(), torch.tensor([0.1, 0.2, 0.3])
        camera = straight_camera()
        ours = rasterize_gaussians(*gaussians.values(), camera, background)
        theirs = rasterize_gsplat(*gaussians.values(), camera, background)
        for found, expected in zip(theirs[:3], ours[:3], strict=True):
            torch.testing.assert_close(found, expected)
        assert theirs.footprints.radii.tolist() == [5.0]
        theirs.rgb[0, 0, 0].backward()
        assert theirs.footprints.means2d_grad.tolist() == [[3.0, 3.0]]

"""Differentiable rasterization of 3D Gaussians: numba kernels on the CPU, gsplat on CUDA.

Constants and picture are gsplat's (see `baselines.gaussians.constants`). On the CPU it works in
float32, and the same input gives the same bytes for a given number of threads, which is numba's
(NUMBA_NUM_THREADS).
"""

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from baselines.gaussians.binning_kernels import TILE, bin_splats, depth_order
from baselines.gaussians.blending_kernels import blend, blend_backward
from baselines.gaussians.constants import SH_C0
from baselines.gaussians.interface import Footprints, Rasterization, check_gaussians
from baselines.gaussians.projection_kernels import project, project_backward
from geoevs.projection.kernels import lens_of
from geoevs.scenes.camera import Camera


def rasterize_gaussians(
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4]
    scales: Tensor,  # [N, 3]
    opacities: Tensor,  # [N]
    sh: Tensor,  # [N, K, 3]
    camera: Camera,
    background: Tensor | None = None,  # [3]
) -> Rasterization:
    """Draw 3D Gaussians, differentiably in all arguments but the camera.

    Args:
        means: (N, 3) centres in the world, metres.
        quats: (N, 4) rotations as w, x, y, z, of any length but zero.
        scales: (N, 3) standard deviations along the rotated axes, metres.
        opacities: (N,) in [0, 1].
        sh: (N, K, 3) coefficients of real spherical harmonics of the viewing direction about
            mid-grey, K = 1 or 4.
        camera: the view.
        background: (3,) colour behind the Gaussians; black if not given.

    Returns:
        rgb (H, W, 3); depth (H, W) in metres, normalised by opacity, 0 where no Gaussian is;
        opacity (H, W); and the footprints, whose gradient `backward` fills in. Gaussians that
        are not finite, or whose quaternion is zero, are not drawn.

    Raises:
        GeoEvsError: shapes do not pair up, or the tensors are on CUDA without gsplat.
    """
    check_gaussians(means, quats, scales, opacities, sh, background)
    if means.is_cuda:
        from baselines.gaussians.gsplat_backend import rasterize_gsplat

        return rasterize_gsplat(means, quats, scales, opacities, sh, camera, background)
    if background is None:
        background = means.new_zeros(3)
    footprints = Footprints(radii=means.new_empty(0))
    rgb, depth, opacity = _Rasterize.apply(
        means, quats, scales, opacities, sh, background, camera, footprints
    )
    return Rasterization(rgb, depth, opacity, footprints)


def blending_weights(
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4]
    scales: Tensor,  # [N, 3]
    opacities: Tensor,  # [N]
    camera: Camera,
) -> Tensor:
    """(N,) sum of each Gaussian's weight over the pixels: how much of the picture it makes up.

    See `rasterize_gaussians` for the arguments and errors.
    """
    sh = means.new_zeros(len(means), 1, 3, requires_grad=True)
    with torch.enable_grad():
        drawn = rasterize_gaussians(
            means.detach(), quats.detach(), scales.detach(), opacities.detach(), sh, camera
        )
        (by_sh,) = torch.autograd.grad(drawn.rgb[..., 0].sum(), sh)
    return by_sh[:, 0, 0] / SH_C0


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, quats, scales, opacities, sh, background, camera, footprints):
        tensors = means, quats, scales, opacities, sh
        parameters = [*map(_array, tensors)]
        lens, threads = lens_of(camera), numba.get_num_threads()
        splats, radii = project(*parameters, lens)
        rows, columns = -(-camera.height // TILE), -(-camera.width // TILE)
        bins = bin_splats(splats, depth_order(splats, radii), rows, columns, threads)
        arrays, blocks = blend(
            splats, *bins, _array(background), camera.height, camera.width, threads
        )
        pictures = tuple(map(torch.from_numpy, arrays))
        footprints.radii = torch.from_numpy(radii)
        ctx.save_for_backward(*tensors, *pictures)  # torch then refuses if they were changed
        ctx.held = lens, splats, radii, (*bins, blocks), footprints, threads
        return pictures

    @staticmethod
    @once_differentiable
    def backward(ctx, by_rgb, by_depth, by_opacity):
        lens, splats, radii, bins, footprints, threads = ctx.held
        saved = [*map(_array, ctx.saved_tensors)]
        parameters, pictures = saved[:5], saved[5:]
        by_pictures = map(_array, (by_rgb, by_depth, by_opacity))
        shares = blend_backward(splats, *bins, *pictures, *by_pictures, threads)
        *grads, centres = project_backward(*parameters, lens, splats, radii, shares)
        footprints.means2d_grad = torch.from_numpy(centres)
        by_background = None
        if ctx.needs_input_grad[5]:
            through = 1 - ctx.saved_tensors[7]
            by_background = (through[..., None] * by_rgb).sum((0, 1))
        return *map(torch.from_numpy, grads), by_background, None, None


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().float().contiguous().numpy()

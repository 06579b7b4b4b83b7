"""The rasterizer in plain torch ops: the twin that the fast paths are checked against."""

import torch
from torch import Tensor

from baselines.gaussians.constants import (
    ALPHA_CAP,
    ALPHA_THRESHOLD,
    BLUR,
    FRAME_MARGIN,
    NEAR_PLANE,
    SH_C0,
    SH_C1,
    TRANSMITTANCE_THRESHOLD,
)
from baselines.gaussians.interface import Footprints, Rasterization, check_gaussians
from baselines.gaussians.rotations import rotation_matrices
from geoevs.scenes.camera import Camera

TILE = 16
"""Pixels are drawn a square at a time, with the Gaussians near it: all pairs would fill memory."""


def rasterize_reference(
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4]
    scales: Tensor,  # [N, 3]
    opacities: Tensor,  # [N]
    sh: Tensor,  # [N, K, 3]
    camera: Camera,
    background: Tensor | None = None,  # [3]
) -> Rasterization:
    """The result of `rasterizer.rasterize_gaussians` in float64, by autograd throughout."""
    check_gaussians(means, quats, scales, opacities, sh, background)
    means, quats, scales, opacities, sh = (
        tensor.double() for tensor in (means, quats, scales, opacities, sh)
    )
    pose = torch.from_numpy(camera.camera_from_world)
    z = means @ pose[2, :3] + pose[2, 3]
    drawn = (z > NEAR_PLANE) & (opacities >= ALPHA_THRESHOLD) & (quats.norm(dim=1) > 0)
    order = drawn.nonzero()[:, 0]
    order = order[z[order].argsort(stable=True)]
    footprints = Footprints(means.new_zeros(len(means)))

    in_camera = means[order] @ pose[:3, :3].T + pose[:3, 3]
    centres, covariances = project(in_camera, quats[order], scales[order], camera)
    colours = shade(means[order] - torch.from_numpy(camera.centre), sh[order])
    if centres.requires_grad:
        centres.register_hook(lambda grad: _record_gradient(footprints, order, grad))

    variances = covariances.detach().diagonal(dim1=1, dim2=2)
    reach = 2 * torch.log(opacities[order].detach() / ALPHA_THRESHOLD)
    extents = (reach[:, None] * variances).sqrt()  # alpha is under the threshold beyond them
    size = torch.tensor([camera.width, camera.height])
    inside = ((centres + extents > 0) & (centres - extents < size)).all(1)
    footprints.radii[order] = extents.amax(1) * inside

    canvas = means.new_zeros(camera.height, camera.width, 5)
    for top in range(0, camera.height, TILE):
        for left in range(0, camera.width, TILE):
            corner = torch.tensor([left, top])
            near = ((centres + extents > corner) & (centres - extents < corner + TILE)).all(1)
            tile = canvas[top : top + TILE, left : left + TILE]
            pixels = torch.cartesian_prod(
                torch.arange(tile.shape[0]), torch.arange(tile.shape[1])
            ).flip(1)
            weights = blend(
                corner + pixels + 0.5, centres[near], covariances[near], opacities[order][near]
            )
            depths = in_camera[near, 2:]
            values = torch.cat([colours[near], depths, torch.ones_like(depths)], 1)
            canvas[top : top + TILE, left : left + TILE] = (weights.T @ values).view(tile.shape)
    rgb, depth, opacity = canvas[..., :3], canvas[..., 3], canvas[..., 4]
    if background is not None:
        rgb = rgb + (1 - opacity)[..., None] * background.double()
    depth = depth / torch.where(opacity > 0, opacity, 1.0)
    return Rasterization(rgb, depth, opacity, footprints)


def project(
    means: Tensor,  # [M, 3] in the camera
    quats: Tensor,  # [M, 4]
    scales: Tensor,  # [M, 3]
    camera: Camera,
) -> tuple[Tensor, Tensor]:
    """Centres (M, 2) and covariances (M, 2, 2) of the footprints in pixels, by EWA splatting."""
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    x, y, z = means.unbind(1)
    centres = torch.stack([fx * x / z + cx, fy * y / z + cy], 1)
    margin_x, margin_y = FRAME_MARGIN * camera.width, FRAME_MARGIN * camera.height
    slope_x = (x / z).clamp((-cx - margin_x) / fx, (camera.width - cx + margin_x) / fx)
    slope_y = (y / z).clamp((-cy - margin_y) / fy, (camera.height - cy + margin_y) / fy)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [fx / z, zero, -fx * slope_x / z, zero, fy / z, -fy * slope_y / z], 1
    ).view(-1, 2, 3)
    turn = torch.from_numpy(camera.camera_from_world[:3, :3])
    root = jacobian @ turn @ rotation_matrices(quats) * scales[:, None]
    return centres, root @ root.mT + BLUR * torch.eye(2, dtype=means.dtype)


def shade(
    rays: Tensor,  # [M, 3] from the camera to the Gaussians
    sh: Tensor,  # [M, K, 3]
) -> Tensor:
    """(M, 3) colours as seen along the rays: spherical harmonics about mid-grey, not below 0."""
    colours = 0.5 + SH_C0 * sh[:, 0]
    if sh.shape[1] > 1:
        x, y, z = torch.nn.functional.normalize(rays, dim=1).T[:, :, None]
        colours = colours + SH_C1 * (z * sh[:, 2] - y * sh[:, 1] - x * sh[:, 3])
    return colours.clamp_min(0)


def blend(
    pixels: Tensor,  # [P, 2]
    centres: Tensor,  # [M, 2], front to back
    covariances: Tensor,  # [M, 2, 2]
    opacities: Tensor,  # [M]
) -> Tensor:
    """(M, P) weights of the Gaussians in the pixels."""
    offsets = pixels - centres[:, None]  # [M, P, 2]
    conics = torch.linalg.inv(covariances)
    falloff = torch.exp(-0.5 * torch.einsum("mpi,mij,mpj->mp", offsets, conics, offsets))
    alphas = (opacities[:, None] * falloff).clamp_max(ALPHA_CAP)
    alphas = torch.where(alphas >= ALPHA_THRESHOLD, alphas, 0.0)
    after = (1 - alphas).cumprod(0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    return alphas * before * (after > TRANSMITTANCE_THRESHOLD)


def _record_gradient(footprints: Footprints, order: Tensor, grad: Tensor) -> None:
    footprints.means2d_grad = grad.new_zeros(len(footprints.radii), 2)
    footprints.means2d_grad[order] = grad

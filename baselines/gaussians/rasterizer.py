"""Differentiable rasterization of 3D Gaussians."""

from torch import Tensor

from baselines.gaussians.interface import Rasterization
from baselines.gaussians.reference import rasterize_reference
from geoevs.scenes.camera import Camera


def rasterize(
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
        sh: (N, K, 3) coefficients of spherical harmonics, K = 1 or 4; colour is
            0.5 + SH_C0 * sh[:, 0] and so on, not below 0.
        camera: the view.
        background: (3,) colour behind the Gaussians; black if not given.

    Returns:
        rgb (H, W, 3); depth (H, W) in metres, normalised by opacity, 0 where no Gaussian is; opacity
        (H, W); and the footprints, whose gradient `backward` fills in.

    Raises:
        GeoEvsError: shapes do not pair up.
    """
    return rasterize_reference(means, quats, scales, opacities, sh, camera, background)

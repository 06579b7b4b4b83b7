"""The rasterizer for tensors on CUDA: gsplat's kernels behind our interface."""

import importlib.util
import math

import torch
from torch import Tensor

from baselines.gaussians.interface import Footprints, Rasterization
from geoevs.core.errors import GeoEvsError
from geoevs.scenes.camera import Camera


def usable_device() -> str:
    """The GPU, if there is one and gsplat to draw on it."""
    return "cuda" if torch.cuda.is_available() and importlib.util.find_spec("gsplat") else "cpu"


def rasterize_gsplat(
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4]
    scales: Tensor,  # [N, 3]
    opacities: Tensor,  # [N]
    sh: Tensor,  # [N, K, 3]
    camera: Camera,
    background: Tensor | None,  # [3]
) -> Rasterization:
    """The result of `baselines.gaussians.rasterizer.rasterize_gaussians`, computed by gsplat.

    Raises:
        GeoEvsError: gsplat is not installed.
    """
    try:
        from gsplat import rasterization
    except ImportError as error:
        raise GeoEvsError(
            "Gaussians on CUDA need gsplat, which is not installed; pip install gsplat, or move "
            "the tensors to the CPU"
        ) from error
    pictures, opacity, meta = rasterization(
        means,
        quats,
        scales,
        opacities,
        sh,
        viewmats=_as(camera.camera_from_world, means)[None],
        Ks=_as(camera.K, means)[None],
        width=camera.width,
        height=camera.height,
        sh_degree=math.isqrt(sh.shape[1]) - 1,
        backgrounds=None if background is None else background[None],
        render_mode="RGB+ED",  # ED is normalised by opacity
        packed=False,
    )
    footprints = Footprints(radii=meta["radii"][0].amax(1).float())
    if meta["means2d"].requires_grad:
        meta["means2d"].register_hook(lambda grad: setattr(footprints, "means2d_grad", grad[0]))
    return Rasterization(pictures[0, ..., :3], pictures[0, ..., 3], opacity[0, ..., 0], footprints)


def _as(array, like: Tensor) -> Tensor:
    return torch.from_numpy(array).to(like)

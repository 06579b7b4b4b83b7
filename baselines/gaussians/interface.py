"""What a rasterizer gives, whichever of them ran, and the check of what it gets."""

from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor

from geoevs.core.errors import GeoEvsError

SH_COUNTS = (1, 4)


@dataclass
class Footprints:
    """The footprints of Gaussians in a picture, by which densification decides.

    Args:
        radii: (N,) float, half the longer side of the box around each footprint in pixels;
            0 = not in the picture.
        means2d_grad: (N, 2) gradient of the loss by the projected centres, per pixel; None
            until `backward` has run.
    """

    radii: Tensor  # [N]
    means2d_grad: Tensor | None = None  # [N, 2]


class Rasterization(NamedTuple):
    """A picture of Gaussians. A Gaussian's weight in a pixel is alpha times transmittance."""

    rgb: Tensor  # [H, W, 3], sum of weight * colour, and the background behind
    depth: Tensor  # [H, W] metres, sum of weight * z over sum of weight; 0 = no Gaussian
    opacity: Tensor  # [H, W] sum of weight
    footprints: Footprints


def check_gaussians(
    means: Tensor,  # [N, 3]
    quats: Tensor,  # [N, 4]
    scales: Tensor,  # [N, 3]
    opacities: Tensor,  # [N]
    sh: Tensor,  # [N, K, 3]
    background: Tensor | None,  # [3]
) -> None:
    """Check that all arguments are of the same N Gaussians, on one device.

    Raises:
        GeoEvsError: a shape or a device differs; the sentence names the argument.
    """
    count = len(means)
    shapes = {
        "means": (means, (count, 3)),
        "quats": (quats, (count, 4)),
        "scales": (scales, (count, 3)),
        "opacities": (opacities, (count,)),
        "sh": (sh, (count, sh.shape[1] if sh.ndim == 3 else "K", 3)),
    }
    if background is not None:
        shapes["background"] = background, (3,)
    for name, (tensor, shape) in shapes.items():
        if tuple(tensor.shape) != shape:
            wanted = ", ".join(map(str, shape))
            raise GeoEvsError(f"{name} has shape {tuple(tensor.shape)}; give it as ({wanted})")
        if tensor.device != means.device:
            raise GeoEvsError(
                f"{name} is on {tensor.device} but means on {means.device}; move them together"
            )
    if sh.shape[1] not in SH_COUNTS:
        raise GeoEvsError(
            f"sh has {sh.shape[1]} coefficients a Gaussian; give it 1 (degree 0) or 4 (degree 1)"
        )

"""Depth of a frame's source views, by the model's name (paper section 3.2)."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.core.images import to_uint8
from geoevs.geometry.lift import lidar_depths
from geoevs.geometry.network_input import Window, public_input
from geoevs.geometry.scale import fit_scale, frame_factor
from geoevs.methods.contract import Views
from geoevs.projection import zbuffer
from geoevs.scenes.camera import Camera

if TYPE_CHECKING:
    from torch import nn

# torch is imported where a network is made: it takes seconds, and names are listed without one.

ANYTHING_LONGEST, ANYTHING_PATCH = 504, 14
"""Pixels of the longer side of what Depth Anything 3 is shown, and a side of its patches."""

Maps = Sequence[np.ndarray]
"""A map of each view, [h, w] of any height and width."""


class DepthModel(Protocol):
    """A source of depth for the source views of a frame."""

    parameters: int
    """Number of learned values; 0 without a network."""

    def depths(self, views: Views, frame: int) -> dict[str, np.ndarray]:
        """(H, W) float32 metres by camera, 0 = none."""
        ...


def make_depth_model(name: str, weights: Path | None) -> DepthModel:
    """The depth model `name`, one of DEPTH_MODELS.

    Args:
        name: `lidar`, `vggt-nano`, `vggt-1b` or `depth-anything-3`.
        weights: of a VGGT, a file (see `load_vggt`); of Depth Anything 3, a folder as its
            repositories on Hugging Face are; of `lidar`, None.

    Raises:
        GeoEvsError: there is no such model, its weights are missing or not its own, or it needs a
            package that is not installed.
    """
    if name not in DEPTH_MODELS:
        raise GeoEvsError(f"there is no depth model '{name}'; {did_you_mean(name, DEPTH_MODELS)}")
    if name == "lidar":
        if weights is not None:
            raise GeoEvsError(f"depth model 'lidar' has no weights; leave out {weights}")
        return LidarDepth()
    if weights is None:
        raise GeoEvsError(f"depth model '{name}' needs weights; give their path")
    return DEPTH_MODELS[name](weights)


class LidarDepth:
    """The LiDAR's own depth, completed (see `complete_depth`)."""

    parameters = 0

    def depths(self, views: Views, frame: int) -> dict[str, np.ndarray]:
        """(H, W) float32 metres by camera, 0 = none."""
        return lidar_depths(views, frame)


class NetworkDepth(ABC):
    """Depth that a network predicts of all views at once; LiDAR, where allowed, sets its scale."""

    model: "nn.Module"

    @property
    def parameters(self) -> int:
        """The number of values that the network has learned."""
        return sum(parameter.numel() for parameter in self.model.parameters())

    @abstractmethod
    def predict(
        self,
        images: np.ndarray,  # [V, H, W, 3] float32 in [0, 1]
        cameras: Sequence[Camera],
    ) -> tuple[Maps, Maps | None]:
        """Each view's depth, and its confidence if there is one, at any height and width."""

    def depths(self, views: Views, frame: int) -> dict[str, np.ndarray]:
        """(H, W) float32 metres by camera, 0 = none."""
        images = np.stack([views.image(name, frame) for name in views.cameras])
        cameras = [views.camera(name, frame) for name in views.cameras]
        # Depth must not blend across edges, so whatever its resolution, the nearest is taken.
        depth, confidence = (
            None if maps is None else _resize(maps, images.shape[1:3])
            for maps in self.predict(images, cameras)
        )
        if views.has("lidar"):
            points = views.lidar(frame).xyz
            measured = [zbuffer(points, one, visibility="footprint").depth for one in cameras]
            factor = frame_factor(zip(depth, measured, strict=True))
            for number, camera in enumerate(cameras):
                sure = None if confidence is None else confidence[number]
                fitted = fit_scale(depth[number], sure, measured[number], camera, factor)
                depth[number] = self.refined(images[number], fitted, points, camera)
        return {
            name: views.without_ego(name, one)
            for name, one in zip(views.cameras, depth, strict=True)
        }

    def refined(
        self,
        image: np.ndarray,  # [H, W, 3]
        fitted: np.ndarray,  # [H, W] metres
        points: np.ndarray,  # [N, 3]
        camera: Camera,
    ) -> np.ndarray:
        """(H, W) float32 metres: the fitted depth, where no network refines it by the LiDAR."""
        return fitted


class VggtDepth(NetworkDepth):
    """VGGT of any size, on the GPU if there is one."""

    def __init__(self, weights: Path) -> None:
        from geoevs.core.networks import best_device
        from geoevs.geometry.vggt import load_vggt

        self.model = load_vggt(weights).to(best_device())

    def predict(
        self,
        images: np.ndarray,  # [V, H, W, 3] float32 in [0, 1]
        cameras: Sequence[Camera],
    ) -> tuple[Maps, Maps]:
        """Depth and confidence at the size that the network is shown (see `VggtConfig.shown`)."""
        import torch

        inputs, windows = self.model.config.shown(images.astype(np.float32), cameras)
        batch = torch.from_numpy(inputs).permute(0, 3, 1, 2)
        with torch.inference_mode():
            prediction = self.model(batch[None].to(next(self.model.parameters()).device))
        depth, confidence = (_cut(maps[0].cpu().numpy(), windows) for maps in prediction)
        return depth, confidence

    def refined(
        self,
        image: np.ndarray,  # [H, W, 3]
        fitted: np.ndarray,  # [H, W] metres
        points: np.ndarray,  # [N, 3]
        camera: Camera,
    ) -> np.ndarray:
        """(H, W) float32 metres, refined if the weights have a refiner, as far as LiDAR reaches."""
        from geoevs.geometry.refinement import refine, refiner_inputs

        if self.model.refiner is None:
            return fitted
        inputs = refiner_inputs(image, fitted, points, camera)
        return fitted if inputs is None else refine(self.model.refiner, inputs, camera)


class DepthAnything3Depth(NetworkDepth):
    """Depth Anything 3 through its own package, on the GPU if there is one."""

    def __init__(self, weights: Path) -> None:
        from geoevs.core.networks import best_device

        try:
            from depth_anything_3.api import DepthAnything3
        except ImportError as error:
            raise GeoEvsError(
                f"depth model 'depth-anything-3' cannot be imported ({error}); run `pip install "
                "git+https://github.com/ByteDance-Seed/Depth-Anything-3`"
            ) from error
        if not Path(weights).is_dir():
            raise GeoEvsError(
                f"{weights} is no folder of Depth Anything 3 weights; download one of its "
                "repositories there with `hf download`"
            )
        model = DepthAnything3.from_pretrained(str(weights))
        self.model = model.to(best_device())

    def predict(
        self,
        images: np.ndarray,  # [V, H, W, 3] float32 in [0, 1]
        cameras: Sequence[Camera],
    ) -> tuple[Maps, Maps | None]:
        """Depth and confidence at the size it works in.

        Its package resizes pictures to ANYTHING_LONGEST and keeps their aspect, so it is given them
        so, with the aspect that was recorded. It is not told the poses: it would take its scale
        from the distances between cameras, which on a vehicle are too short for that, and it
        refuses cameras in one line.
        """
        inputs, windows = public_input(
            [to_uint8(image) for image in images], cameras, ANYTHING_LONGEST, ANYTHING_PATCH
        )
        prediction = self.model.inference(list(inputs))
        depth, confidence = (
            None if maps is None else _cut(_resize(maps, inputs.shape[1:3]), windows)
            for maps in (prediction.depth, prediction.conf)
        )
        return depth, confidence


DEPTH_MODELS: dict[str, Callable[..., DepthModel]] = {
    "lidar": LidarDepth,
    "vggt-nano": VggtDepth,
    "vggt-1b": VggtDepth,
    "depth-anything-3": DepthAnything3Depth,
}


def _cut(
    maps: np.ndarray,  # [V, h, w]
    windows: Sequence[Window],
) -> Maps:
    """Each view's part of what the network was shown."""
    return [one[window] for one, window in zip(maps, windows, strict=True)]


def _resize(
    maps: Maps,
    size: tuple[int, int],
) -> np.ndarray:
    """The maps at height and width `size`, by their nearest pixels, as float32 of their own."""
    nearest = cv2.INTER_NEAREST_EXACT
    return np.stack(
        [cv2.resize(one.astype(np.float32), size[::-1], interpolation=nearest) for one in maps]
    )

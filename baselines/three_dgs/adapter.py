"""3DGS: Gaussians from points of SfM, fitted to all images as if nothing moved."""

from typing import ClassVar

from baselines.gaussians.method import GaussianMethod
from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Views

FAR_SHARE = 4
"""One in so many of the points to start from lies farther than SfM and LiDAR reach."""


class Method(GaussianMethod):
    """3D Gaussian Splatting at the size of this suite's scenes; see docs/gaussians.md."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "3DGS",
        paradigm="reconstruction",
        needs=("sfm", "lidar"),
        citation="Kerbl et al.: 3D Gaussian Splatting for Real-Time Radiance Field Rendering, 2023",
    )

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Fit one set of Gaussians to all source views."""
        from baselines.gaussians.initialisation import (
            scene_extent,
            starting_points,
            with_far_points,
        )
        from baselines.gaussians.model import gaussians_from_points
        from baselines.gaussians.nodes import Background, SceneGraph

        def prepare(photos, most):
            far = most // FAR_SHARE
            points = starting_points(views, most - far, rng.numpy, cache=self.sfm_cache)
            points = with_far_points(points, far, views, rng.numpy)
            gaussians = gaussians_from_points(points.xyz, points.rgb, sh_degree=1)
            graph = SceneGraph(Background(gaussians.to(photos[0].image.device)))
            extents = {"background": scene_extent(views)}
            return graph, extents, lambda *_: 0.0, [points.note]

        return self._train(views, budget, rng, prepare)

"""Street Gaussians: a background, actors that move with their boxes, and a sky."""

from typing import ClassVar

from baselines.gaussians.method import GaussianMethod
from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, FitReport, MethodInfo, Views


class Method(GaussianMethod):
    """Street Gaussians at the size of this suite's scenes; see docs/gaussians.md."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "Street Gaussians",
        paradigm="reconstruction",
        needs=("sfm", "lidar", "tracks"),
        citation="Yan et al.: Street Gaussians for Modeling Dynamic Urban Scenes, ECCV 2024",
    )

    def fit(self, views: Views, budget: Budget, rng: Rng) -> FitReport:
        """Fit the nodes of a scene to its source views, LiDAR and boxes."""
        from baselines.gaussians.initialisation import scene_extent, starting_points
        from baselines.gaussians.model import gaussians_from_points
        from baselines.gaussians.nodes import Background, SceneGraph
        from baselines.street_gaussians.actors import make_actors, moving_tracks, outside_all
        from baselines.street_gaussians.losses import new_sky, street_loss, with_evidence

        def prepare(photos, most):
            device = photos[0].image.device
            tracks = moving_tracks(views)
            clouds = {frame: views.lidar(frame) for frame in views.frames}
            photos[:] = [with_evidence(photo, clouds[photo.frame], tracks) for photo in photos]
            points = starting_points(views, most, rng.numpy, "sfm and lidar", self.sfm_cache)
            keep = outside_all(points.xyz, tracks)
            background = gaussians_from_points(points.xyz[keep], points.rgb[keep], sh_degree=1)
            actors = make_actors(tracks, views, clouds, rng.numpy, device)
            graph = SceneGraph(Background(background.to(device)), actors, new_sky(photos))
            extents = {actor.name: float(actor.size.norm()) / 2 for actor in actors}
            extents["background"] = scene_extent(views)
            notes = [points.note, f"{len(actors)} actors" if actors else "no actor nodes"]
            return graph, extents, street_loss, notes

        return self._train(views, budget, rng, prepare)

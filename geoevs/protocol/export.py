"""What a method in another environment or language is given: a scene folder and its cameras."""

from pathlib import Path

from geoevs.core.files import new_folder
from geoevs.methods.contract import NEEDS, Views
from geoevs.protocol.targets import Target, source_cameras, write_targets
from geoevs.scenes.store import Scene


def export_views(folder: Path, scene: Scene, targets: list[Target], sources: str) -> None:
    """Write what methods may see as `scene`, and the views to render as `cameras.json`.

    All that methods can declare to need is there; points that score are not. Masked targets are
    left out: images from elsewhere come from no condition map that could be masked.

    Args:
        folder: what to write, whole or not at all.
        scene: the clean scene.
        targets: all of the scene's.
        sources: ALL_CAMERAS, or FRONT_SIDE for interpolation.

    Raises:
        GeoEvsError: there are no such sources.
    """
    asked = [target for target in targets if target.sources == sources and not target.masked]
    with new_folder(folder) as partial:
        Views(scene, source_cameras(scene, sources), NEEDS).save(partial / "scene")
        write_targets(partial / "cameras.json", asked)

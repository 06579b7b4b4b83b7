"""Dense truth at targets that no camera recorded, which no method may see."""

from collections.abc import Callable
from pathlib import Path

from geoevs.core.files import new_folder, write_arrays, write_json
from geoevs.core.images import write_image
from geoevs.protocol.targets import Target, virtual_targets
from geoevs.scenes.scene import SceneRef, SceneSource


def write_truth(
    folder: Path,
    source: SceneSource,
    ref: SceneRef,
    targets: list[Target],
    advance: Callable[[], None],
) -> None:
    """Render truth at every virtual target: `<target key>.png` and `.npz` (depth).

    Sources without truth leave a folder that holds `truth.json` alone, which lists the targets.

    Args:
        folder: what to write, whole or not at all.
        source: who renders.
        ref: the scene.
        targets: the scene's targets.
        advance: called after each view, for a progress bar.
    """
    virtual = virtual_targets(targets) if source.has_truth else []
    with new_folder(folder) as partial:
        views = [(target.camera, target.frame) for target in virtual]
        rendered = source.truth(ref, views) if views else ()
        for target, truth in zip(virtual, rendered, strict=True):
            write_image(partial / f"{target.key}.png", truth.rgb)
            write_arrays(partial / f"{target.key}.npz", {"depth": truth.depth})
            advance()
        write_json(partial / "truth.json", [target.key for target in virtual])

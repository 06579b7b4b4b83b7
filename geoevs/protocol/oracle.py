"""The ceiling: a control that copies the answer, outside the adapter contract on purpose."""

from pathlib import Path

from geoevs.adapter import Rendering
from geoevs.protocol.reference import References
from geoevs.protocol.targets import Target
from geoevs.protocol.truth import dense_truth
from geoevs.scenes.store import Scene


class ReferenceCopy:
    """Renders the sparse reference itself, over the dense truth where there is one, else black."""

    def __init__(self, scene: str, references: str, truth: str) -> None:
        self._scene = Scene(Path(scene))
        self._references = References(Path(references))
        self._truth = Path(truth)

    def render(self, target: Target) -> Rendering:
        """The best picture that the target's metrics can be given."""
        dense = dense_truth(self._scene, self._truth, target)
        if target.recorded:
            return Rendering(dense)
        reference = self._references[target.key]
        image = reference.image()
        if dense is not None:
            mask = reference.mask()
            dense[mask] = image[mask]
            image = dense
        return Rendering(image)

"""Controls that copy what scores a method, outside the adapter contract on purpose."""

from pathlib import Path

from geoevs.core.errors import GeoEvsError
from geoevs.methods.contract import Rendering
from geoevs.protocol.entries import TRUTH
from geoevs.protocol.reference import References
from geoevs.protocol.targets import Target
from geoevs.protocol.truth import dense_truth
from geoevs.scenes.store import Scene


class Oracle:
    """One of ORACLES.

    `reference` renders the sparse reference over the dense truth where there is one, else over
    black: the ceiling of every sparse metric. `truth` renders the dense truth alone: what a perfect
    method scores against a reference that has errors of its own.
    """

    def __init__(self, name: str, scene: str, references: str, truth: str) -> None:
        self._name = name
        self._scene = Scene(Path(scene))
        self._references = References(Path(references))
        self._truth = Path(truth)

    def render(self, target: Target) -> Rendering:
        """Copy the answer to a target.

        Raises:
            GeoEvsError: `truth` is asked for a target whose truth nobody knows.
        """
        dense = dense_truth(self._scene, self._truth, target)
        if target.recorded:
            return Rendering(dense)
        if self._name == TRUTH:
            if dense is None:
                raise GeoEvsError(
                    f"nobody knows the truth of {target.key}; set the control '{TRUTH}' to null "
                    "under methods for recorded data"
                )
            return Rendering(dense)
        reference = self._references[target.unmasked.key]
        image = reference.image()
        if dense is None:
            return Rendering(image)
        mask = reference.mask()
        dense[mask] = image[mask]
        return Rendering(dense)

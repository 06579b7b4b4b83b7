"""Geo-EVS that keeps what geometry explains and generates only the rest."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from geoevs.generator.geo_evs.adapter import Method as GeoEvs
from geoevs.geometry.blending import BlendedViews
from geoevs.geometry.lifted import LiftedViews
from geoevs.methods.contract import MethodInfo


@dataclass
class Method(GeoEvs):
    """Geo-EVS that generates only the pixels that no frame's geometry explains."""

    info: ClassVar[MethodInfo] = replace(
        GeoEvs.info, name="Geo-EVS, support kept", needs=(*GeoEvs.info.needs, "tracks")
    )
    trainers: ClassVar[tuple[str, ...]] = ("geo-evs",)
    lifting: ClassVar[type[LiftedViews]] = BlendedViews

    def _finish(
        self, generated: np.ndarray, condition: np.ndarray, valid: np.ndarray
    ) -> np.ndarray:
        """Supported pixels stay, the others are generated, without seams."""
        from geoevs.generator.geo_evs_support.support import keep_support

        return keep_support(generated, condition, valid)

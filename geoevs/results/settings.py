"""The config's `tables` section, as what makes tables takes it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from geoevs.core.settings import check_options


@dataclass(frozen=True)
class TableSettings:
    """How rows become tables.

    Args:
        pose_bins: edges of bins of angles to the front camera, in degrees, rising.
        support_bins: edges of bins of support ratios, rising.
        resamples: bootstrap resamples of frames within scenes.
        confidence: of intervals, such as 0.95.
        ablation: the method whose variants the ablation compares.
    """

    pose_bins: Sequence[float]
    support_bins: Sequence[float]
    resamples: int
    confidence: float
    ablation: str

    @classmethod
    def parse(cls, section: Mapping[str, Any]) -> Self:
        """The settings of a config's section.

        Raises:
            GeoEvsError: a key is unknown, missing or of another type.
        """
        check_options("the section 'tables'", cls, section)
        return cls(**section)

    @property
    def bootstrap(self) -> tuple[int, float]:
        """What a bootstrap takes: the number of resamples, and the confidence."""
        return self.resamples, self.confidence

    @property
    def tails(self) -> tuple[float, float]:
        """The quantiles that are an interval's ends."""
        tail = (1 - self.confidence) / 2
        return tail, 1 - tail

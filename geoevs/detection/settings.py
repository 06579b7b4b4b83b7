"""The config's section `detection`: which views, labels and detectors table 3 is made of."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from geoevs.core.settings import Count, OneOf, Within, make_settings
from geoevs.detection.bevformer.settings import Detector, Fitting
from geoevs.detection.rules import ROAD_USERS
from geoevs.detection.views import Shift, ViewSettings

CLASSES = {
    "vehicle": (
        *("car", "vehicle"),  # street, Waymo
        *("Car", "Pickup Truck", "Medium-sized Truck", "Semi-truck", "Bus", "Motorcycle"),
        *("Emergency Vehicle", "Other Vehicle - Construction Vehicle"),
        *("Other Vehicle - Uncommon", "Other Vehicle - Pedicab"),
        *("vehicle.car", "vehicle.truck", "vehicle.bus.bendy", "vehicle.bus.rigid"),
        *("vehicle.trailer", "vehicle.construction", "vehicle.motorcycle"),
        *("vehicle.emergency.ambulance", "vehicle.emergency.police"),
    ),
    "pedestrian": (
        *("pedestrian", "Pedestrian", "Pedestrian with Object"),
        *("human.pedestrian.adult", "human.pedestrian.child"),
        *("human.pedestrian.construction_worker", "human.pedestrian.police_officer"),
        *("human.pedestrian.personal_mobility", "human.pedestrian.wheelchair"),
        "human.pedestrian.stroller",
    ),
    "cyclist": ("cyclist", "Bicycle", "vehicle.bicycle"),
}
"""Labels of street, Waymo, PandaSet and nuScenes by class, as Waymo has the classes: motorcycles
are vehicles."""


@dataclass(frozen=True)
class DetectionSettings:
    """What `snakemake detection` makes.

    Args:
        views: the generated ones between recorded cameras.
        offsets: of the rig in the task metrics, metres across the ego heading, left positive.
        classes: labels of the data sources, by class; all other labels are of no class.
        seeds: detectors of each setting, numbered from the run's seed on.
        longer: times the steps of the others that `longer` trains for.
        detector: its architecture.
        training: how it learns.
        methods: entrants by their names under `methods`, with options over those there; null leaves
            one out.
    """

    views: ViewSettings = field(default_factory=ViewSettings)
    offsets: tuple[Shift, ...] = (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0)
    classes: dict[Annotated[str, OneOf(ROAD_USERS)], tuple[str, ...]] = field(
        default_factory=lambda: dict(CLASSES)
    )
    seeds: Annotated[Count, Within(1, 100)] = 3
    longer: Annotated[float, Within(1, 100)] = 3.0
    detector: Detector = field(default_factory=Detector)
    training: Fitting = field(default_factory=Fitting)
    methods: dict[str, dict[str, Any] | None] = field(default_factory=dict)

    @classmethod
    def parse(cls, section: Mapping[str, Any]) -> "DetectionSettings":
        """The settings of a config's section.

        Raises:
            SettingError: a name that is no setting, or a value of another type or out of bounds.
        """
        return make_settings("'detection'", cls, section)

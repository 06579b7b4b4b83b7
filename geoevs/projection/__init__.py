"""The validity operator: which points a camera sees, and in which pixels (section 3.2)."""

from geoevs.projection.validity import (
    FOOTPRINT_RADIUS,
    FOOTPRINT_TOLERANCE,
    VISIBILITIES,
    Raster,
    ZBuffer,
    colour_frame,
    colour_points,
    project_points,
    rasterize_points,
    sample_bilinear,
    unproject_depth,
    visible,
    zbuffer,
)

__all__ = [
    "FOOTPRINT_RADIUS",
    "FOOTPRINT_TOLERANCE",
    "VISIBILITIES",
    "Raster",
    "ZBuffer",
    "colour_frame",
    "colour_points",
    "project_points",
    "rasterize_points",
    "sample_bilinear",
    "unproject_depth",
    "visible",
    "zbuffer",
]

"""Names of the splits of targets, as methods say where they take part (paper section 4)."""

PLAIN_SPLITS = (
    *("observed", "interpolation", "extrapolation", "pose-sweep"),
    *("lateral", "yaw"),  # of stability
    *("detection", "rig-offset"),  # of detection
)
"""All but those of masked views, which go with the split whose views they are."""

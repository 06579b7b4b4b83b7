"""The evaluation protocol: targets, sparse reference, metrics, scoring (paper sections 3.5, 4)."""

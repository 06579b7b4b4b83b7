"""Geo-EVS: a benchmark suite for extrapolative view synthesis in driving scenes."""

__version__ = "0.1.0"

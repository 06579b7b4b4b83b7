"""Geo-EVS: a benchmark suite for extrapolative view synthesis in driving scenes."""

__version__ = "0.2.0"
PROTOCOL = 1
"""The version of the protocol; docs/protocol.md says when it is raised."""

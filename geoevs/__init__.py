"""Geo-EVS: a benchmark suite for extrapolative view synthesis in driving scenes."""

__version__ = "0.2.0"
"""The package's version; CHANGELOG.md says what each version changed for users."""

PROTOCOL = 1
"""Version of what the benchmark's numbers mean, written into every run.

It is raised when the same config would give numbers of another meaning: other targets, masks or
metrics. Numbers of different protocol versions are not to be compared.
"""

"""Geo-EVS that generates only what geometry does not explain."""

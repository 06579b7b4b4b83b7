"""Procedural streets, rendered with Mitsuba 3: the data source that needs no download."""

"""Scores a folder of images that somebody else rendered."""

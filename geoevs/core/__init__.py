"""Foundations that know nothing of scenes: errors, files, randomness, plugins, networks."""

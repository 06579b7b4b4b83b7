"""A run's config: its entrants and scenes, and the checks before anything runs."""

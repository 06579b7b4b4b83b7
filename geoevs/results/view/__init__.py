"""A run's scene in the browser: what entrants show from any pose, among what was recorded."""

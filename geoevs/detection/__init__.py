"""3-D detection: how boxes are scored, from pairs of boxes to additive counts and tables."""

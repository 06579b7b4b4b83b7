"""Depth of source views, and the coloured clouds it lifts them to (paper section 3.2)."""

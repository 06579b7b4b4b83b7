"""Data sources, one folder each; `source.py` in it holds the class `Source` (see `SceneSource`)."""

"""What a new data source is checked by before a scene of it is written, and its first files."""

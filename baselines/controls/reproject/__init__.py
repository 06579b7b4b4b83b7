"""Control: the source views, lifted by LiDAR and projected into the target."""

"""FreeVS: views generated from LiDAR points, which pseudo-images show as they would be seen."""

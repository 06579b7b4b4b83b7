"""3D Gaussian splatting, the original: everything stands still."""

"""Gaussian splatting: a differentiable rasterizer for CPUs, which works without the rest."""

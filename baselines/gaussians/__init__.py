"""Gaussian splatting: a differentiable rasterizer for CPUs, and methods of trained Gaussians.

`rasterizer.rasterize` can be used alone: it needs numba, torch, and of this suite a camera.
"""

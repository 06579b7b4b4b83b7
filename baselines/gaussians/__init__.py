"""Gaussian splatting: a differentiable rasterizer for CPUs, and methods of trained Gaussians.

`rasterizer.rasterize_gaussians` can be used alone: it needs numba, torch, and a camera.
"""

"""Artifact-guided latent diffusion: from a condition map to an image (paper sections 3.3, 3.4)."""

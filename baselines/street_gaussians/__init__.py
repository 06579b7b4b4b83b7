"""Street Gaussians: a scene of a background, rigid actors on their tracks, and a sky."""

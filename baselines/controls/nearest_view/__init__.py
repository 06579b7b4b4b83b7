"""Control: the nearest source image, turned to the target's direction."""

"""Control, the floor: one colour for every pixel."""

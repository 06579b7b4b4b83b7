"""Pedestrians that walk: limbs swing with the distance covered."""

import numpy as np

from geoevs.scenes.sources.street.mesh import MeshBuilder, add_tube, icosphere

SKINS = ((0.55, 0.36, 0.26), (0.40, 0.24, 0.16), (0.16, 0.085, 0.05), (0.62, 0.43, 0.33))
CLOTHES = (
    (0.05, 0.07, 0.16), (0.34, 0.05, 0.05), (0.08, 0.08, 0.09), (0.45, 0.42, 0.36),
    (0.10, 0.22, 0.12), (0.50, 0.30, 0.06), (0.20, 0.26, 0.36), (0.52, 0.50, 0.48),
)  # fmt: skip
STRIDE = 1.4  # metres of two steps
SIZE = (1.04, 0.62, 1.78)  # length, width, height of the box around a person of scale 1


class Person:
    """The looks of one pedestrian."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._skin = SKINS[rng.integers(len(SKINS))]
        self._top, self._legs = (CLOTHES[i] for i in rng.choice(len(CLOTHES), 2, replace=False))
        self._hair = tuple(np.array([0.09, 0.05, 0.025]) * rng.uniform(0.2, 2.5))
        self.scale = rng.uniform(0.9, 1.06)

    def mesh(self, distance: float) -> MeshBuilder:
        """The person at the origin, facing +x, after walking `distance` metres."""
        body = MeshBuilder()
        swing = 0.34 * np.sin(2 * np.pi * distance / STRIDE)
        for side in (-1, 1):
            self._leg(body, side * 0.09, side * swing)
            self._arm(body, side * 0.24, -side * 0.8 * swing)
        for low, high, wide in ((0.84, 1.12, (0.16, 0.18)), (1.12, 1.44, (0.18, 0.20))):
            add_tube(body, "matte", (0, 0, low), (0, 0, high), wide, self._top, 10)
        add_tube(body, "matte", (0, 0, 1.44), (0, 0, 1.50), (0.20, 0.07), self._top, 10)
        add_tube(body, "matte", (0, 0, 1.48), (0.01, 0, 1.58), (0.055, 0.055), self._skin)
        ball = icosphere(2)
        head = ball * [0.10, 0.085, 0.125] + [0.015, 0, 1.65]
        body.triangles("matte", head, self._skin, np.array(ball))
        hair = ball[ball[:, :, 2].mean(axis=1) > 0.15] * [0.112, 0.098, 0.13] + [0, 0, 1.655]
        body.triangles("matte", hair, self._hair)
        return body

    def _leg(self, body: MeshBuilder, y: float, swing: float) -> None:
        bend = max(-swing, 0.0)
        knee = (0.44 * np.sin(swing) + 0.05, y, 0.88 - 0.42 * np.cos(swing))
        foot = (knee[0] + 0.40 * np.sin(swing - bend), y, max(knee[2] - 0.42, 0.06))
        add_tube(body, "matte", (0, y, 0.90), knee, (0.095, 0.07), self._legs)
        add_tube(body, "matte", knee, foot, (0.07, 0.05), self._legs)
        toe = (foot[0] + 0.17, y, 0.045)
        add_tube(body, "matte", (foot[0] - 0.05, y, 0.05), toe, (0.05, 0.04), (0.03, 0.025, 0.02))

    def _arm(self, body: MeshBuilder, y: float, swing: float) -> None:
        elbow = (0.28 * np.sin(swing), y * 1.05, 1.42 - 0.28 * np.cos(swing))
        hand = (elbow[0] + 0.26 * np.sin(swing + 0.3), y, elbow[2] - 0.25)
        add_tube(body, "matte", (0, y * 0.88, 1.42), elbow, (0.06, 0.05), self._top)
        add_tube(body, "matte", elbow, hand, (0.05, 0.035), self._top)
        tip = (hand[0] + 0.02, y, hand[2] - 0.1)
        add_tube(body, "matte", hand, tip, (0.04, 0.03), self._skin)

"""What stands along a street: trees, lamps, signs, traffic lights, hedges, bins and benches."""

import numpy as np

from geoevs.scenes.sources.street.layout import KERB_HEIGHT, KerbLine, Street, is_near
from geoevs.scenes.sources.street.mesh import MeshBuilder, add_tube, boxes, icosphere

STEEL = (0.16, 0.17, 0.17)
CLUMPS = 11  # of leaves, a tree
NEAR_LEAVES, FAR_LEAVES = 120, 32  # a clump; far trees have fewer and larger ones


def add_furniture(
    builder: MeshBuilder,
    street: Street,
    gardens: list[tuple[np.ndarray, np.ndarray]],
    rng: np.random.Generator,
) -> None:
    """Place furniture along every kerb, and trees in the (start, end) gardens between houses."""
    trees = [_Tree(rng) for _ in range(4)]
    for start, end in gardens:
        _plant(builder, start, end, trees, rng)
    for kerb in street.kerbs:
        spacing = rng.uniform(8, 13)
        strip = 0.2 + max(street.verge, 1.0) / 2
        for number, (x, y, yaw) in enumerate(_places(kerb, strip, spacing, rng)):
            kind = number % 3
            if kind == 0:
                builder.place(_lamp(), x, y, KERB_HEIGHT, yaw)
            elif street.verge or rng.random() < 0.5:
                trees[rng.integers(len(trees))].plant(builder, x, y, KERB_HEIGHT, rng)
        for x, y, yaw in _places(kerb, 0.55, 17.0, rng):
            builder.place(_sign(rng), x, y, KERB_HEIGHT, yaw)
        for x, y, yaw in _places(kerb, street.facade - street.setback - 0.5, 14.0, rng):
            small = (_bin, _bench, _planter)[rng.integers(3)]
            builder.place(small(rng), x, y, KERB_HEIGHT, yaw)
        if street.setback:
            _add_hedge(builder, kerb, street.facade - street.setback + 0.3, rng)
    if street.crossing is not None:
        _add_traffic_lights(builder, street.half_width, street.crossing.at)


def _places(
    kerb: KerbLine, offset: float, spacing: float, rng: np.random.Generator
) -> list[tuple[float, float, float]]:
    """(x, y, yaw) along a kerb with yaw towards the road, away from the corners of blocks."""
    places = []
    line = kerb.offset(offset)
    for leg in kerb.legs:
        points = line[leg]
        steps = np.diff(points, axis=0)
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
        for s in np.arange(spacing / 2 + rng.uniform(-2, 2), length[-1] - 3, spacing):
            place = s + rng.uniform(-1, 1)
            x, y = (np.interp(place, length, points[:, axis]) for axis in (0, 1))
            along = steps[min(np.searchsorted(length, place), len(steps)) - 1]
            places.append((x, y, np.arctan2(-along[0], along[1])))
    return places


class _Tree:
    """One kind of tree, in fine and in coarse."""

    def __init__(self, rng: np.random.Generator) -> None:
        seed = int(rng.integers(2**31))
        self._near, self._far = (
            _tree(leaves, np.random.default_rng(seed)) for leaves in (NEAR_LEAVES, FAR_LEAVES)
        )

    def plant(
        self, builder: MeshBuilder, x: float, y: float, z: float, rng: np.random.Generator
    ) -> None:
        mesh = self._near if is_near(np.array([x, y])) else self._far
        builder.place(mesh, x, y, z, rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 1.15))


def _tree(leaf_count: int, rng: np.random.Generator) -> MeshBuilder:
    tree = MeshBuilder()
    bark = np.array([0.13, 0.10, 0.075]) * rng.uniform(0.7, 1.3)
    fork = rng.uniform(2.2, 3.0)
    lean = rng.uniform(-0.15, 0.15, 2)
    add_tube(tree, "matte", (0, 0, -0.1), (*lean, fork), (0.17, 0.12), bark, 9)
    green = np.array([0.075, 0.135, 0.03]) * rng.uniform(0.75, 1.35)
    green = green * [rng.uniform(0.8, 1.5), 1, rng.uniform(0.7, 1.2)]
    ball = icosphere(1)
    for number in range(CLUMPS):
        turn = number * 2.4 + rng.uniform(-0.4, 0.4)
        out = 0.0 if number == 0 else rng.uniform(0.6, 1.55)
        z = fork + (2.6 if number == 0 else rng.uniform(0.5, 2.4))
        centre = np.array([lean[0] + out * np.cos(turn), lean[1] + out * np.sin(turn), z])
        if number % 3 == 1:
            add_tube(tree, "matte", (*lean, fork - 0.3), centre, (0.09, 0.03), bark, 6)
        size = rng.uniform(0.75, 1.15) * np.array([1, 1, 0.85])
        # A dark core keeps the sky from shining through; leaves cover it.
        tree.triangles("matte", 0.86 * size * ball + centre, 0.6 * green)
        leaves, light = _leaves(leaf_count, rng)
        shade = green * light * (1 + 0.25 * rng.normal(size=(len(leaves), 1)).clip(-2, 2))
        tree.quads("matte", size * leaves + centre, np.clip(shade, 0.004, 0.5))
    return tree


def _plant(
    builder: MeshBuilder,
    start: np.ndarray,  # [2]
    end: np.ndarray,  # [2]
    trees: list[_Tree],
    rng: np.random.Generator,
) -> None:
    """A garden behind a low wall, with rows of trees that close the view."""
    along = (end - start) / np.linalg.norm(end - start)
    inward = np.array([-along[1], along[0]])
    ring = np.array([start, end, end + 0.25 * inward, start + 0.25 * inward])
    low, high = (np.column_stack([ring, np.full(4, z)]) for z in (0.1, KERB_HEIGHT + 1.1))
    sides = np.stack([low, np.roll(low, -1, 0), np.roll(high, -1, 0), high], axis=1)
    builder.quads("matte", np.concatenate([sides, high[None]]), (0.36, 0.30, 0.25))
    for depth in (4.0, 9.0, 15.0):
        for share in np.arange(0.15, 1.0, 0.3):
            x, y = start + share * (end - start) + rng.uniform(-1, 1) * along + depth * inward
            trees[rng.integers(len(trees))].plant(builder, x, y, KERB_HEIGHT - 0.5, rng)


def _leaves(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(2 count, 4, 3) two-sided leaves over a unit sphere and (2 count, 1) their brightness."""
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    normal = out + 0.55 * rng.normal(size=out.shape)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    side = np.cross(normal, rng.normal(size=out.shape))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    long, wide = rng.uniform(1.2, 2.4, (2, count, 1)) / np.sqrt(count)
    reach = rng.uniform(0.78, 1.12, (count, 1))
    middle = reach * out
    up = np.cross(normal, side)
    front = np.stack(
        [middle - long * side, middle - wide * up, middle + long * side, middle + wide * up], axis=1
    )
    back = front[:, ::-1] - 0.001 * normal[:, None]
    light = (0.75 + 0.45 * (reach - 0.78) / 0.34) * (0.9 + 0.1 * out[:, 2:])
    return np.concatenate([front, back]), np.concatenate([light, light])


def _lamp() -> MeshBuilder:
    lamp = MeshBuilder()
    add_tube(lamp, "matte", (0, 0, 0), (0, 0, 1.0), (0.11, 0.09), STEEL)
    add_tube(lamp, "matte", (0, 0, 1.0), (0, 0, 6.6), (0.07, 0.05), STEEL)
    add_tube(lamp, "matte", (0, 0, 6.55), (1.7, 0, 7.0), (0.045, 0.035), STEEL)
    head = boxes(np.array([[1.4, -0.15, 6.94]]), np.array([[2.2, 0.15, 7.06]]))
    lamp.quads("matte", head, (0.3, 0.31, 0.31))
    return lamp


def _disc(radius: float, sides: int, x: float, z: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False) + np.pi / sides
    ring = np.stack([np.full(sides, x), radius * np.cos(angle), z + radius * np.sin(angle)], axis=1)
    middle = np.broadcast_to([x, 0, z], ring.shape)
    return np.stack([ring, np.roll(ring, -1, axis=0), middle], axis=1)


def _sign(rng: np.random.Generator) -> MeshBuilder:
    """A traffic sign on a post, turned across the road's direction."""
    upright = MeshBuilder()
    yellow = (0.55, 0.38, 0.03)
    red, blue, white = (0.42, 0.02, 0.02), (0.02, 0.10, 0.40), (0.68, 0.68, 0.66)
    kinds = ((8, red, white, 0.30), (24, red, white, 0.75), (24, blue, white, 0.3),
             (4, blue, white, 0.45), (3, red, white, 0.65), (4, yellow, red, 0.2))  # fmt: skip
    sides, rim, inner, share = kinds[rng.integers(len(kinds))]
    add_tube(upright, "matte", (0, 0, 0), (0, 0, 2.75), (0.035, 0.035), (0.35, 0.36, 0.36))
    plate = _disc(0.36, sides, 0.045, 2.4)
    upright.triangles("matte", plate, rim)
    upright.triangles("matte", _disc(0.36 * share, sides, 0.05, 2.4), inner)
    upright.triangles("matte", plate[:, ::-1] - [0.01, 0, 0], (0.3, 0.3, 0.3))
    sign = MeshBuilder()
    sign.place(upright, 0, 0, 0, np.pi / 2)
    return sign


def _bin(rng: np.random.Generator) -> MeshBuilder:
    thing = MeshBuilder()
    colour = ((0.04, 0.12, 0.07), (0.1, 0.1, 0.11), (0.05, 0.09, 0.2))[rng.integers(3)]
    add_tube(thing, "matte", (0, 0, 0), (0, 0, 0.95), (0.26, 0.3), colour, 12)
    add_tube(thing, "matte", (0, 0, 0.95), (0, 0, 1.05), (0.32, 0.2), (0.06, 0.06, 0.06), 12)
    return thing


def _bench(rng: np.random.Generator) -> MeshBuilder:
    thing = MeshBuilder()
    wood = np.array([0.26, 0.14, 0.07]) * rng.uniform(0.8, 1.2)
    slats = [[x, -0.9, 0.43] for x in (-0.2, -0.05, 0.1)] + [[-0.28, -0.9, z] for z in (0.6, 0.75)]
    sizes = [[0.12, 1.8, 0.04]] * 3 + [[0.04, 1.8, 0.11]] * 2
    thing.quads("matte", boxes(np.array(slats), np.array(slats) + sizes), wood)
    legs = np.array([[-0.2, y, 0.0] for y in (-0.75, 0.68)])
    thing.quads("matte", boxes(legs, legs + np.array([0.35, 0.07, 0.43])), (0.07, 0.07, 0.07))
    return thing


def _planter(rng: np.random.Generator) -> MeshBuilder:
    thing = MeshBuilder()
    side = boxes(np.array([[-0.35, -0.7, 0]]), np.array([[0.35, 0.7, 0.5]]))
    thing.quads("matte", side, (0.38, 0.33, 0.29))
    ball = icosphere(2)
    for y in (-0.4, 0.0, 0.4):
        bush = ball * [0.3, 0.34, 0.32] * rng.uniform(0.8, 1.1) + [0, y, 0.62]
        shade = np.array([0.08, 0.15, 0.04]) * (1 + 0.3 * rng.normal(size=(len(ball), 1)))
        thing.triangles("matte", bush, np.clip(shade, 0.01, 0.4))
    return thing


def _add_hedge(
    builder: MeshBuilder, kerb: KerbLine, offset: float, rng: np.random.Generator
) -> None:
    """Front gardens end in hedges with gaps for the doors."""
    near, far = kerb.offset(offset), kerb.offset(offset + 0.6)
    for leg in kerb.legs:
        for i in range(leg.start, leg.stop - 1):
            length = float(np.linalg.norm(near[i + 1] - near[i]))
            if rng.random() < 0.3 or length < 0.5:
                continue
            plan = np.array([near[i], near[i + 1], far[i + 1], far[i]])
            top = KERB_HEIGHT + rng.uniform(0.75, 1.0)
            low = np.column_stack([plan, np.full(4, KERB_HEIGHT)])
            high = np.column_stack([plan, np.full(4, top)])
            sides = np.stack([low, np.roll(low, -1, 0), np.roll(high, -1, 0), high], axis=1)
            uv = np.array([[0, 0], [length, 0], [length, 0.9], [0, 0.9]]) + rng.uniform(0, 2, 2)
            quads = np.concatenate([sides, high[None]])
            builder.quads("hedge", quads, (1, 1, 1), uv=np.broadcast_to(uv, (5, 4, 2)))


def _add_traffic_lights(builder: MeshBuilder, half: float, at: float) -> None:
    beyond = 6.0
    light = MeshBuilder()
    add_tube(light, "matte", (0, 0, 0), (0, 0, 3.4), (0.07, 0.06), STEEL)
    case = boxes(np.array([[-0.14, -0.17, 2.5]]), np.array([[0.1, 0.17, 3.5]]))
    light.quads("matte", case, (0.03, 0.03, 0.03))
    lamps = ((3.3, (0.65, 0.03, 0.02)), (3.0, (0.12, 0.08, 0.01)), (2.7, (0.01, 0.08, 0.04)))
    for z, colour in lamps:
        light.triangles("matte", _disc(0.11, 14, 0.11, z), colour)
    for turn in range(4):
        # One for each approach, on its right-hand kerb before the crosswalk.
        yaw = turn * np.pi / 2
        ahead, aside = np.array([np.cos(yaw), np.sin(yaw)]), np.array([np.sin(yaw), -np.cos(yaw)])
        x, y = np.array([at, 0.0]) - (half + beyond) * ahead + (half + 0.45) * aside
        builder.place(light, x, y, KERB_HEIGHT, yaw + np.pi)

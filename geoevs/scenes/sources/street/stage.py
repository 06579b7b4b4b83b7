"""Mitsuba scenes: the street as it is lit, and the same street with perfect mirrors.

Light that does not come straight from the sun is painted on: every surface glows with its albedo
times the ambient light for its orientation. That leaves nothing to estimate by random sampling, so
pictures have no noise. Reflections come from a second scene where glossy surfaces are black and
mirror, and everything else glows; `render` adds what the mirrors show.
"""

from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from geoevs.scenes.sources.street.finishes import Finish
from geoevs.scenes.sources.street.light import Light
from geoevs.scenes.sources.street.mesh import Surface, face_normals

SECTORS = 8  # compass directions that tell the ambient light of textured walls apart
SKY_SIZE = (384, 768)


@cache
def mitsuba() -> ModuleType:
    """Mitsuba in the variant that needs neither LLVM nor a GPU; imported when first needed."""
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    return mitsuba


class Scenes(NamedTuple):
    """The two Mitsuba scenes of one instant."""

    lit: Any
    mirror: Any


class Stage:
    """The unchanging part of a scene, ready to be joined by what moves."""

    def __init__(
        self, light: Light, finishes: dict[str, Finish], surfaces: dict[str, Surface]
    ) -> None:
        self._light, self._finishes = light, finishes
        self._tiles: dict[str, Any] = {}
        self._static = self._meshes("static", surfaces)
        self._lights = {
            "sun": {
                "type": "directional",
                "direction": (-light.to_sun).tolist(),
                "irradiance": _rgb(np.pi * light.sun),
            },
            "sky": mitsuba().load_dict(_sky(light)),
        }

    def with_moving(self, surfaces: dict[str, Surface]) -> Scenes:
        """The scenes of an instant, given what moves."""
        moving = self._meshes("moving", surfaces)
        shapes = [{**self._static[i], **moving[i]} for i in (0, 1)]
        load = mitsuba().load_dict
        return Scenes(
            lit=load({"type": "scene", **shapes[0], **self._lights}),
            mirror=load({"type": "scene", **shapes[1], **self._lights}),
        )

    def _meshes(
        self, group: str, surfaces: dict[str, Surface]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Shapes for the lit and for the mirror scene; matt ones are shared."""
        lit, mirror = {}, {}
        for finish, surface in surfaces.items():
            look = self._finishes[finish]
            for part, piece in (
                _by_orientation(surface) if look.tile is not None else [("", surface)]
            ):
                name = f"{group}_{finish}{part}".replace("-", "_")
                lit[name] = self._mesh(name, finish, piece)
                mirror[name] = lit[name] if look.index is None else _mirror(name, piece, look.index)
        return lit, mirror

    def _mesh(self, name: str, finish: str, surface: Surface) -> Any:
        look = self._finishes[finish]
        if look.tile is not None:
            mean = face_normals(surface.corners).mean(axis=0)
            ambient = self._light.ambient(mean / np.linalg.norm(mean))
            if finish not in self._tiles:
                self._tiles[finish] = _bitmap(look.tile)
            reflectance, radiance = self._tiles[finish], _bitmap(look.tile * ambient)
            uv = surface.uv / np.array(look.metres)
            return _make_mesh(name, surface, {}, uv, _diffuse(reflectance), radiance)
        colours = np.repeat(surface.colours, 3, axis=0)
        ambient = self._light.ambient(surface.normals.reshape(-1, 3))
        attributes = {"vertex_albedo": colours, "vertex_glow": colours * ambient}
        albedo, glow = ({"type": "mesh_attribute", "name": key} for key in attributes)
        bsdf = _diffuse(albedo)
        if finish == "paint":
            bsdf = {"type": "principled", "base_color": albedo, "roughness": 0.25}
        return _make_mesh(name, surface, attributes, None, bsdf, glow)


def _by_orientation(surface: Surface) -> list[tuple[str, Surface]]:
    """Split triangles by compass direction, and those that face up or down from the rest."""
    normals = face_normals(surface.corners)
    turn = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * np.pi)
    sector = np.rint(turn * SECTORS).astype(int) % SECTORS
    sector[np.abs(normals[:, 2]) > 0.9] = SECTORS
    return [
        (f"_{k}", Surface(*(field[sector == k] for field in surface))) for k in np.unique(sector)
    ]


def _mirror(name: str, surface: Surface, index: float) -> Any:
    bsdf = {"type": "plastic", "int_ior": index, "diffuse_reflectance": 0.0}
    return _make_mesh(name, surface, {}, None, bsdf, None)


def _make_mesh(
    name: str,
    surface: Surface,
    attributes: dict[str, np.ndarray],  # [3 T, 3] each
    uv: np.ndarray | None,  # [T, 3, 2]
    bsdf: dict[str, Any],
    radiance: Any | None,
) -> Any:
    mi = mitsuba()
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    if radiance is not None:
        # Weight 0: the integrators must not pick these lights to sample, only see them.
        emitter = {"type": "area", "radiance": radiance, "sampling_weight": 0.0}
        properties["emitter"] = mi.load_dict(emitter)
    count = len(surface.corners)
    mesh = mi.Mesh(
        name,
        3 * count,
        count,
        has_vertex_normals=True,
        has_vertex_texcoords=uv is not None,
        props=properties,
    )
    for key, value in attributes.items():
        mesh.add_attribute(key, 3, value.astype(np.float32).ravel())
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = surface.corners.astype(np.float32).ravel()
    parameters["faces"] = np.arange(3 * count, dtype=np.uint32)
    if uv is not None:
        parameters["vertex_texcoords"] = uv.astype(np.float32).ravel()
    parameters.update()
    # New positions make Mitsuba compute its own normals, so ours come after them.
    parameters["vertex_normals"] = surface.normals.astype(np.float32).ravel()
    parameters.update()
    return mesh


def _diffuse(reflectance: Any) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": reflectance}


def _bitmap(values: np.ndarray) -> Any:
    mi = mitsuba()
    image = mi.Bitmap(np.ascontiguousarray(values, np.float32))
    return mi.load_dict({"type": "bitmap", "bitmap": image, "raw": True})


def _rgb(value: np.ndarray) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in value]}


def _sky(light: Light) -> dict[str, Any]:
    """The sky as an environment map; Mitsuba's has y up, so it is turned."""
    mi = mitsuba()
    height, width = SKY_SIZE
    theta = (np.arange(height) + 0.5) / height * np.pi
    phi = (np.arange(width) + 0.5) / width * 2 * np.pi
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    x, y, z = np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)
    world = np.stack([x, -z, y], axis=-1)
    image = mi.Bitmap(light.sky(world).astype(np.float32))
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    return {"type": "envmap", "bitmap": image, "to_world": turn, "sampling_weight": 0.0}


def cast(scene: Any, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Follow rays to the first surface.

    Args:
        scene: a Mitsuba scene.
        origin: (3,) start of all rays.
        directions: (N, 3) unit directions.

    Returns:
        (N,) distance in metres, infinite where nothing is hit, and (N,) bool, whether the surface
        is glass or car paint.
    """
    mi = mitsuba()
    glossy_shapes = {shape for shape in scene.shapes() if shape.id().endswith(("glass", "paint"))}
    start = mi.Point3f(*origin.tolist())
    distance, glossy = np.full(len(directions), np.inf), np.zeros(len(directions), bool)
    for number, direction in enumerate(directions.tolist()):
        hit = scene.ray_intersect_preliminary(mi.Ray3f(start, mi.Vector3f(direction)))
        if hit.is_valid():
            distance[number] = hit.t
            glossy[number] = hit.shape in glossy_shapes
    return distance, glossy

"""Procedural shapes as smooth triangle meshes, and the Mitsuba descriptions that built-in scenes share."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba


@dataclasses.dataclass(frozen=True)
class MeshData:
    """Triangles with smooth normals, world or object units.

    Attributes:
        position, normal: per vertex; normals are unit and point outwards.
        uv: per vertex, in [0, 1].
        face: vertex indices, counter-clockwise seen from outside.
    """

    position: Float[np.ndarray, "V 3"]
    normal: Float[np.ndarray, "V 3"]
    uv: Float[np.ndarray, "V 2"]
    face: Int[np.ndarray, "F 3"]

    def moved(self, scale: float = 1.0, turn: float = 0.0, to: Sequence[float] = (0.0, 0.0, 0.0)) -> "MeshData":
        """Scaled evenly, turned about +y by ``turn`` degrees, then moved by ``to``."""
        cosine, sine = math.cos(math.radians(turn)), math.sin(math.radians(turn))
        rotation = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
        return dataclasses.replace(
            self,
            position=scale * self.position @ rotation.T + np.asarray(to, dtype=np.float64),
            normal=self.normal @ rotation.T,
        )

    def on_ground(self) -> "MeshData":
        """Moved up or down so that the lowest vertex has y = 0."""
        low = self.position[:, 1].min()
        return dataclasses.replace(self, position=self.position - np.array([0.0, low, 0.0]))


Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]


def parametric(surface: Surface, columns: int, rows: int, closed_v: bool = False) -> MeshData:
    """The surface ``surface(u, v) -> (..., 3)`` on a grid; u in [0, 1] wraps round, v in [0, 1] has ends.

    Vertices are doubled along the seams so that texture coordinates stay continuous. Normals are the cross
    product of central differences, which needs no formula per shape; at a pole, where the difference along u
    vanishes, they are the mean over its neighbours.

    Args:
        surface: has its outside where (d/du) x (d/dv) points.
        columns, rows: cells along u and v.
        closed_v: whether v wraps round too (a torus).
    """
    u, v = np.meshgrid(np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1))
    step = 1e-4
    low_v, high_v = (v - step, v + step) if closed_v else (np.maximum(v - step, 0.0), np.minimum(v + step, 1.0))
    along_u = surface(u + step, v) - surface(u - step, v)
    along_v = surface(u, high_v) - surface(u, low_v)
    normal = np.cross(along_u, along_v)
    if not closed_v:
        for row, inside in ((0, 1), (rows, rows - 1)):
            if np.abs(along_u[row]).max() < 1e-9:
                normal[row] = (normal[inside] / np.linalg.norm(normal[inside], axis=-1, keepdims=True)).mean(axis=0)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)

    corner = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)[:, :-1].reshape(-1)
    right, up, across = corner + 1, corner + columns + 1, corner + columns + 2
    face = np.concatenate([np.stack([corner, right, across], 1), np.stack([corner, across, up], 1)])
    position = surface(u, v).reshape(-1, 3)
    a, b, c = (position[face[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return MeshData(
        position=position,
        normal=normal.reshape(-1, 3),
        uv=np.stack([u, v], -1).reshape(-1, 2),
        face=face[area > 1e-12],
    )


def to_mesh(name: str, data: MeshData, bsdf: dict[str, Any]) -> Any:
    """A ``mi.Mesh`` of this data with this BSDF, ready to stand in a scene description."""
    mi = mitsuba()
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh(
        name,
        vertex_count=len(data.position),
        face_count=len(data.face),
        props=properties,
        has_vertex_normals=True,
        has_vertex_texcoords=True,
    )
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.ascontiguousarray(data.position, dtype=np.float32).ravel()
    params["vertex_normals"] = np.ascontiguousarray(data.normal, dtype=np.float32).ravel()
    params["vertex_texcoords"] = np.ascontiguousarray(data.uv, dtype=np.float32).ravel()
    params["faces"] = np.ascontiguousarray(data.face, dtype=np.uint32).ravel()
    params.update()
    return mesh


# --- surfaces ---------------------------------------------------------------------------------------------------


def sphere_mesh(radius: float, columns: int = 64, rows: int = 32) -> MeshData:
    """A sphere about the origin."""
    return superquadric_mesh(radius, 1.0, 1.0, columns, rows)


def superquadric_mesh(radius: float, east: float, north: float, columns: int = 64, rows: int = 48) -> MeshData:
    """A superellipsoid (Barr 1981): exponents 1, 1 give a sphere, smaller ones a rounded box."""

    def power(base: np.ndarray, exponent: float) -> np.ndarray:
        return np.sign(base) * np.abs(base) ** exponent

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        around, above = 2.0 * np.pi * u, np.pi * (v - 0.5)
        # cos(pi / 2) is 6e-17 in floating point; raised to a small power it would open a hole at the pole
        flat = np.where((v <= 0.0) | (v >= 1.0), 0.0, power(np.cos(above), north))
        return radius * np.stack(
            [flat * power(np.sin(around), east), power(np.sin(above), north), flat * power(np.cos(around), east)], -1
        )

    return parametric(surface, columns, rows)


def torus_mesh(radius: float, tube: float | tuple[float, float], columns: int = 96, rows: int = 32) -> MeshData:
    """A torus about the y axis; ``tube`` is its radius, or (half width, half height) of an elliptic tube."""
    wide, tall = tube if isinstance(tube, tuple) else (tube, tube)

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        around, about = 2.0 * np.pi * u, 2.0 * np.pi * v
        distance = radius + wide * np.cos(about)
        return np.stack([distance * np.sin(around), tall * np.sin(about), distance * np.cos(around)], -1)

    return parametric(surface, columns, rows, closed_v=True)


def twisted_column_mesh(
    radius: float, height: float, lobes: int = 4, depth: float = 0.2, turns: float = 0.4,
    columns: int = 96, rows: int = 48,
) -> MeshData:
    """A column with a lobed cross-section that twists by ``turns`` turns and closes in rounded ends."""

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        around = 2.0 * np.pi * u
        # superelliptic profile: nearly straight sides, round ends
        slope = np.pi * (v - 0.5)
        profile = np.where((v <= 0.0) | (v >= 1.0), 0.0, np.abs(np.cos(slope)) ** 0.45)
        rise = np.sign(np.sin(slope)) * np.abs(np.sin(slope)) ** 0.9
        fluted = 1.0 + depth * np.cos(lobes * (around + 2.0 * np.pi * turns * v))
        distance = radius * profile * fluted / (1.0 + depth)
        return np.stack([distance * np.sin(around), 0.5 * height * rise, distance * np.cos(around)], -1)

    return parametric(surface, columns, rows)


def vase_mesh(radius: float, height: float, columns: int = 80, rows: int = 64) -> MeshData:
    """A closed, bellied vase with a narrow neck: a smooth surface of revolution."""

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        around = 2.0 * np.pi * u
        ends = np.where((v <= 0.0) | (v >= 1.0), 0.0, np.abs(np.sin(np.pi * v)) ** 0.4)
        profile = ends * (0.55 + 0.45 * np.cos(2.0 * np.pi * (v - 0.36) * 1.05))
        rise = v
        return np.stack(
            [radius * profile * np.sin(around), height * rise, radius * profile * np.cos(around)], -1
        )

    return parametric(surface, columns, rows)


# --- pieces that several scenes share ---------------------------------------------------------------------------

METALS = ("Au", "Ag", "Cu", "Al")


def unit_setting(name: str, value: Any, low: float = 0.0, high: float = 1.0) -> float:
    """A material setting within a range, or an error that names it."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise PrtError(f"scene.{name}={value!r} must be a number between {low:g} and {high:g}")
    return float(value)


def rgb(color: Sequence[float]) -> dict[str, Any]:
    """A linear RGB reflectance as a Mitsuba dict."""
    return {"type": "rgb", "value": [float(part) for part in color]}


def twosided(bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": bsdf}


def rough_metal(metal: str, roughness: float) -> dict[str, Any]:
    """A GGX conductor with roughness sigma = sqrt(alpha); below alpha = 1e-6 a smooth one."""
    if metal not in METALS:
        raise PrtError(f"scene metal {metal!r} is not one of {', '.join(METALS)}")
    alpha = roughness**2
    if roughness < 1e-3:
        return {"type": "conductor", "material": metal}
    return {"type": "roughconductor", "distribution": "ggx", "material": metal, "alpha": alpha}


def glossy_plastic(color: Sequence[float], roughness: float) -> dict[str, Any]:
    """A diffuse base under a GGX dielectric coat, roughness sigma = sqrt(alpha)."""
    return {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": roughness**2,
        "diffuse_reflectance": rgb(color),
        "nonlinear": False,
    }


def glossy(color: Sequence[float], roughness: float, specular: float = 0.5, metallic: float = 0.0) -> dict[str, Any]:
    """A principled BSDF; its roughness is sigma by its own convention."""
    return {
        "type": "principled",
        "base_color": rgb(color),
        "roughness": roughness,
        "specular": specular,
        "metallic": metallic,
    }


def diffuse(color: Sequence[float]) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": rgb(color)}


def ground_description(
    size: float = 12.0,
    color: Sequence[float] = (0.32, 0.30, 0.27),
    roughness: float = 0.3,
    specular: float = 0.8,
    height: float = 0.0,
) -> dict[str, Any]:
    """A glossy square of side ``size`` at y = ``height``, facing up, as a Mitsuba shape dict."""
    mi = mitsuba()
    transform = mi.ScalarTransform4f
    return {
        "type": "rectangle",
        "to_world": transform().translate([0, height, 0]).rotate([1, 0, 0], -90).scale([size / 2, size / 2, 1]),
        "bsdf": twosided(glossy(color, roughness, specular)),
    }


def ring_description(
    center: Sequence[float] = (0.0, 0.0, 0.0),
    radius: float = 0.6,
    width: float = 0.05,
    height: float = 0.2,
    roughness: float = 0.35,
    metal: str = "Au",
) -> Any:
    """A metal ring lying on the ground, whose polished inner side casts a caustic onto it.

    Args:
        center: of its footprint; ``center[1]`` is the height of the ground.
        radius: of the middle of the band, world units.
        width, height: of the band, world units; the band is elliptic, so its normals are smooth.
        roughness: sigma = sqrt(GGX alpha).
        metal: Au, Ag, Cu or Al.

    Returns:
        A ``mi.Mesh`` (any place in a scene description takes it like a dict).
    """
    band = torus_mesh(radius, (width / 2, height / 2), columns=128, rows=32).on_ground().moved(to=center)
    return to_mesh("ring", band, twosided(rough_metal(metal, roughness)))

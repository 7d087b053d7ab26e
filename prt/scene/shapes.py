"""Procedural shapes as smooth triangle meshes, and the Mitsuba descriptions that built-in scenes share.

A change of any shape here changes scenes: raise ``geometry_version`` of those that use it.
"""

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

    def moved(
        self, scale: float = 1.0, turn: float = 0.0, to: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> "MeshData":
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
    low_v, high_v = (
        (v - step, v + step) if closed_v else (np.maximum(v - step, 0.0), np.minimum(v + step, 1.0))
    )
    along_u = surface(u + step, v) - surface(u - step, v)
    along_v = surface(u, high_v) - surface(u, low_v)
    normal = np.cross(along_u, along_v)
    if not closed_v:
        for row, inside in ((0, 1), (rows, rows - 1)):
            if np.abs(along_u[row]).max() < 1e-9:
                normal[row] = (normal[inside] / np.linalg.norm(normal[inside], axis=-1, keepdims=True)).mean(
                    axis=0
                )
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)

    corner = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)[:, :-1].reshape(-1)
    right, up, across = corner + 1, corner + columns + 1, corner + columns + 2
    face = np.concatenate([np.stack([corner, right, across], 1), np.stack([corner, across, up], 1)])
    # u = 1 is u = 0 again, to the last bit: sin(2 pi) is not quite 0, and a power of it would open the seam
    position = surface(u % 1.0, v % 1.0 if closed_v else v).reshape(-1, 3)
    a, b, c = (position[face[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return MeshData(
        position=position,
        normal=normal.reshape(-1, 3),
        uv=np.stack([u, v], -1).reshape(-1, 2),
        face=face[area > 1e-12],
    )


def to_mesh(name: str, data: MeshData, bsdf: Any, interior: Any = None) -> Any:
    """A ``mi.Mesh`` of this data with this BSDF (a dict or a ``mi.BSDF``), ready for a scene description.

    ``interior`` is the ``mi.Medium`` within, if there is one.
    """
    mi = mitsuba()
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf) if isinstance(bsdf, dict) else bsdf
    if interior is not None:
        properties["interior"] = interior
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


def _power(base: np.ndarray, exponent: float) -> np.ndarray:
    """The signed power of superellipses."""
    return np.sign(base) * np.abs(base) ** exponent


# --- surfaces --------------------------------------------------------------------------------


def sphere_mesh(radius: float, columns: int = 64, rows: int = 32) -> MeshData:
    """A sphere about the origin."""
    return superquadric_mesh(radius, 1.0, 1.0, columns, rows)


def superquadric_mesh(
    radius: float, east: float, north: float, columns: int = 64, rows: int = 48
) -> MeshData:
    """A superellipsoid (Barr 1981): exponents 1, 1 give a sphere, smaller ones a rounded box."""

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        around, above = 2.0 * np.pi * u, np.pi * (v - 0.5)
        # cos(pi / 2) is 6e-17 in floating point; raised to a small power it would open a hole at the pole
        flat = np.where((v <= 0.0) | (v >= 1.0), 0.0, _power(np.cos(above), north))
        return radius * np.stack(
            [
                flat * _power(np.sin(around), east),
                _power(np.sin(above), north),
                flat * _power(np.cos(around), east),
            ],
            -1,
        )

    return parametric(surface, columns, rows)


def torus_mesh(
    radius: float, tube: float | tuple[float, float], columns: int = 96, rows: int = 32, bulge: float = 1.0
) -> MeshData:
    """A torus about the y axis.

    Args:
        tube: its radius, or (half width, half height) of an elliptic tube.
        bulge: exponent of the superelliptic cross-section: 1 an ellipse, towards 0 a rectangle.
    """
    wide, tall = tube if isinstance(tube, tuple) else (tube, tube)

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        around, about = 2.0 * np.pi * u, 2.0 * np.pi * v
        distance = radius + wide * _power(np.cos(about), bulge)
        return np.stack(
            [distance * np.sin(around), tall * _power(np.sin(about), bulge), distance * np.cos(around)], -1
        )

    return parametric(surface, columns, rows, closed_v=True)


def lathe_mesh(
    profile: Sequence[tuple[float, float]],
    radius: float,
    height: float,
    lobes: int = 0,
    depth: float = 0.0,
    turns: float = 0.0,
    columns: int = 96,
    rows: int = 48,
) -> MeshData:
    """A profile turned about the y axis, from the axis at the bottom to the axis at the top.

    Args:
        profile: control points (radius, height) of a uniform cubic B-spline, in shares of ``radius`` and
            ``height``; the first and last lie on the axis and are met exactly, with a horizontal tangent.
        lobes, depth: flutes of the cross-section: how many, and how deep as a share of the radius.
        turns: by how many turns the flutes twist from bottom to top.
    """
    points = np.asarray(profile, dtype=np.float64)
    mirror = np.array([-1.0, 1.0])
    points = np.concatenate([points[1:2] * mirror, points, points[-2:-1] * mirror])
    spans = len(points) - 3

    def curve(v: np.ndarray) -> np.ndarray:
        first = np.clip(np.floor(v * spans).astype(int), 0, spans - 1)
        t = (v * spans - first)[..., None]
        weights = (1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3
        return np.sum([weight * points[first + k] for k, weight in enumerate(weights)], axis=0) / 6.0

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        around, outline = 2.0 * np.pi * u, curve(v)
        fluted = 1.0 - depth * (0.5 - 0.5 * np.cos(lobes * (around + 2.0 * np.pi * turns * outline[..., 1])))
        distance = radius * outline[..., 0] * fluted
        return np.stack([distance * np.sin(around), height * outline[..., 1], distance * np.cos(around)], -1)

    return parametric(surface, columns, rows)


def twisted_column_mesh(
    radius: float, height: float, lobes: int = 5, depth: float = 0.3, turns: float = 0.35
) -> MeshData:
    """A fluted column with a waist that twists by ``turns`` turns on its way up; it stands on y = 0."""
    profile = [
        (0, 0),
        (0.7, 0),
        (1, 0),
        (1.02, 0.08),
        (0.86, 0.3),
        (0.72, 0.6),
        (0.86, 0.88),
        (0.98, 1),
        (0.6, 1.02),
        (0, 1),
    ]
    return lathe_mesh(profile, radius, height, lobes, depth, turns)


def vase_mesh(radius: float, height: float) -> MeshData:
    """A bellied vase with a narrow neck and a dished top; it stands on y = 0."""
    belly = [(0, 0), (0.45, 0), (0.58, 0), (0.7, 0.06), (1.12, 0.3), (0.98, 0.52), (0.4, 0.68)]
    neck = [(0.27, 0.85), (0.42, 0.98), (0.56, 1.03), (0.36, 1.02), (0.22, 0.92), (0.15, 0.86), (0, 0.85)]
    return lathe_mesh(belly + neck, radius, height)


# --- pieces that several scenes share ------------------------------------------------------------

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


def glossy(
    color: Sequence[float], roughness: float, specular: float = 0.5, metallic: float = 0.0
) -> dict[str, Any]:
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
    color: Sequence[float] = (0.26, 0.25, 0.24),
    roughness: float = 0.3,
    specular: float = 1.0,
    height: float = 0.0,
    metallic: float = 0.35,
) -> dict[str, Any]:
    """A glossy square of side ``size`` at y = ``height``, facing up, as a Mitsuba shape dict."""
    mi = mitsuba()
    transform = mi.ScalarTransform4f
    return {
        "type": "rectangle",
        "to_world": transform()
        .translate([0, height, 0])
        .rotate([1, 0, 0], -90)
        .scale([size / 2, size / 2, 1]),
        "bsdf": twosided(glossy(color, roughness, specular, metallic)),
    }


def ring_description(
    center: Sequence[float] = (0.0, 0.0, 0.0),
    radius: float = 0.6,
    width: float = 0.06,
    height: float = 0.28,
    roughness: float = 0.32,
    metal: str = "Au",
) -> Any:
    """A metal ring lying on the ground, whose polished inner side casts a caustic onto it.

    Args:
        center: of its footprint; ``center[1]`` is the height of the ground.
        radius: of the middle of the band, world units.
        width, height: of the band, world units; its section is superelliptic, so its walls stand
            straight and its normals are smooth.
        roughness: sigma = sqrt(GGX alpha).
        metal: Au, Ag, Cu or Al.

    Returns:
        A ``mi.Mesh`` (any place in a scene description takes it like a dict).
    """
    band = (
        torus_mesh(radius, (width / 2, height / 2), columns=128, rows=32, bulge=0.6)
        .on_ground()
        .moved(to=center)
    )
    return to_mesh("ring", band, twosided(rough_metal(metal, roughness)))

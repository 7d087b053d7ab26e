"""Three potted plants as closed meshes: a broad-leaved one, a tuft of blades, one with feathered stems.

Every leaf is a thin closed solid. Places are drawn from one seed and do not depend on the thickness, so two
scenes that differ in it have the same leaves. A change here changes scenes: raise their ``geometry_version``.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from prt.scene.panels import joined
from prt.scene.shapes import MeshData, lathe_mesh
from prt.scene.swept import spline, swept_mesh

#: leaf after leaf turned by this keeps them out of each other's light, as in nature
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
SEED = 20
#: share of the leaves that grow on the broad-leaved plant and in the tuft; the rest are feathers
BROAD, TUFT = 0.16, 0.22
#: stems of the feathered plant, and sides of its stems
FRONDS, SIDES = 11, (1, -1)
UP = np.array([0.0, 1.0, 0.0])


@dataclasses.dataclass(frozen=True)
class Kind:
    """A leaf's outline and cross-section; lengths are shares of its own length unless said otherwise.

    Attributes:
        width: from edge to edge at its broadest.
        stalk: share of the length that is a stalk.
        stalk_radius: world units.
        broadest: exponent that moves the broadest place: 1 the middle, below 1 towards the stalk.
        fold: how steeply the halves rise from the midrib, 0 a flat leaf.
        columns, rows: cells around and along it.
    """

    width: float
    stalk: float
    stalk_radius: float
    broadest: float
    fold: float
    columns: int
    rows: int


BROAD_LEAF = Kind(0.42, 0.16, 0.008, 0.85, 0.28, 14, 16)
BLADE = Kind(0.062, 0.02, 0.006, 0.6, 0.5, 10, 20)
LEAFLET = Kind(0.4, 0.08, 0.005, 0.8, 0.2, 10, 8)


def leaf(
    kind: Kind,
    base: Float[np.ndarray, "3"],
    forward: Float[np.ndarray, "3"],
    length: float,
    droop: float,
    thickness: float,
    roll: float = 0.0,
) -> MeshData:
    """One leaf that sets out along ``forward`` and bends away from its upper side.

    Args:
        base: where its stalk begins, world units.
        forward: unit direction in which it begins; not vertical.
        length: along its midrib, world units.
        droop: angle it bends by over its length, radians.
        thickness: of the blade, world units.
        roll: turns it about ``forward``, radians.
    """
    level = np.cross(UP, forward)
    level /= np.linalg.norm(level)
    above = np.cross(forward, level)
    across = math.cos(roll) * level + math.sin(roll) * above
    upper = np.cross(forward, across)
    steps = 7
    angle = -droop * ((np.arange(steps) + 0.5) / steps) ** 1.2
    step = np.cos(angle)[:, None] * forward + np.sin(angle)[:, None] * upper
    path = base + length / steps * np.concatenate([np.zeros((1, 3)), step.cumsum(axis=0)])

    def blade(along: np.ndarray) -> np.ndarray:
        return np.clip((along - kind.stalk) / (1.0 - kind.stalk), 0.0, 1.0)

    def half_width(along: np.ndarray) -> np.ndarray:
        outline = np.sin(np.pi * blade(along) ** kind.broadest) ** 0.8
        return np.hypot(kind.stalk_radius, kind.width * length / 2 * outline)

    def half_thickness(along: np.ndarray) -> np.ndarray:
        thin = np.clip(3.0 * blade(along), 0.0, 1.0)
        return kind.stalk_radius + (thickness / 2 - kind.stalk_radius) * thin * thin * (3.0 - 2.0 * thin)

    def dish(x: np.ndarray) -> np.ndarray:
        return kind.fold * (np.sqrt(x * x + 0.02) - math.sqrt(0.02))

    return swept_mesh(
        path, half_width, half_thickness, kind.columns, kind.rows, 0.6, dish, 0.04, across=across
    )


def stem(path: Float[np.ndarray, "C 3"], radius: float, tip: float, rows: int = 24) -> MeshData:
    """A round stem along a plane curve, tapering from ``radius`` to ``tip`` (world units)."""
    ends = path[-1] - path[0]
    across = np.cross(UP, ends if np.hypot(ends[0], ends[2]) > 1e-6 else (1.0, 0.0, 0.0))

    def half(along: np.ndarray) -> np.ndarray:
        return radius + (tip - radius) * along

    return swept_mesh(path, half, half, 10, rows, cap=0.02, across=across)


def direction(azimuth: float, elevation: float) -> Float[np.ndarray, "3"]:
    """A unit vector; radians, azimuth 0 along +z and growing towards +x."""
    flat = math.cos(elevation)
    return np.array([flat * math.sin(azimuth), math.sin(elevation), flat * math.cos(azimuth)])


def broad_leaved(count: int, thickness: float) -> tuple[list[MeshData], list[MeshData]]:
    """Leaves and stems of a plant 1.6 units tall with large leaves about one bent stem; earth at y = 0."""
    rng = np.random.default_rng([SEED, 0])
    path = np.array([[0, -0.04, 0], [0.01, 0.3, 0], [0.05, 0.62, 0], [0.04, 0.95, 0], [0.0, 1.22, 0]])
    leaves = []
    for i in range(count):
        share = (i + 0.5) / count
        at, _ = spline(path, np.array(0.24 + 0.755 * share))
        length = (0.5 - 0.2 * share) * rng.uniform(0.88, 1.08)
        elevation = math.radians(12.0 + 62.0 * share**1.5 + rng.uniform(-7.0, 7.0))
        azimuth = i * GOLDEN_ANGLE + rng.uniform(-0.15, 0.15)
        droop = math.radians(rng.uniform(45.0, 70.0))
        roll = rng.uniform(-0.25, 0.25)
        leaves.append(leaf(BROAD_LEAF, at, direction(azimuth, elevation), length, droop, thickness, roll))
    return leaves, [stem(path, 0.024, 0.011)]


def tuft(count: int, thickness: float) -> tuple[list[MeshData], list[MeshData]]:
    """Long folded blades that arch out of one place; earth at y = 0. It has no stem."""
    rng = np.random.default_rng([SEED, 1])
    leaves = []
    for i in range(count):
        share = (i + 0.5) / count
        azimuth = i * GOLDEN_ANGLE + rng.uniform(-0.2, 0.2)
        elevation = math.radians(86.0 - 40.0 * share + rng.uniform(-5.0, 5.0))
        length = (0.95 - 0.3 * share) * rng.uniform(0.85, 1.1)
        droop = math.radians(35.0 + 65.0 * share + rng.uniform(-8.0, 8.0))
        base = 0.09 * math.sqrt(share) * direction(azimuth, 0.0) - np.array([0.0, 0.02, 0.0])
        roll = rng.uniform(-0.2, 0.2)
        leaves.append(leaf(BLADE, base, direction(azimuth, elevation), length, droop, thickness, roll))
    return leaves, []


def feathered(count: int, thickness: float) -> tuple[list[MeshData], list[MeshData]]:
    """Arching stems with leaflets on both sides; earth at y = 0."""
    rng = np.random.default_rng([SEED, 2])
    stems, paths = [], []
    for i in range(FRONDS):
        share = (i + 0.5) / FRONDS
        azimuth = i * GOLDEN_ANGLE + rng.uniform(-0.12, 0.12)
        out, tall = 0.2 + 0.4 * share, 0.86 - 0.36 * share + rng.uniform(-0.05, 0.05)
        flat = direction(azimuth, 0.0)
        profile = [(0.02, -0.04), (0.06, 0.3), (0.14, 0.62), (0.45, 0.92), (1.0, 1.0)]
        path = np.array([out * x * flat + tall * y * UP for x, y in profile])
        path[:2] += 0.05 * share * flat
        paths.append(path)
        stems.append(stem(path, 0.012, 0.005, rows=20))
    leaves = []
    for i in range(count):
        path, place = paths[i % FRONDS], (i // FRONDS // 2 + 0.5) / math.ceil(count / FRONDS / 2)
        at, tangent = spline(path, np.array(min(0.3 + 0.69 * place, 0.99)))
        tangent /= np.linalg.norm(tangent)
        level = np.cross(UP, tangent)
        level /= np.linalg.norm(level)
        out = SIDES[i // FRONDS % 2] * level
        forward = 0.8 * out + 0.6 * tangent + rng.uniform(-0.08, 0.08, 3)
        forward /= np.linalg.norm(forward)
        length = (0.22 - 0.08 * place) * rng.uniform(0.92, 1.08)
        leaves.append(leaf(LEAFLET, at, forward, length, math.radians(35.0), thickness))
    return leaves, stems


def pot(radius: float, height: float) -> tuple[MeshData, MeshData]:
    """A thick-walled pot that stands on y = 0, and the earth in it, at 0.86 of its height.

    Args:
        radius, height: of the rim, world units.
    """
    outside = [(0, 0), (0.5, 0), (0.66, 0), (0.68, 0.02), (0.72, 0.2), (0.84, 0.7), (0.86, 0.8), (0.96, 0.81)]
    rim = [(1.0, 0.83), (1.0, 0.98), (0.97, 1.0), (0.88, 1.0), (0.85, 0.98), (0.84, 0.9)]
    inside = [(0.8, 0.75), (0.72, 0.5), (0.3, 0.48), (0, 0.48)]
    earth = [
        (0, 0.7),
        (0.6, 0.7),
        (0.8, 0.72),
        (0.845, 0.8),
        (0.84, 0.84),
        (0.6, 0.86),
        (0.25, 0.87),
        (0, 0.87),
    ]
    return (
        lathe_mesh(outside + rim + inside, radius, height, columns=64, rows=44),
        lathe_mesh(earth, radius, height, columns=48, rows=18),
    )


def potted(
    plant: tuple[list[MeshData], list[MeshData]], radius: float, height: float, at: tuple[float, float]
) -> dict[str, MeshData]:
    """``leaves``, ``stems`` (where it has any), ``pot`` and ``earth`` of a plant at ``at`` (x, z)."""
    leaves, stems = plant
    vessel, earth = pot(radius, height)
    above = (at[0], 0.86 * height, at[1])
    found = {"pot": vessel.moved(to=(at[0], 0, at[1])), "earth": earth.moved(to=(at[0], 0, at[1]))}
    found["leaves"] = joined(leaves).moved(to=above)
    if stems:
        found["stems"] = joined(stems).moved(to=above)
    return found

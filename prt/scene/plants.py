"""Three potted plants with many thin leaves: shadows with much detail, and both sides of what casts them."""

from typing import Any, Literal

from prt.errors import PrtError
from prt.scene.foliage import BROAD, TUFT, broad_leaved, feathered, potted, tuft
from prt.scene.scene import Scene, Trajectory
from prt.scene.shapes import MeshData, diffuse, lathe_mesh, to_mesh, twosided, unit_setting


class Plants(Scene):
    """A broad-leaved plant, a tuft of blades and a feathered plant on a round base of radius 1.32 at y = 0.

    Stands in for the PLANTS of Dhawal 2022. Every leaf is a closed solid with two sides. The placing of the
    leaves does not depend on their thickness.

    Args:
        leaves: on all three together, from 12 to 2000.
        leaf_thickness: world units, in [0.001, 0.03].
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range.
    """

    geometry_version = 1
    FEWEST, MOST = 12, 2000
    THINNEST, THICKEST = 0.001, 0.03

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "plants",
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
        leaves: int = 300,
        leaf_thickness: float = 0.007,
    ):
        super().__init__(name, cameras, max_depth, record)
        whole = isinstance(leaves, int) and not isinstance(leaves, bool)
        if not whole or not self.FEWEST <= leaves <= self.MOST:
            raise PrtError(
                f"scene.leaves={leaves!r} must be an integer between {self.FEWEST} and {self.MOST}"
            )
        self.leaves = leaves
        self.leaf_thickness = unit_setting("leaf_thickness", leaf_thickness, self.THINNEST, self.THICKEST)

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "plants",
            "geometry_version": self.geometry_version,
            "leaves": self.leaves,
            "leaf_thickness": self.leaf_thickness,
        }

    def meshes(self) -> dict[str, tuple[MeshData, tuple[float, float, float]]]:
        """Geometry, world units, and reflectance of each part by name."""
        broad, blades = round(BROAD * self.leaves), round(TUFT * self.leaves)
        feathers = self.leaves - broad - blades
        thick, earth, wood = self.leaf_thickness, (0.13, 0.085, 0.06), (0.3, 0.2, 0.11)
        plants = {
            "broad": (
                potted(broad_leaved(broad, thick), 0.36, 0.44, (-0.56, -0.44)),
                {"pot": (0.68, 0.34, 0.2), "leaves": (0.13, 0.3, 0.1), "stems": wood},
            ),
            "tuft": (
                potted(tuft(blades, thick), 0.31, 0.4, (0.7, -0.24)),
                {"pot": (0.62, 0.64, 0.66), "leaves": (0.36, 0.5, 0.16)},
            ),
            "feathered": (
                potted(feathered(feathers, thick), 0.3, 0.34, (-0.1, 0.68)),
                {"pot": (0.2, 0.36, 0.5), "leaves": (0.2, 0.42, 0.17), "stems": (0.3, 0.34, 0.14)},
            ),
        }
        found = {"base": (_base(), (0.66, 0.6, 0.52))}
        for name, (parts, colors) in plants.items():
            found |= {f"{name}_{part}": (mesh, colors.get(part, earth)) for part, mesh in parts.items()}
        return found

    def description(self) -> dict[str, Any]:
        return {
            name: to_mesh(name, mesh, twosided(diffuse(color)))
            for name, (mesh, color) in self.meshes().items()
        }


def _base() -> MeshData:
    """A round slab with rounded edges, its top at y = 0."""
    profile = [(0, 0), (0.7, 0), (0.96, 0), (0.99, 0.1), (1, 0.5), (0.99, 0.9), (0.96, 1), (0.7, 1), (0, 1)]
    return lathe_mesh(profile, 1.32, 0.08, columns=96, rows=32).moved(to=(0.0, -0.08, 0.0))

"""The closed Cornell box: everything inside is seen from inside, and lit from inside."""

from typing import Any, Literal

import numpy as np
from scipy.spatial import Delaunay

from prt.scene.panels import block, panel
from prt.scene.scene import Scene, Trajectory
from prt.scene.shapes import MeshData, diffuse, to_mesh, twosided, unit_setting

#: the walls: x from -1 to 1, y from 0 to 2, z from the back to the front; sums of these round nowhere
HALF, HEIGHT, BACK, FRONT = 1.0, 2.0, -1.0, 1.75
#: centre (x, z) on the floor, side, height and turn in degrees of the two boxes, from the measured box of
#: Cornell's Program of Computer Graphics scaled to a width of 2
SHORT = ((0.33, 0.39), 0.6, 0.6, -17.0)
TALL = ((-0.33, -0.26), 0.6, 1.2, 17.0)


class CornellBox(Scene):
    """The Cornell box with its front wall in place: white, red on the left, green on the right.

    The room is deeper than wide, for what the camera sees through the open front of the classic box is seen
    here from before the front wall.

    Walls and boxes are one closed surface. The boxes have no base and the floor has none below them, so that
    no texel of a lightmap lies where no one can see it and none is half under a box.

    Args:
        white: albedo of floor, ceiling, back and front wall and boxes, in [0, 0.95].
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range.
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "cornell_box",
        max_depth: int = 12,
        record: Literal["bsdf", "nee"] = "bsdf",
        white: float = 0.72,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.white = unit_setting("white", white, 0.0, 0.95)

    def fingerprint(self) -> dict[str, Any]:
        return {"scene": "cornell_box", "geometry_version": self.geometry_version, "white": self.white}

    def description(self) -> dict[str, Any]:
        return painted(meshes(), self.white)


def painted(shapes: dict[str, MeshData], white: float) -> dict[str, Any]:
    """Meshes of a Cornell box with its colours: red on the left, green on the right, all else white."""
    # the measured white is a little warm
    other = tuple(white * part for part in (1.0, 0.98, 0.94))
    colors = {"left": (0.63, 0.065, 0.05), "right": (0.14, 0.45, 0.091)}
    return {
        name: to_mesh(name, mesh, twosided(diffuse(colors.get(name, other)))) for name, mesh in shapes.items()
    }


def meshes() -> dict[str, MeshData]:
    """Walls facing inwards and boxes facing outwards, by name."""
    return {"floor": _floor(), **walls(), "short_box": _box(*SHORT), "tall_box": _box(*TALL)}


def walls() -> dict[str, MeshData]:
    """Ceiling and walls, facing inwards, by name."""
    wide, tall, deep = 2 * HALF, HEIGHT, FRONT - BACK
    return {
        "ceiling": panel((-HALF, tall, BACK), (wide, 0, 0), (0, 0, deep)),
        "back": panel((-HALF, 0, BACK), (wide, 0, 0), (0, tall, 0)),
        "front": panel((HALF, 0, FRONT), (-wide, 0, 0), (0, tall, 0)),
        "left": panel((-HALF, 0, FRONT), (0, 0, -deep), (0, tall, 0)),
        "right": panel((HALF, 0, BACK), (0, 0, deep), (0, tall, 0)),
    }


def _box(at: tuple[float, float], side: float, height: float, turn: float) -> MeshData:
    unit = block((-side / 2, 0, -side / 2), (side / 2, height, side / 2), without=("bottom",))
    return unit.moved(turn=turn, to=(at[0], 0.0, at[1]))


def _floor() -> MeshData:
    """The floor without the bases of the boxes: triangles between the corners of all three."""
    walls = np.array([(-HALF, BACK), (HALF, BACK), (HALF, FRONT), (-HALF, FRONT)])
    corners = [walls]
    for box in (SHORT, TALL):
        low = _box(*box).position
        low = low[low[:, 1] == 0.0][:, [0, 2]]
        # each corner twice, from two sides, in the very numbers that the sides have
        corners.append(np.unique(low, axis=0))
    place = np.concatenate(corners)
    face = Delaunay(place).simplices
    middle = place[face].mean(axis=1)
    face = face[~(_within(middle, *SHORT) | _within(middle, *TALL))]
    position = np.stack([place[:, 0], np.zeros(len(place)), place[:, 1]], axis=1)
    a, b, c = (position[face[:, k]] for k in range(3))
    down = np.cross(b - a, c - a)[:, 1] < 0
    face[down] = face[down][:, ::-1]
    return MeshData(
        position=position,
        normal=np.tile([0.0, 1.0, 0.0], (len(place), 1)),
        uv=(place - walls[0]) / (walls[2] - walls[0]),
        face=face.astype(np.int64),
    )


def _within(
    point: np.ndarray, at: tuple[float, float], side: float, height: float, turn: float
) -> np.ndarray:
    """Whether points (N, 2) of the floor lie below the box."""
    cosine, sine = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    x, z = (point - at).T
    return np.maximum(np.abs(cosine * x - sine * z), np.abs(sine * x + cosine * z)) < side / 2

"""The Cornell box of Su 2024, figure 2: a box that turns, a ball that rolls along, and a lamp that moves."""

import math
from typing import Any, Literal

from prt.errors import PrtError
from prt.scene.animation import Animation
from prt.scene.animation_file import read_animation
from prt.scene.cornell_box import BACK, FRONT, HALF, HEIGHT, painted, walls
from prt.scene.panels import block, panel
from prt.scene.scene import Scene, Trajectory
from prt.scene.shapes import MeshData, diffuse, sphere_mesh, to_mesh, twosided, unit_setting

#: the box stands at (x, z); it is no square, so that a right angle about its own axis is no symmetry
BOX_AT, BOX_SIDES, BOX_HEIGHT = (-0.38, -0.42), (0.62, 0.36), 1.15
BALL_RADIUS, BALL_START, BALL_END = 0.3, (-0.6, 0.3, 0.45), (0.62, 0.3, 0.25)
LAMP_SIZE, LAMP_REACH, LAMP_BELOW = 0.5, 0.7, 0.02
#: what the ball is made of
BALLS: dict[str, dict[str, Any]] = {
    "diffuse": twosided(diffuse((0.7, 0.65, 0.5))),
    "glossy": {"type": "twosided", "bsdf": {"type": "roughconductor", "material": "Al", "alpha": 0.25}},
    "mirror": {"type": "twosided", "bsdf": {"type": "conductor", "material": "Al"}},
    "glass": {"type": "dielectric", "int_ior": 1.5},
}  # fmt: skip


class CornellAnimated(Scene):
    """A closed Cornell box under a lamp of its own, of one to three variables: box, ball, lamp.

    The room is deeper than wide and has its front wall, so that views from inside see a closed room.

    Args:
        variables: how many move, from 0 to 3: the box's turn, the ball's place, the lamp's place along x.
            What stands still does so half way.
        ball: what the ball is made of: diffuse, glossy, mirror or glass.
        albedo: of walls and box, in [0, 0.99].
        meeting: the ball's way leads into the box instead of past it: where two things touch, light between
            them comes and goes within a cell of any grid.
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range.
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "cornell_animated",
        max_depth: int = 12,
        record: Literal["bsdf", "nee"] = "bsdf",
        variables: int = 2,
        ball: str = "diffuse",
        albedo: float = 0.72,
        meeting: bool = False,
    ):
        super().__init__(name, cameras, max_depth, record)
        if ball not in BALLS:
            raise PrtError(f"scene.ball={ball!r} is not one of {', '.join(BALLS)}")
        self.ball, self.albedo = ball, unit_setting("albedo", albedo, 0.0, 0.99)
        self.animation = animation(bool(meeting)).subset(variables, 0.5)

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "cornell_animated", "geometry_version": self.geometry_version, "ball": self.ball,
            "albedo": self.albedo,
        }  # fmt: skip

    def description(self) -> dict[str, Any]:
        ball = sphere_mesh(BALL_RADIUS, 48, 24).moved(to=BALL_START)
        return {**painted(meshes(), self.albedo), "ball": to_mesh("ball", ball, BALLS[self.ball])}

    def lights(self) -> dict[str, Any]:
        """The lamp, a square just below the ceiling that shines down; it stands at the start of its way."""
        from prt.scene.mitsuba_setup import mitsuba

        mi = mitsuba()
        place = mi.ScalarTransform4f().translate([-LAMP_REACH / 2, HEIGHT - LAMP_BELOW, 0.2])
        face_down = mi.ScalarTransform4f().rotate([1, 0, 0], 90).scale(LAMP_SIZE / 2)
        radiance = {"type": "rgb", "value": [17.0, 14.0, 9.5]}
        dark = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}
        return {
            "lamp": {
                "type": "rectangle", "to_world": place @ face_down, "bsdf": dark,
                "emitter": {"type": "area", "radiance": radiance},
            }
        }  # fmt: skip


def animation(meeting: bool = False) -> Animation:
    """All three variables; ``meeting``: the ball ends in the middle of the box."""
    end = (BOX_AT[0], BALL_END[1], BOX_AT[1]) if meeting else BALL_END
    travel = [b - a for a, b in zip(BALL_START, end, strict=True)]
    centre = [BOX_AT[0], 0.0, BOX_AT[1]]
    return read_animation({
        "variables": [
            {"name": "box", "rotate": {
                "shapes": ["box"], "axis": [0, 1, 0], "centre": centre, "start": 0.0, "end": 90.0}},
            {"name": "ball", "translate": {"shapes": ["ball"], "start": [0, 0, 0], "end": travel}},
            {"name": "lamp", "translate": {
                "shapes": ["lamp"], "start": [0, 0, 0], "end": [LAMP_REACH, 0, 0]}},
        ]
    })  # fmt: skip


def meshes() -> dict[str, MeshData]:
    """Walls that face inwards and the box, by name."""
    x, z = BOX_SIDES[0] / 2, BOX_SIDES[1] / 2
    box = block((-x, 0.0, -z), (x, BOX_HEIGHT, z))
    return {
        "floor": panel((-HALF, 0, FRONT), (2 * HALF, 0, 0), (0, 0, BACK - FRONT)),
        **walls(),
        "box": box.moved(to=(BOX_AT[0], 0.0, BOX_AT[1])),
    }


def gap() -> float:
    """The least distance between ball and box in all states: the box sweeps a circle about its axis."""
    swept = math.hypot(*BOX_SIDES) / 2
    nearest = math.inf
    for step in range(1001):
        x, z = (
            a + (b - a) * step / 1000 for a, b in ((BALL_START[0], BALL_END[0]), (BALL_START[2], BALL_END[2]))
        )
        nearest = min(nearest, math.hypot(x - BOX_AT[0], z - BOX_AT[1]) - swept - BALL_RADIUS)
    return nearest

"""A table of objects that all move and change colour: many variables (Su 2024, figure 6 and table 1)."""

from typing import Any, Literal

from prt.scene.animation import Animation
from prt.scene.animation_file import read_animation
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.panels import block, panel
from prt.scene.scene import Scene, Trajectory
from prt.scene.shapes import MeshData, sphere_mesh, superquadric_mesh, to_mesh, twisted_column_mesh, twosided

#: cells of the table: centres along x and z, half a cell's side, and how far an object goes from its centre
COLUMNS, ROWS, HALF_CELL, REACH = (-1.8, -0.6, 0.6, 1.8), (-0.6, 0.6), 0.6, 0.2
WIDE, DEEP, HIGH = 2.6, 1.5, 2.2
#: start and end of the colour of each material
COLORS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "object0": ((0.75, 0.15, 0.10), (0.15, 0.25, 0.70)),
    "object1": ((0.20, 0.60, 0.25), (0.75, 0.65, 0.15)),
    "object2": ((0.70, 0.70, 0.70), (0.10, 0.10, 0.10)),
    "object3": ((0.15, 0.30, 0.70), (0.70, 0.30, 0.15)),
    "object4": ((0.75, 0.60, 0.20), (0.20, 0.60, 0.60)),
    "object5": ((0.50, 0.15, 0.50), (0.75, 0.75, 0.40)),
    "object6": ((0.10, 0.50, 0.50), (0.75, 0.30, 0.40)),
    "object7": ((0.60, 0.60, 0.20), (0.30, 0.20, 0.60)),
    "floor": ((0.60, 0.58, 0.55), (0.25, 0.27, 0.32)),
    "back": ((0.65, 0.62, 0.58), (0.60, 0.25, 0.20)),
    "side": ((0.55, 0.60, 0.65), (0.20, 0.45, 0.25)),
    "plinth0": ((0.70, 0.70, 0.70), (0.30, 0.30, 0.30)),
    "plinth1": ((0.60, 0.50, 0.40), (0.30, 0.20, 0.15)),
    "plinth2": ((0.40, 0.50, 0.60), (0.20, 0.25, 0.35)),
    "plinth3": ((0.50, 0.60, 0.45), (0.20, 0.30, 0.20)),
}
#: objects with a coat; the others are matt
GLOSSY = ("object0", "object2", "object4", "object6", "floor")


class Many(Scene):
    """Eight objects between two walls, each of which moves, and fifteen materials that change colour.

    Args:
        variables: how many of the 23 change, in the order object, material, object, material, ..., then what
            is left of the materials; what does not change stays half way.
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range.
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "many",
        max_depth: int = 12,
        record: Literal["bsdf", "nee"] = "bsdf",
        variables: int = 23,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.animation = animation().subset(variables, 0.5)

    def fingerprint(self) -> dict[str, Any]:
        return {"scene": "many", "geometry_version": self.geometry_version}

    def description(self) -> dict[str, Any]:
        return {name: to_mesh(name, mesh, material(name)) for name, mesh in meshes().items()}

    def lights(self) -> dict[str, Any]:
        """A lamp over the table, and a dim sky."""
        mi = mitsuba()
        place = mi.ScalarTransform4f().translate([0.4, 3.2, 1.2]).rotate([1, 0, 0], 110).scale(0.6)
        dark = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}
        return {
            "lamp": {
                "type": "rectangle", "to_world": place, "bsdf": dark,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [14.0, 12.0, 9.0]}},
            },
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.35, 0.42, 0.55]}},
        }  # fmt: skip


def material(name: str) -> dict[str, Any]:
    """The BSDF of a shape."""
    color = {"type": "rgb", "value": list(COLORS[name][0])}
    if name in GLOSSY:
        inner = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.15, "diffuse_reflectance": color}
    else:
        inner = {"type": "diffuse", "reflectance": color}
    return twosided(inner)


def centre(number: int) -> tuple[float, float]:
    """Where object ``number`` stands half way, (x, z)."""
    return COLUMNS[number % 4], ROWS[number // 4]


def animation() -> Animation:
    """All 23 variables: objects and materials in turn, then the other materials."""
    objects = []
    for number in range(8):
        shapes, (x, z) = [f"object{number}"], centre(number)
        if number % 2:
            turn = {"shapes": shapes, "axis": [0, 1, 0], "centre": [x, 0, z], "start": 0, "end": 120}
            objects.append({"name": f"turn{number}", "rotate": turn})
        else:
            # meshes stand at the start of their way
            way = [2 * REACH, 0, 0] if number % 4 else [0, 0, 2 * REACH]
            move = {"shapes": shapes, "start": [0, 0, 0], "end": way}
            objects.append({"name": f"move{number}", "translate": move})
    materials = []
    for name, (start, end) in COLORS.items():
        key = "diffuse_reflectance" if name in GLOSSY else "reflectance"
        value = {"parameter": f"{name}.{key}.value", "start": list(start), "end": list(end)}
        materials.append({"name": f"{name}_color", "value": value})
    pairs = zip(objects, materials, strict=False)  # the other materials follow
    order = [one for pair in pairs for one in pair] + materials[len(objects) :]
    return read_animation({"variables": order})


def meshes() -> dict[str, MeshData]:
    """All shapes where they are at the start, by name."""
    out = {
        "floor": panel((-WIDE, 0, DEEP), (2 * WIDE, 0, 0), (0, 0, -2 * DEEP)),
        "back": panel((-WIDE, 0, -DEEP), (2 * WIDE, 0, 0), (0, HIGH, 0)),
        "side": panel((-WIDE, 0, DEEP), (0, 0, -2 * DEEP), (0, HIGH, 0)),
    }
    for number in range(8):
        x, z = centre(number)
        raised = 0.0
        if number < 4:
            raised = 0.25 + 0.1 * number
            half = HALF_CELL - 0.02
            plinth = block((-half, 0.0, -half), (half, raised, half), without=("bottom",))
            out[f"plinth{number}"] = plinth.moved(to=(x, 0.0, z))
        along = 0.0 if number % 2 else REACH
        place = (x - (along if number % 4 else 0.0), raised, z - (0.0 if number % 4 else along))
        out[f"object{number}"] = _object(number).moved(to=place)
    return out


def _object(number: int) -> MeshData:
    """A shape that stands on the ground about the y axis."""
    if number in (0, 6):
        return sphere_mesh(0.33, 40, 20).moved(to=(0.0, 0.33, 0.0))
    if number in (2, 4):
        return superquadric_mesh(0.3, 0.3, 0.3, 40, 20).moved(to=(0.0, 0.3, 0.0))
    if number in (1, 7):
        return twisted_column_mesh(0.3, 0.9, lobes=4, depth=0.3, turns=0.3)
    return block((-0.3, 0.0, -0.12), (0.3, 0.75, 0.12))

"""A fish over stones and seaweed: rayed fins, gill covers and a round mouth; it swims to +x."""

import math
from collections.abc import Sequence
from typing import Any

from prt.scene.sdf import (
    Sdf,
    intersection,
    smooth_intersection,
    smooth_minimum,
    smooth_subtraction,
    smooth_union,
    union,
)
from prt.scene.sdf_ops import maximum
from prt.scene.sdf_primitives import box, capsule, cylinder, ellipsoid, half_space, round_cone, sphere, torus

#: height of the ground, and of the middle of the fish above it
GROUND, MIDDLE = -0.72, 0.72


def fish() -> Sdf:
    """Body, fins and eyes, carried by seaweed on a rounded slab."""
    swimmer = smooth_union(_body(), _tail(), k=0.08)
    swimmer = smooth_union(swimmer, _back_fin(), _belly_fin(), k=0.03)
    swimmer = smooth_union(swimmer, _side_fins(), k=0.03)
    swimmer = union(swimmer, _eyes()).turned("z", 6).moved(y=MIDDLE)
    slab = box(0.9, 0.04, 0.5, 0.035).moved(y=-0.04)
    # stones would show below the slab
    base = intersection(smooth_union(slab, _sea_floor(), k=0.05), half_space(y=-1, offset=0.08))
    return union(swimmer, base, _seaweed()).moved(y=GROUND)


def _body() -> Sdf:
    front = round_cone((0.32, 0.02, 0.0), (0.0, 0.02, 0.0), 0.25, 0.34)
    back = round_cone((0.0, 0.02, 0.0), (-0.55, 0.05, 0.0), 0.34, 0.085)
    body = smooth_union(front, back, k=0.1).stretched(z=0.68)
    lips = torus(0.085, 0.036).turned("z", 90).moved(0.57, -0.03)
    body = smooth_union(body, lips, k=0.06)
    throat = round_cone((0.68, -0.03, 0.0), (0.4, -0.03, 0.0), 0.08, 0.05)
    body = smooth_subtraction(body, throat, k=0.03)
    return _with_gill_cover(body)


def _with_gill_cover(body: Sdf) -> Sdf:
    """The head a little thicker than the body behind it, with a step at a curved edge."""
    head = ellipsoid(0.36, 0.42, 0.6).moved(0.47, 0.0)

    def formula(x: Any, y: Any, z: Any) -> Any:
        # not as a union of two bodies: the body would be evaluated twice
        distance = body(x, y, z)
        return smooth_minimum(distance, maximum(distance - 0.02, head(x, y, z)), 0.008)

    return Sdf(formula)


def _fan(rays: Sequence[tuple[float, float, float]], thick: float) -> Sdf:
    """A flat fin in the xy plane that spreads from the origin.

    Args:
        rays: end (x, y) and radius there of each; where two do not overlap, the fin is cleft.
        thick: half the thickness of the skin; the rays are thicker.
    """
    leaves = [round_cone((0, 0, 0), (x, y, 0), 0.04, radius) for x, y, radius in rays]
    skin = smooth_intersection(smooth_union(*leaves, k=0.06), _slab(thick), k=0.02)
    ribs = [capsule((0, 0, 0), (0.95 * x, 0.95 * y, 0), 1.2 * thick) for x, y, _ in rays]
    return smooth_union(skin, union(*ribs), k=0.015)


def _slab(thick: float) -> Sdf:
    """Everything within ``thick`` of the xy plane."""
    return half_space(z=1, offset=thick).mirrored("z")


def _tail() -> Sdf:
    half = _fan(((-0.3, 0.31, 0.07), (-0.3, 0.17, 0.08), (-0.24, 0.04, 0.07)), 0.016)
    return half.mirrored("y").moved(-0.58, 0.06)


def _back_fin() -> Sdf:
    """Two discs of skin, swept back, and the rays that hold them."""
    skin = smooth_union(
        cylinder(0.27, 0.1).turned("x", 90).moved(-0.02, 0.26),
        cylinder(0.17, 0.1).turned("x", 90).moved(-0.24, 0.22),
        k=0.08,
    )
    skin = smooth_intersection(skin, _slab(0.014), k=0.02)
    feet = (0.1, 0.03, -0.04, -0.11, -0.18)
    tips = ((0.15, 0.475), (0.03, 0.55), (-0.11, 0.53), (-0.235, 0.45), (-0.36, 0.36))
    rays = [capsule((foot, 0.25, 0), (*tip, 0), 0.019) for foot, tip in zip(feet, tips, strict=True)]
    return smooth_union(skin, union(*rays), k=0.02)


def _belly_fin() -> Sdf:
    return _fan(((-0.08, -0.2, 0.05), (-0.18, -0.16, 0.055)), 0.014).moved(-0.24, -0.14)


def _side_fins() -> Sdf:
    fan = _fan(((-0.25, 0.06, 0.055), (-0.27, -0.04, 0.06), (-0.22, -0.13, 0.055)), 0.013)
    return fan.turned("y", 38).moved(0.06, -0.08, 0.2).mirrored("z")


def _eyes() -> Sdf:
    ball = sphere(0.085)
    ball = smooth_subtraction(ball, sphere(0.04).moved(z=0.095), k=0.01)
    rim = torus(0.085, 0.018).turned("x", 90).moved(z=0.012)
    eye = union(ball, rim, sphere(0.02).moved(z=0.07))
    return eye.turned("y", 22).moved(0.42, 0.11, 0.135).mirrored("z")


def _sea_floor() -> Sdf:
    """Stones, and a rock that carries the fish."""
    stones = union(
        ellipsoid(0.16, 0.1, 0.13).turned("y", 30).moved(0.55, 0.02, 0.2),
        sphere(0.07).moved(0.36, 0.02, 0.3),
        ellipsoid(0.12, 0.08, 0.1).moved(-0.62, 0.02, 0.26),
    )
    rock = smooth_union(
        round_cone((-0.02, 0.0, 0.0), (0.04, 0.34, 0.0), 0.19, 0.09),
        sphere(0.13).moved(-0.2, 0.06, 0.1),
        sphere(0.11).moved(0.17, 0.06, 0.1),
        sphere(0.12).moved(0.06, 0.07, -0.17),
        k=0.07,
    )
    rock = smooth_subtraction(
        rock, sphere(0.08).moved(0.06, 0.2, 0.15), sphere(0.06).moved(-0.14, 0.25, 0.1), k=0.04
    )
    return smooth_union(stones, rock, k=0.05)


def _weed(x: float, z: float, tall: float, sway: float) -> Sdf:
    """A stalk that winds upwards from the ground, thinner towards its tip, four pieces long."""
    turns = [(i / 4, math.radians(80.0 * i + 40.0)) for i in range(5)]
    bends = [(x + sway * math.sin(a), tall * t, z + 0.4 * sway * math.cos(a)) for t, a in turns]
    radii = [0.045 - 0.031 * t for t, _ in turns]
    return union(*(round_cone(bends[i], bends[i + 1], radii[i], radii[i + 1]) for i in range(4)))


def _seaweed() -> Sdf:
    return union(
        _weed(-0.42, 0.26, 0.62, 0.06), _weed(0.32, -0.32, 0.8, 0.07), _weed(-0.68, -0.24, 0.5, 0.05)
    )

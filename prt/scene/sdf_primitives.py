"""Primitive distance fields, world units, each centred at the origin unless it is given by its ends.

Exact distances, except the ellipsoid's. The formulas are Quilez's ("distance functions"), but the round cone
is found as the sphere of the family along its axis that comes nearest, which takes no branch.
"""

import math
from collections.abc import Sequence
from typing import Any

from prt.errors import PrtError
from prt.scene.sdf import AXES, Sdf
from prt.scene.sdf_ops import absolute, clamp, length, maximum, minimum, weighted
from prt.scene.sdf_settings import finite, point, positive, rounding


def sphere(radius: float) -> Sdf:
    """A ball."""
    r = positive("sphere radius", radius)
    return Sdf(lambda x, y, z: length(x, y, z) - r)


def ellipsoid(x: float, y: float, z: float) -> Sdf:
    """An ellipsoid by its semi-axes: a lower bound, the unit ball's distance times the shortest semi-axis."""
    a, b, c = (positive(f"ellipsoid {axis}", part) for axis, part in zip(AXES, (x, y, z), strict=True))
    return sphere(1.0).stretched(a, b, c)


def box(x: float, y: float, z: float, radius: float = 0.0) -> Sdf:
    """A box by its half sides, with edges rounded by ``radius`` (it does not grow by that)."""
    half = [positive(f"box {axis}", part) for axis, part in zip(AXES, (x, y, z), strict=True)]
    r = rounding("box radius", radius, min(half))
    inner = [side - r for side in half]

    def formula(*place: Any) -> Any:
        return _corner([absolute(p) - side for p, side in zip(place, inner, strict=True)], r)

    return Sdf(formula)


def cylinder(radius: float, half: float, rounding_radius: float = 0.0) -> Sdf:
    """A cylinder along y by its radius and half its height, with edges rounded as those of :func:`box`."""
    wide, tall = positive("cylinder radius", radius), positive("cylinder half", half)
    r = rounding("cylinder rounding_radius", rounding_radius, min(wide, tall))
    return Sdf(lambda x, y, z: _corner([length(x, z) - (wide - r), absolute(y) - (tall - r)], r))


def torus(radius: float, tube: float) -> Sdf:
    """A ring about the y axis: ``radius`` of its middle line, ``tube`` of the tube."""
    wide, r = positive("torus radius", radius), positive("torus tube", tube)
    return Sdf(lambda x, y, z: length(length(x, z) - wide, y) - r)


def capsule(start: Sequence[float], end: Sequence[float], radius: float) -> Sdf:
    """All points closer than ``radius`` to the segment between two points."""
    return round_cone(start, end, radius, radius)


def round_cone(start: Sequence[float], end: Sequence[float], radius: float, end_radius: float) -> Sdf:
    """Balls of a radius that changes evenly from one end to the other, swept along a segment.

    Raises:
        PrtError: if one of the two balls at the ends lies in the other, or a setting is out of range.
    """
    a, b = point("round_cone start", start), point("round_cone end", end)
    first, last = positive("round_cone radius", radius), positive("round_cone end_radius", end_radius)
    long, grows = math.dist(a, b), last - first
    if long <= abs(grows):
        raise PrtError(
            f"distance field round_cone from {a} to {b}: {long:g} between its ends must be more than the "
            f"{abs(grows):g} between its radii; move an end, or take a sphere"
        )
    # unit direction
    along = tuple((q - p) / long for p, q in zip(a, b, strict=True))
    # how far, per unit away from the axis, the nearest ball lies towards the thicker end
    lean = grows / math.sqrt(long * long - grows * grows)

    def formula(*place: Any) -> Any:
        offset = tuple(p if middle == 0.0 else p - middle for p, middle in zip(place, a, strict=True))
        up = weighted(along, offset)
        across = [p if u == 0.0 else p - u * up for u, p in zip(along, offset, strict=True)]
        if grows == 0.0:
            return length(*across, up - clamp(up, 0.0, long)) - first
        out = length(*across)
        at = clamp(up + lean * out, 0.0, long)
        return length(out, up - at) - (first + (grows / long) * at)

    return Sdf(formula)


def half_space(x: float = 0.0, y: float = 0.0, z: float = 0.0, offset: float = 0.0) -> Sdf:
    """All points p with n . p <= ``offset``, where n is the unit vector along the given outward normal."""
    parts = [finite(f"half_space {axis}", part) for axis, part in zip(AXES, (x, y, z), strict=True)]
    size, shift = math.hypot(*parts), finite("half_space offset", offset)
    if size == 0.0:
        raise PrtError("distance field half_space normal=(0, 0, 0) must have a length; give e.g. y=1")
    normal = tuple(part / size for part in parts)
    return Sdf(lambda *place: weighted(normal, place) - shift)


def _corner(beyond: list[Any], radius: float) -> Any:
    """Distance to a convex corner from how far a point lies beyond each of its faces."""
    inside = beyond[0]
    for part in beyond[1:]:
        inside = maximum(inside, part)
    return length(*(maximum(part, 0.0) for part in beyond)) + minimum(inside, 0.0) - radius

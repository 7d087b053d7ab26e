"""Signed distance fields as expressions: one definition for torch, Dr.Jit, GLSL and plain numbers.

A field is negative inside, world units, and 1-Lipschitz: it changes by no more than one moves. Its magnitude
is then at most the distance to its zero set, and sphere tracing never steps through a surface. Whatever is
built here from 1-Lipschitz parts is 1-Lipschitz again. Primitives are in :mod:`prt.scene.sdf_primitives`.

The formulas are those that Inigo Quilez published ("distance functions" and "smooth minimum"), except where
a docstring says otherwise.
"""

import functools
import math
import re
from collections.abc import Callable
from typing import Any

from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.scene.sdf_glsl import GlslProgram
from prt.scene.sdf_ops import absolute, maximum, minimum, weighted
from prt.scene.sdf_settings import chosen, finite, positive

AXES = ("x", "y", "z")
#: sines and cosines below this are those of a right angle
RIGHT = 1e-12


class Sdf:
    """A signed distance field.

    Args:
        formula: from the coordinates x, y, z to the distance, all scalars of one kind, written with
            ``+ - * /`` and :mod:`prt.scene.sdf_ops` and without branches. A formula of one's own has to be
            1-Lipschitz, or sphere tracing oversteps.
    """

    def __init__(self, formula: Callable[[Any, Any, Any], Any]):
        self.formula = formula

    def __call__(self, x: Any, y: Any, z: Any) -> Any:
        """The distance at a place, of the kind of its coordinates.

        Args:
            x, y, z: torch tensors of one shape, Dr.Jit floats, :class:`~prt.scene.sdf_glsl.Glsl` or floats.
        """
        return self.formula(x, y, z)

    def distance(self, position: Float[Tensor, "N 3"]) -> Float[Tensor, "N"]:
        """Distances at N points, differentiable; the gradient is finite everywhere.

        Its length is up to 1. At centres and along axes and edges, where there is none, it is shorter.

        Raises:
            PrtError: for positions of another shape.
        """
        if position.ndim != 2 or position.shape[1] != 3:
            raise PrtError(f"positions of shape {tuple(position.shape)} must be (N, 3), one point per row")
        # each coordinate is read many times: side by side in memory
        x, y, z = position.T.contiguous().unbind()
        return self(x, y, z)

    def glsl(self, name: str = "sdf") -> str:
        """GLSL 3.30 source of ``float name(vec3 p)``, a temporary for each different operation.

        Raises:
            PrtError: for a name that GLSL does not allow, or a constant beyond float32.
        """
        if not re.fullmatch(r"(?!gl_|t\d+$|p$)[A-Za-z]\w*", name) or "__" in name:
            raise PrtError(f"glsl name={name!r} must be a letter, then letters, digits or _; use e.g. sdf")
        program = GlslProgram()
        found = self(*(program.assigned(f"p.{axis}") for axis in AXES))
        body = "".join(f"    {line}\n" for line in program.lines())
        return f"float {name}(vec3 p) {{\n{body}    return {found.name};\n}}\n"

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> "Sdf":
        """Moved by a vector, world units."""
        dx, dy, dz = (finite(f"moved {axis}", part) for axis, part in zip(AXES, (x, y, z), strict=True))
        return Sdf(lambda x, y, z: self(_less(x, dx), _less(y, dy), _less(z, dz)))

    def turned(self, axis: str, degrees: float) -> "Sdf":
        """Turned about a coordinate axis through the origin, counter-clockwise seen from its tip."""
        angle = math.radians(finite("turned degrees", degrees))
        i = AXES.index(chosen("turned axis", axis, AXES))
        c, s = (part if abs(part) > RIGHT else 0.0 for part in (math.cos(angle), math.sin(angle)))

        def formula(*place: Any) -> Any:
            # the place is turned back
            a, b = place[(i + 1) % 3], place[(i + 2) % 3]
            back = {
                i: place[i],
                (i + 1) % 3: weighted((c, s), (a, b)),
                (i + 2) % 3: weighted((-s, c), (a, b)),
            }
            return self(back[0], back[1], back[2])

        return Sdf(formula)

    def scaled(self, factor: float) -> "Sdf":
        """Scaled evenly about the origin."""
        s = positive("scaled factor", factor)
        return Sdf(lambda x, y, z: s * self(x * (1 / s), y * (1 / s), z * (1 / s)))

    def stretched(self, x: float = 1.0, y: float = 1.0, z: float = 1.0) -> "Sdf":
        """Scaled about the origin by a factor per axis: a lower bound, no longer the distance.

        The values shrink with the smallest factor, so that they stay 1-Lipschitz: the more uneven the
        factors, the shorter are the steps of sphere tracing.
        """
        a, b, c = (positive(f"stretched {axis}", part) for axis, part in zip(AXES, (x, y, z), strict=True))
        return Sdf(lambda x, y, z: min(a, b, c) * self(x * (1 / a), y * (1 / b), z * (1 / c)))

    def mirrored(self, axis: str) -> "Sdf":
        """What lies at positive coordinates of the axis, and its mirror image; the rest is lost."""
        i = AXES.index(chosen("mirrored axis", axis, AXES))
        return Sdf(lambda *place: self(*(absolute(p) if k == i else p for k, p in enumerate(place))))

    def rounded(self, radius: float) -> "Sdf":
        """Grown by ``radius``, world units, with round edges."""
        r = positive("rounded radius", radius)
        return Sdf(lambda x, y, z: self(x, y, z) - r)


def union(*parts: Sdf) -> Sdf:
    """What lies in any of the parts."""
    return _folded("union", minimum, parts)


def intersection(*parts: Sdf) -> Sdf:
    """What lies in all of the parts: inside it the distance, outside a lower bound."""
    return _folded("intersection", maximum, parts)


def subtraction(whole: Sdf, *parts: Sdf) -> Sdf:
    """``whole`` without the parts."""
    if not parts:
        raise PrtError("subtraction has 0 parts to take away; give at least one")
    return intersection(whole, *(_inside_out(part) for part in parts))


def smooth_union(*parts: Sdf, k: float) -> Sdf:
    """The union with a fillet where parts meet, by Quilez's polynomial (quadratic) smooth minimum.

    min(a, b) - max(k - |a - b|, 0)^2 / (4 k): its gradient is a mean of those of a and b. Three parts or
    more are joined one after the other, and their order matters a little where all are near.

    Args:
        k: the difference of distances, world units, up to which two parts blend.

    Raises:
        PrtError: if k is not above 0, or there is no part.
    """
    width = positive("smooth_union k", k)
    return _folded("smooth_union", lambda a, b: smooth_minimum(a, b, width), parts)


def smooth_subtraction(whole: Sdf, *parts: Sdf, k: float) -> Sdf:
    """``whole`` without the parts, edges rounded by Quilez's polynomial smooth maximum; k as above."""
    width = positive("smooth_subtraction k", k)
    if not parts:
        raise PrtError("smooth_subtraction has 0 parts to take away; give at least one")
    return smooth_intersection(whole, *(_inside_out(part) for part in parts), k=width)


def smooth_intersection(*parts: Sdf, k: float) -> Sdf:
    """The intersection with rounded edges; k as in :func:`smooth_union`."""
    width = positive("smooth_intersection k", k)
    return _folded("smooth_intersection", lambda a, b: -smooth_minimum(-a, -b, width), parts)


def smooth_minimum(a: Any, b: Any, k: float) -> Any:
    """Quilez's quadratic polynomial smooth minimum of two scalars of one kind."""
    near = maximum(k - absolute(a - b), 0.0)
    return minimum(a, b) - near * near * (0.25 / k)


def _folded(name: str, join: Callable[[Any, Any], Any], parts: tuple[Sdf, ...]) -> Sdf:
    if not parts:
        raise PrtError(f"{name} has 0 parts; give at least one")
    return Sdf(lambda x, y, z: functools.reduce(join, (part(x, y, z) for part in parts)))


def _inside_out(part: Sdf) -> Sdf:
    return Sdf(lambda x, y, z: -part(x, y, z))


def _less(coordinate: Any, by: float) -> Any:
    return coordinate if by == 0.0 else coordinate - by

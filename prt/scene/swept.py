"""Closed solids swept along a curve in a plane: handles, stems, spoons, thin leaves."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from prt.scene.shapes import MeshData, parametric

Profile = Callable[[np.ndarray], np.ndarray]


def swept_mesh(
    path: Sequence[Sequence[float]],
    half_width: float | Profile,
    half_thickness: float | Profile,
    columns: int = 16,
    rows: int = 24,
    bulge: float = 1.0,
    dish: Profile | None = None,
    cap: float = 0.05,
    across: Sequence[float] | None = None,
) -> MeshData:
    """A superelliptic section carried along a curve; both ends are rounded off, so the solid is closed.

    Args:
        path: control points (x, y, z) of a uniform cubic B-spline that lie in one plane, world units; the
            first and last are met exactly.
        half_width: of the section, at right angles to the plane of the path; world units, or a function of
            the place along the path in [0, 1].
        half_thickness: of the section within that plane, likewise.
        columns, rows: cells around the section and along the path; rows are closer at the ends.
        bulge: exponent of the section: 1 an ellipse, towards 0 a rectangle.
        dish: how far the section is bent up at its sides, as a share of its half width: a function of the
            place across in [-1, 1]; up is ``tangent x across``.
        cap: share of the path over which each end is rounded off.
        across: direction of the width, world; the normal of the plane of the path unless given (which a
            straight path needs).
    """
    control = np.asarray(path, dtype=np.float64)
    side = _plane_normal(control) if across is None else np.asarray(across, dtype=np.float64)
    side = side / np.linalg.norm(side)

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        # rows crowd together at the ends, where the section closes like a square root
        along = 0.5 - 0.5 * np.cos(np.pi * v)
        point, tangent = spline(control, along)
        up = np.cross(tangent, side)
        up /= np.linalg.norm(up, axis=-1, keepdims=True)
        end = np.clip(np.minimum(along, 1.0 - along) / cap, 0.0, 1.0)
        closing = np.sqrt(1.0 - (1.0 - end) ** 2)
        wide, thick = (closing * _values(part, along) for part in (half_width, half_thickness))
        cosine, sine = np.cos(2.0 * np.pi * u), np.sin(2.0 * np.pi * u)
        x = np.sign(cosine) * np.abs(cosine) ** bulge
        y = thick * np.sign(sine) * np.abs(sine) ** bulge
        if dish is not None:
            y = y + wide * dish(x)
        return point + (wide * x)[..., None] * side + y[..., None] * up

    return parametric(surface, columns, rows)


def spline(
    control: Float[np.ndarray, "C 3"], place: np.ndarray
) -> tuple[Float[np.ndarray, "... 3"], Float[np.ndarray, "... 3"]]:
    """Points and derivatives of a uniform cubic B-spline that meets its first and last control point.

    Args:
        control: at least two points.
        place: along the curve, in [0, 1].
    """
    ends = 2 * control[:1] - control[1:2], 2 * control[-1:] - control[-2:-1]
    points = np.concatenate([ends[0], control, ends[1]])
    spans = len(points) - 3
    first = np.clip(np.floor(place * spans).astype(int), 0, spans - 1)
    t = (place * spans - first)[..., None]
    s = 1 - t
    weights = s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3
    slopes = -3 * s**2, 9 * t**2 - 12 * t, 12 * s - 9 * s**2, 3 * t**2
    point, slope = (
        np.sum([weight * points[first + k] for k, weight in enumerate(part)], axis=0) / 6.0
        for part in (weights, slopes)
    )
    return point, slope * spans


def _values(part: float | Profile, along: np.ndarray) -> np.ndarray:
    return part(along) if callable(part) else np.full_like(along, part)


def _plane_normal(control: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "3"]:
    """Of the plane the points lie in, on the side that has the first turn of the curve counter-clockwise."""
    steps = np.diff(control, axis=0)
    turns = np.cross(steps[:-1], steps[1:])
    return turns[np.linalg.norm(turns, axis=1).argmax()]

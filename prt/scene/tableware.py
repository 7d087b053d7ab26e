"""Cups, saucers, a sugar bowl, spoons and a tray as closed solids, all standing on y = 0.

A change here changes scenes: raise their ``geometry_version``.
"""

import numpy as np
from jaxtyping import Float

from prt.scene.panels import joined
from prt.scene.shapes import MeshData, lathe_mesh
from prt.scene.swept import swept_mesh

#: across a sweep along +x whose upper side is +y
LEVEL = (0.0, 0.0, -1.0)


def cup(radius: float = 0.24, height: float = 0.24) -> MeshData:
    """A thin-walled cup on a foot ring, with a handle towards +x; two closed solids."""
    foot = [(0, 0.06), (0.4, 0.06), (0.44, 0.0), (0.54, 0.0), (0.56, 0.06)]
    outside = [(0.74, 0.14), (0.9, 0.38), (0.94, 0.7), (1.0, 0.96)]
    rim = [(1.0, 1.02), (0.97, 1.03), (0.94, 1.0)]
    inside = [(0.87, 0.7), (0.82, 0.4), (0.66, 0.21), (0.3, 0.15), (0, 0.15)]
    bowl = lathe_mesh(foot + outside + rim + inside, radius, height, columns=64, rows=48).on_ground()
    handle = _handle(bowl, high=0.84 * height, low=0.3 * height, reach=0.62 * radius, tube=0.065 * radius)
    return joined([bowl, handle])


def tea(radius: float = 0.24, height: float = 0.24) -> MeshData:
    """What is in a :func:`cup` of this size: a slab whose edge lies within the cup's wall."""
    profile = [
        (0, 0.5),
        (0.7, 0.5),
        (0.85, 0.52),
        (0.9, 0.62),
        (0.905, 0.7),
        (0.89, 0.73),
        (0.6, 0.73),
        (0, 0.73),
    ]
    return lathe_mesh(profile, radius, height, columns=64, rows=16)


def saucer(radius: float = 0.41) -> MeshData:
    """A saucer with a well for a cup's foot."""
    below = [(0, 0.15), (0.3, 0.15), (0.35, 0.0), (0.46, 0.0), (0.5, 0.16), (0.7, 0.38), (0.94, 0.86)]
    rim = [(1.0, 1.0), (1.0, 1.1), (0.95, 1.12)]
    above = [(0.72, 0.66), (0.54, 0.46), (0.47, 0.36), (0.3, 0.36), (0, 0.36)]
    return lathe_mesh(below + rim + above, radius, 0.16 * radius, columns=72, rows=32).on_ground()


def biscuit_plate(radius: float = 0.34) -> tuple[MeshData, MeshData]:
    """A flat plate, and the biscuits on it: three side by side, two on top of them."""
    below = [(0, 0), (0.4, 0), (0.62, 0), (0.7, 0.1), (0.9, 0.6), (0.96, 0.9)]
    rim = [(1.0, 1.0), (1.0, 1.2), (0.95, 1.22)]
    above = [(0.86, 0.9), (0.74, 0.5), (0.66, 0.4), (0.4, 0.4), (0, 0.4)]
    plate = lathe_mesh(below + rim + above, radius, 0.14 * radius, columns=72, rows=32).on_ground()
    top, thick, wide = 0.4 * 0.14 * radius, 0.042, 0.27 * radius
    outline = [(0, 0), (0.6, 0), (0.95, 0), (1.03, 0.3), (1.03, 0.7), (0.95, 1), (0.6, 1), (0, 0.94)]
    biscuit = lathe_mesh(outline, wide, thick, lobes=14, depth=0.06, columns=84, rows=14).on_ground()
    # three circles that just touch have their centres 2 / sqrt(3) radii from the middle
    out = 1.03 * 1.16 * wide
    places = [(0, out, 10.0), (0, out, 130.0), (0, out, 250.0), (1, 0.2 * out, 40.0), (2, 0.35 * out, 200.0)]
    pile = [
        biscuit.moved(to=(0.0, 0.0, away)).moved(turn=turn, to=(0.0, top + layer * thick, 0.0))
        for layer, away, turn in places
    ]
    return plate, joined(pile)


def sugar_bowl(radius: float = 0.25, height: float = 0.3) -> tuple[MeshData, MeshData]:
    """An open bellied bowl with two handles, towards +x and -x, and the sugar in it."""
    outside = [
        (0, 0.05),
        (0.45, 0.05),
        (0.5, 0),
        (0.6, 0),
        (0.62, 0.06),
        (0.9, 0.25),
        (1.04, 0.5),
        (0.98, 0.78),
    ]
    rim = [(0.88, 0.9), (0.9, 1.0), (0.87, 1.03), (0.82, 1.0), (0.81, 0.9)]
    inside = [(0.9, 0.76), (0.95, 0.5), (0.8, 0.27), (0.4, 0.16), (0, 0.16)]
    bowl = lathe_mesh(outside + rim + inside, radius, height, columns=64, rows=48).on_ground()
    handle = _handle(bowl, high=0.8 * height, low=0.36 * height, reach=0.5 * radius, tube=0.07 * radius)
    heap = [
        (0, 0.4),
        (0.6, 0.4),
        (0.92, 0.45),
        (0.97, 0.6),
        (0.95, 0.66),
        (0.6, 0.74),
        (0.3, 0.84),
        (0, 0.86),
    ]
    sugar = lathe_mesh(heap, radius, height, columns=64, rows=16)
    return joined([bowl, handle, handle.moved(turn=180.0)]), sugar


def spoon(length: float = 0.62) -> MeshData:
    """A teaspoon that lies along +x, its handle at the origin."""
    # evenly spaced, so that the place along the spline is the share of the length
    heights = (0.045, 0.068, 0.075, 0.074, 0.07, 0.055, 0.018, 0.006, 0.04)

    def half_width(along: np.ndarray) -> np.ndarray:
        handle = 0.016 + 0.018 * np.exp(-(((along - 0.06) / 0.12) ** 2))
        # the bowl: an ellipse about 0.82, blended into the handle by adding squares
        bowl = 0.095 * np.sqrt(np.clip(1.0 - ((along - 0.82) / 0.18) ** 2, 0.0, 1.0))
        return length * np.sqrt(handle**2 + bowl**2)

    def dish(x: np.ndarray) -> np.ndarray:
        return 0.38 * x * x

    points = length * np.array([(x / 8, y, 0.0) for x, y in enumerate(heights)])
    return swept_mesh(
        points, half_width, 0.009 * length, 14, 40, 0.8, dish, cap=0.02, across=LEVEL
    ).on_ground()


def tray(radius: float, thickness: float = 0.022) -> MeshData:
    """A round tray with a raised rim; what stands on it stands on y = 0."""
    below = [(0, 0), (0.6, 0), (0.9, 0), (0.945, 0.2), (0.972, 2.0)]
    rim = [(0.98, 4.4), (1.0, 4.9), (0.995, 5.5), (0.965, 5.3)]
    above = [(0.945, 2.6), (0.925, 1.0), (0.86, 1.0), (0.6, 1.0), (0, 1.0)]
    plate = lathe_mesh(below + rim + above, radius, thickness, columns=120, rows=48)
    return plate.moved(to=(0.0, -thickness, 0.0))


def top_at_axis(turned: MeshData) -> float:
    """Height of a turned solid's upper side at its axis, world units: where something on it stands."""
    return float(turned.position[np.isclose(turned.uv[:, 1], 1.0), 1].max())


def wall(turned: MeshData, height: float) -> tuple[float, float]:
    """Inner and outer radius of a turned, open vessel at ``height`` above y = 0, world units."""
    outline = turned.position[np.isclose(turned.uv[:, 0], 0.0)]
    outline = outline[np.argsort(turned.uv[np.isclose(turned.uv[:, 0], 0.0), 1])]
    top = int(outline[:, 1].argmax())
    radius = np.hypot(outline[:, 0], outline[:, 2])
    outer = np.interp(height, outline[: top + 1, 1], radius[: top + 1])
    inner = np.interp(height, outline[top:, 1][::-1], radius[top:][::-1])
    return float(inner), float(outer)


def _handle(vessel: MeshData, high: float, low: float, reach: float, tube: float) -> MeshData:
    """A round handle towards +x from ``high`` to ``low``; its ends lie in the middle of the vessel's wall."""
    ends = [(sum(wall(vessel, y)) / 2, y) for y in (high, low)]
    (first, _), (last, _) = ends
    out = max(first, last) + reach
    slope = 0.25 * (high - low)
    path: Float[np.ndarray, "C 3"] = np.array([
        (first, high, 0.0),
        (first + 0.5 * reach, high + 0.3 * slope, 0.0),
        (out + 0.1 * reach, high + 0.1 * slope, 0.0),
        (out + 0.1 * reach, (high + low) / 2, 0.0),
        (out - 0.3 * reach, low + 0.2 * slope, 0.0),
        (last + 0.35 * reach, low - 0.2 * slope, 0.0),
        (last, low, 0.0),
    ])  # fmt: skip
    return swept_mesh(path, 1.25 * tube, tube, 14, 32, cap=0.02, across=LEVEL)

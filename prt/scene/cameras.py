"""Camera trajectories: paths around a scene, from places in [0, 1) to views.

The kinds are those of Raghavan 2023, section 5: spherical sweep and helix to train on, circular sweep, helix
and figure eight to test on. Angles are in degrees. Azimuth 0 looks at the scene from +z, azimuth 90 from +x;
elevation is the angle above the horizon (the world is y-up). Where the azimuth spans a whole turn the camera
goes round and round; where it spans less (a room seen from its open front) it goes back and forth, so that
the path never jumps.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from prt.errors import PrtError
from prt.scene.scene import Trajectory
from prt.scene.view import View

Point = tuple[float, float, float]
#: elevations beyond this put the camera too close to the pole, where "up" is undefined
STEEPEST = 85.0


def spherical_sweep(
    center: Sequence[float],
    radius: float | Sequence[float],
    elevation: Sequence[float] = (10.0, 60.0),
    azimuth: Sequence[float] = (0.0, 360.0),
    turns: float = 6.0,
    target: Sequence[float] | None = None,
    fov: float = 45.0,
) -> Trajectory:
    """A spiral on a sphere: the azimuth sweeps ``turns`` times while the elevation rises from first to last.

    Args:
        center: of the sphere, world units.
        radius: world units, or (first, last) to change it on the way.
        elevation: first and last, degrees.
        azimuth: range, degrees; 360 or more goes round, less goes there and back ``turns`` times.
        target: what the camera looks at; the centre unless given.
        fov: horizontal field of view, degrees.

    Raises:
        PrtError: if a setting is out of range.
    """
    middle = _point("center", center)
    radii, low_high = _radius(radius), _elevation(elevation)
    angle = _sweep(_span("azimuth", azimuth), _positive("turns", turns))

    def origin(place: float) -> Point:
        return _on_sphere(middle, _mix(radii, place), angle(place), _mix(low_high, place))

    return _trajectory(origin, _point("target", center if target is None else target), fov)


def helix(
    center: Sequence[float],
    radius: float | Sequence[float],
    height: Sequence[float],
    azimuth: Sequence[float] = (0.0, 360.0),
    turns: float = 3.0,
    target: Sequence[float] | None = None,
    fov: float = 45.0,
) -> Trajectory:
    """A helix about the vertical axis through ``center``, from ``height[0]`` to ``height[1]`` above it.

    Args:
        center: a point of the axis, world units; heights are counted from it.
        radius: distance from the axis, world units, or (first, last).
        height: first and last, world units.
        azimuth, turns, target, fov: as in :func:`spherical_sweep`.

    Raises:
        PrtError: if a setting is out of range.
    """
    middle = _point("center", center)
    radii, heights = _radius(radius), _span("height", height)
    angle = _sweep(_span("azimuth", azimuth), _positive("turns", turns))

    def origin(place: float) -> Point:
        x, _, z = _on_sphere(middle, _mix(radii, place), angle(place), 0.0)
        return x, middle[1] + _mix(heights, place), z

    return _trajectory(origin, _point("target", center if target is None else target), fov)


def circular_sweep(
    center: Sequence[float],
    radius: float,
    elevation: float = 30.0,
    azimuth: Sequence[float] = (0.0, 360.0),
    target: Sequence[float] | None = None,
    fov: float = 45.0,
) -> Trajectory:
    """A circle, or an arc of one run through once, at a constant elevation; arguments as above.

    Raises:
        PrtError: if a setting is out of range.
    """
    middle, distance = _point("center", center), _positive("radius", radius)
    steep, angles = _elevation((elevation, elevation))[0], _span("azimuth", azimuth)

    def origin(place: float) -> Point:
        return _on_sphere(middle, distance, _mix(angles, place), steep)

    return _trajectory(origin, _point("target", center if target is None else target), fov)


def figure_eight(
    center: Sequence[float],
    radius: float,
    elevation: Sequence[float] = (20.0, 45.0),
    azimuth: Sequence[float] = (-120.0, 120.0),
    target: Sequence[float] | None = None,
    fov: float = 45.0,
) -> Trajectory:
    """A closed eight lying on a sphere: while the azimuth swings once, the elevation swings twice.

    Args:
        elevation, azimuth: the ranges that the eight fills, degrees; the azimuth less than a whole turn.

    Raises:
        PrtError: if a setting is out of range.
    """
    middle, distance = _point("center", center), _positive("radius", radius)
    low_high, angles = _elevation(elevation), _span("azimuth", azimuth)
    if abs(angles[1] - angles[0]) >= 360.0:
        raise PrtError(
            f"camera azimuth={list(angles)}: a figure eight spans less than 360 degrees; narrow the range"
        )

    def origin(place: float) -> Point:
        phase = 2.0 * math.pi * place
        swing, bob = 0.5 + 0.5 * math.sin(phase), 0.5 + 0.5 * math.sin(2.0 * phase)
        return _on_sphere(middle, distance, _mix(angles, swing), _mix(low_high, bob))

    return _trajectory(origin, _point("target", center if target is None else target), fov)


def _trajectory(origin: Callable[[float], Point], target: Point, fov: float) -> Trajectory:
    """Views along ``origin``, all looking at ``target`` with +y up."""
    angle = _number("fov", fov)
    if not 1.0 <= angle <= 150.0:
        raise PrtError(f"camera fov={fov!r} must lie between 1 and 150 degrees")

    def views(places: Sequence[float]) -> list[View]:
        found = []
        for place in places:
            eye = origin(place)
            sideways = math.hypot(eye[0] - target[0], eye[2] - target[2])
            if sideways < 1e-3 * math.dist(eye, target) or eye == target:
                raise PrtError(
                    f"camera at {eye} looks straight along its up direction at {target}; "
                    "move target or center, or lower the elevation"
                )
            found.append(View(origin=eye, target=target, fov=angle))
        return found

    return views


def _sweep(angles: tuple[float, float], turns: float) -> Callable[[float], float]:
    """Azimuth by place: round and round over a whole turn or more, there and back over less."""
    if abs(angles[1] - angles[0]) >= 360.0:
        return lambda place: angles[0] + 360.0 * math.copysign(turns, angles[1] - angles[0]) * place
    return lambda place: _mix(angles, 1.0 - abs(2.0 * ((turns * place) % 1.0) - 1.0))


def _on_sphere(center: Point, radius: float, azimuth: float, elevation: float) -> Point:
    around, above = math.radians(azimuth), math.radians(elevation)
    flat = radius * math.cos(above)
    return (
        center[0] + flat * math.sin(around),
        center[1] + radius * math.sin(above),
        center[2] + flat * math.cos(around),
    )


def _mix(ends: tuple[float, float], t: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * t


def _number(name: str, value: Any) -> float:
    """``value`` as a finite float, or an error that names the setting."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number) or isinstance(value, bool):
        raise PrtError(f"camera {name}={value!r} is not a finite number")
    return number


def _positive(name: str, value: Any) -> float:
    number = _number(name, value)
    if number <= 0.0:
        raise PrtError(f"camera {name}={value!r} must be above 0")
    return number


def _numbers(name: str, value: Any, count: int) -> tuple[float, ...]:
    if isinstance(value, (str, bytes)) or not isinstance(value, Sequence) or len(value) != count:
        raise PrtError(f"camera {name}={value!r} must be a list of {count} numbers")
    return tuple(_number(name, part) for part in value)


def _point(name: str, value: Any) -> Point:
    x, y, z = _numbers(name, value, 3)
    return x, y, z


def _span(name: str, value: Any) -> tuple[float, float]:
    first, last = _numbers(name, value, 2)
    return first, last


def _radius(value: Any) -> tuple[float, float]:
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        first, last = _span("radius", value)
        return _positive("radius", first), _positive("radius", last)
    distance = _positive("radius", value)
    return distance, distance


def _elevation(value: Any) -> tuple[float, float]:
    low, high = _span("elevation", value)
    if max(abs(low), abs(high)) > STEEPEST:
        raise PrtError(
            f"camera elevation={[low, high]} must lie within -{STEEPEST:g} and {STEEPEST:g} degrees"
        )
    return low, high

"""Camera trajectories for a scene without any: around its own sensor, or around its bounding box."""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from prt.scene.cameras import circular_sweep, figure_eight, helix, spherical_sweep
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Trajectory
from prt.scene.view import View

#: widest field of view kept from a file; wider images are mostly distortion
WIDEST = 90.0


@dataclasses.dataclass(frozen=True)
class SensorPose:
    """A sensor's place and axes (right, up, forward; unit, world space) and horizontal fov in degrees."""

    origin: np.ndarray
    right: np.ndarray
    up: np.ndarray
    forward: np.ndarray
    fov: float

    @staticmethod
    def from_matrix(to_world, fov: float) -> "SensorPose":
        """From Mitsuba's camera-to-world matrix (+x left, +y up, +z forward)."""
        matrix = np.array(to_world, dtype=np.float64)
        left, up, forward = (matrix[:3, i] / np.linalg.norm(matrix[:3, i]) for i in range(3))
        return SensorPose(matrix[:3, 3], -left, up, forward, min(fov, WIDEST))


def cameras_around_sensor(mi_scene, pose: SensorPose) -> dict[str, list[Trajectory]]:
    """Small movements about the sensor that keep looking at what it looks at.

    Trains on a spiral about the sensor and a helix that also moves forward; tests on a circle wider than the
    spiral and a figure eight, further forward. The radius is a quarter of the distance to the target, or less
    where surfaces are near, so that the camera stays in the open.
    """
    distance = _free(mi_scene, pose.origin, pose.forward, fallback=_to_centre(mi_scene, pose))
    target = pose.origin + distance * pose.forward
    sideways = (pose.right, -pose.right, pose.up, -pose.up)
    at = (pose.origin, pose.origin + 0.3 * distance * pose.forward)
    clearance = min(_free(mi_scene, place, axis, fallback=math.inf) for place in at for axis in sideways)
    radius = min(0.25 * distance, 0.7 * clearance)

    def trajectory(offset: Callable[[float], tuple[float, float, float]]) -> Trajectory:
        def views(places: Sequence[float]) -> list[View]:
            axes = np.stack([pose.right, pose.up, pose.forward])
            origins = [pose.origin + np.asarray(offset(place)) @ axes for place in places]
            target_up = tuple(map(float, target)), tuple(map(float, pose.up))
            return [View(tuple(map(float, origin)), *target_up, pose.fov) for origin in origins]

        return views

    def turning(turns: float, radius_at: Callable[[float], float], forward_at: Callable[[float], float]):
        def offset(t: float) -> tuple[float, float, float]:
            angle = 2 * math.pi * turns * t
            return radius_at(t) * math.cos(angle), radius_at(t) * math.sin(angle), forward_at(t)

        return trajectory(offset)

    def eight(t: float) -> tuple[float, float, float]:
        phase = 2 * math.pi * t
        return 0.9 * radius * math.sin(phase), 0.5 * radius * math.sin(2 * phase), 0.15 * distance

    return {
        "train": [
            turning(4, lambda t: (0.1 + 0.75 * t) * radius, lambda t: 0.0),
            turning(3, lambda t: 0.7 * radius, lambda t: 0.3 * distance * t),
        ],
        "far": [turning(1, lambda t: radius, lambda t: 0.05 * distance), trajectory(eight)],
    }


def cameras_around_bounds(
    low: Sequence[float], high: Sequence[float], fov: float = 45.0
) -> dict[str, list[Trajectory]]:
    """Trajectories on a sphere about the bounding box that keep all of it in the picture."""
    corners = np.array([low, high], dtype=float)
    center = tuple(map(float, corners.mean(axis=0)))
    half = max(float(np.linalg.norm(corners[1] - corners[0])) / 2, 1e-6)
    radius = half / math.sin(math.radians(fov) / 2)
    common = {"center": center, "fov": fov}
    return {
        "train": [
            spherical_sweep(radius=radius, elevation=(10.0, 60.0), **common),
            helix(radius=0.9 * radius, height=(0.1 * radius, 0.6 * radius), **common),
        ],
        "far": [
            circular_sweep(radius=radius, elevation=25.0, **common),
            figure_eight(radius=0.95 * radius, elevation=(15.0, 45.0), **common),
        ],
    }


def _free(mi_scene, origin: np.ndarray, direction: np.ndarray, fallback: float) -> float:
    """Distance to the first surface, or ``fallback`` where there is none."""
    mi = mitsuba()
    ray = mi.Ray3f(mi.Point3f(*map(float, origin)), mi.Vector3f(*map(float, direction)))
    hit = mi_scene.ray_intersect_preliminary(ray)
    distance = float(np.array(hit.t).reshape(-1)[0])
    return distance if math.isfinite(distance) else fallback


def _to_centre(mi_scene, pose: SensorPose) -> float:
    """How far ahead the middle of the scene lies (at least a tenth of its size)."""
    box = mi_scene.bbox()
    low, high = np.array(box.min), np.array(box.max)
    ahead = float(((low + high) / 2 - pose.origin) @ pose.forward)
    return max(ahead, 0.1 * float(np.linalg.norm(high - low)))

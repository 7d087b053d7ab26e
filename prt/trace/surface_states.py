"""Points spread by area over the shapes of a scene that moves, on the sides that anyone can see."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from prt.errors import PrtError
from prt.scene.capture import camera_rays
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace.radiance_rays import make_sampler

#: bounces of the walks that find out which sides of shapes are seen
WALK = 4
#: a side with less than this share of a shape's hits counts as never seen
LEAST_SIDE = 0.02
#: away from the surface, as a share of the scene's size, where a point is found by a ray
OFFSET = 1e-4


class SurfaceStates:
    """Uniform points of all surfaces in whatever state the scene is.

    Areas are those of the state in which this was made: moving and turning change none, and a shape that is
    scaled keeps its share of the points.

    Args:
        mi_scene: a live scene; later changes of its shapes are followed.
        views: where walks start that find which sides of shapes are seen. Without them, points lie on
            both sides.

    Raises:
        PrtError: for a scene without surface.
    """

    def __init__(self, mi_scene: Any, views: Sequence[View] = ()):
        self.mi_scene = mi_scene
        self.shapes = mi_scene.shapes_dr()
        shapes = mi_scene.shapes()
        areas, shape_of, prim_of = [], [], []
        for number, shape in enumerate(shapes):
            area = triangle_areas(shape)
            if area is not None:
                areas.append(area)
                shape_of.append(np.full(len(area), number))
                prim_of.append(np.arange(len(area)))
            elif (whole := _area_of(shape)) > 0:
                areas.append(np.array([whole]))
                shape_of.append(np.array([number]))
                prim_of.append(np.array([-1]))
        total = np.concatenate(areas) if areas else np.zeros(0)
        if not total.sum() > 0:
            raise PrtError("the scene has no surface to sample; task=animate needs shapes with an area")
        self.cumulative = np.cumsum(total) / total.sum()
        self.shape_of = np.concatenate(shape_of).astype(np.uint32)
        self.prim_of = np.concatenate(prim_of)
        box = mi_scene.bbox()
        self.step = OFFSET * math.dist(list(box.min), list(box.max))
        self.front = self._fronts(views) if views else np.full(len(shapes), 0.5)

    def _fronts(self, views: Sequence[View]) -> np.ndarray:
        """For each shape, the share of the hits of walks from the views that are on its front."""
        import drjit as dr

        mi = mitsuba()
        counts = np.zeros((2, len(self.shapes)))
        numbers = dr.reinterpret_array(mi.UInt32, self.shapes)
        order = {int(n): i for i, n in enumerate(np.array(numbers))}
        for k, view in enumerate(views):
            ray, many = camera_rays(view), view.width * view.height
            sampler, active = make_sampler(k, many), dr.full(mi.Bool, True, many)
            for _ in range(WALK):
                si = self.mi_scene.ray_intersect(ray, active)
                active &= si.is_valid()
                front = dr.dot(si.n, ray.d) < 0
                n = dr.select(front, si.n, -si.n)
                d = mi.Frame3f(n).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
                shape = dr.select(active, dr.reinterpret_array(mi.UInt32, si.shape), 0)
                ray = si.spawn_ray(d)
                dr.eval(shape, front, ray, active)
                for side, flag in enumerate((np.array(front), ~np.array(front))):
                    for value, count in zip(
                        *np.unique(np.array(shape)[flag], return_counts=True), strict=True
                    ):
                        if int(value) in order:
                            counts[side, order[int(value)]] += count
        share = (counts[0] + 0.5) / (counts.sum(0) + 1)
        share[share < LEAST_SIDE] = 0.0
        share[share > 1 - LEAST_SIDE] = 1.0
        return share

    def sample(self, count: int, seed: int):
        """``count`` interactions; ``wi`` is uniform over the hemisphere of the side that was chosen.

        Returns:
            ``mi.SurfaceInteraction3f`` in the scene's present state, and their number: points on shapes that
            are no meshes and lie hidden under others are left out.
        """
        import drjit as dr

        mi = mitsuba()
        rng = np.random.default_rng(seed)
        # stratified in the order of the shapes: small ones get their share in every step
        place = np.searchsorted(self.cumulative, (np.arange(count) + rng.random(count)) / count)
        place = np.minimum(place, len(self.cumulative) - 1)
        shape, prim = self.shape_of[place], self.prim_of[place]
        u = rng.random((2, count), dtype=np.float32)
        flip = u.sum(0) > 1
        u[:, flip] = 1 - u[:, flip]
        pi = dr.zeros(mi.PreliminaryIntersection3f, count)
        pi.t, pi.valid = dr.full(mi.Float, self.step, count), dr.full(mi.Bool, True, count)
        pi.prim_uv = mi.Point2f(u)
        pi.prim_index = mi.UInt32(np.maximum(prim, 0).astype(np.uint32))
        index = mi.UInt32(shape)
        pi.shape = dr.gather(type(self.shapes), self.shapes, index)
        pi.shape_index = index
        sampler = make_sampler(seed, count)
        ray = dr.zeros(mi.Ray3f, count)
        # meshes: from the corners of the triangle, as they are now
        si = pi.compute_surface_interaction(ray, mi.RayFlags.All, mi.Bool(prim >= 0))
        if (prim < 0).any():
            si = self._found(si, shape, prim < 0, seed)
        front = mi.Bool(rng.random(count) < self.front[shape])
        n = dr.select(dr.dot(si.sh_frame.n, si.n) < 0, -si.sh_frame.n, si.sh_frame.n)
        n = dr.select(front, n, -n)
        wo = mi.Frame3f(n).to_world(mi.warp.square_to_uniform_hemisphere(sampler.next_2d()))
        si.wi = si.to_local(wo)
        bsdf = si.bsdf()
        use = si.is_valid() & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        dr.eval(si, use)
        keep = np.flatnonzero(np.array(use)).astype(np.uint32)
        if len(keep) < count:
            si = dr.gather(mi.SurfaceInteraction3f, si, mi.UInt32(keep))
        return si, len(keep)

    def _found(self, si, shape: np.ndarray, wanted: np.ndarray, seed: int):
        """Points of spheres, rectangles and the like, found by a short ray onto a sampled place.

        Shape by shape: one call for all would go to every shape that the process holds, and some have none.
        """
        import drjit as dr

        mi = mitsuba()
        place, normal = np.zeros((2, len(shape), 3), dtype=np.float32)
        shapes = self.mi_scene.shapes()
        for number in np.unique(shape[wanted]):
            own = np.flatnonzero(wanted & (shape == number))
            random = make_sampler(seed + 1 + int(number), len(own)).next_2d()
            ps = shapes[int(number)].sample_position(0.0, random)
            place[own], normal[own] = np.array(ps.p).T, np.array(ps.n).T
        p, n = mi.Point3f(place.T.copy()), mi.Normal3f(normal.T.copy())
        active = mi.Bool(wanted)
        other = self.mi_scene.ray_intersect(mi.Ray3f(p + self.step * n, -n), active)
        meant = dr.gather(type(self.shapes), self.shapes, mi.UInt32(shape.astype(np.uint32)))
        close = other.is_valid() & (dr.abs(other.t - self.step) < 0.1 * self.step) & (other.shape == meant)
        other.t = dr.select(close, other.t, dr.inf)
        return dr.select(active, other, si)


def triangle_areas(shape) -> np.ndarray | None:
    """World area of each triangle; None of a shape that has no triangles of its own (a rectangle has not)."""
    params = mitsuba().traverse(shape)
    if "vertex_positions" not in params:
        return None
    vertex = np.array(params["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    face = np.array(params["faces"]).reshape(-1, 3)
    a, b, c = (vertex[face[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def _area_of(shape) -> float:
    try:
        return float(np.array(shape.surface_area()).reshape(-1)[0])
    except Exception:  # curves and volumes have none that can be sampled
        return 0.0

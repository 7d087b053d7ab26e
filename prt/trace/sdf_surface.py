"""A surface given by its signed distance: no triangles, no texture coordinates."""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.scene.area_sampling import by_area, triangle_areas
from prt.scene.atlas import interpolate
from prt.scene.capture import NEAR, camera_frame, facing, pixel_directions
from prt.scene.gbuffer import GBuffer
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace import sphere_tracing
from prt.trace.sphere_tracing import EPSILON, NEARLY, STEPS
from prt.trace.surface import SurfacePoints

#: samples lie on the surface to this share of the epsilon that rays arrive at, after so many steps at most
TOLERANCE, PROJECTIONS = 0.25, 20
#: rounds in which samples that did not come to lie on the surface are drawn again
ROUNDS = 8
#: grid points that the distance is evaluated at together
CHUNK = 1 << 16


class SdfSurface:
    """The zero set of a scene's signed distance within its box, which must hold all of it.

    Args:
        scene: with ``distance`` (a bound of the distance: its gradient no longer than 1), ``sdf`` (None, or
            the same on scalars of Dr.Jit), ``bounds``, ``albedo`` and ``fingerprint``, such as ``SdfScene``.
        cells: of the grid that samples start from, along the longest side of the box. What is thinner than
            a cell may get no samples.
        steps: of a ray; those that need more are counted as ``exhausted_rays``.

    Attributes:
        scene, cells, steps: as given.
        epsilon: distance at which a ray has arrived, world units: ``EPSILON`` times the extent, a tenth of
            the offset at which rays of :func:`prt.trace.transfer.bake` start.

    Raises:
        PrtError: for settings out of range.
    """

    def __init__(self, scene: Any, cells: int = 128, steps: int = STEPS):
        for name, value, least, most in (("cells", cells, 8, 1024), ("steps", steps, 1, 1 << 16)):
            if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
                raise PrtError(
                    f"{name}={value!r} of an SDF surface must be an integer from {least} to {most}"
                )
        self.scene, self.cells, self.steps = scene, cells, steps
        low, high = scene.bounds
        self._bounds = tuple(map(float, low)), tuple(map(float, high))
        if not all(math.isfinite(b - a) and b > a for a, b in zip(*self._bounds, strict=True)):
            raise PrtError(
                f"scene.bounds={self._bounds} is no box: each of the first three numbers must be below its "
                "counterpart"
            )
        self.epsilon = EPSILON * self.extent
        self._counts = {"exhausted_rays": 0, "dropped_samples": 0}
        self._exhausted: Any = None

    @property
    def bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Corners of the box around it, world units."""
        return self._bounds

    @property
    def extent(self) -> float:
        """Half the diagonal of that box."""
        return math.dist(*self._bounds) / 2

    @property
    def counts(self) -> dict[str, int]:
        """``exhausted_rays``: of all rays so far, those that met the step limit; a guess was returned for
        them. ``dropped_samples``: those that were drawn again as they did not come to lie on the surface.

        Waits for kernels under way that use :attr:`blocked`.
        """
        if self._exhausted is not None:
            self._counts["exhausted_rays"] += int(np.array(self._exhausted)[0])
            self._exhausted = None
        return dict(self._counts)

    def fingerprint(self) -> dict[str, Any]:
        """The scene, and all settings that change points or rays."""
        return {
            "surface": "sdf",
            "scene": self.scene.fingerprint(),
            "cells": self.cells,
            "steps": self.steps,
            "epsilon": EPSILON,
            "start": "half its value",  # see sphere_tracing.start_threshold
        }

    # --- samples -----------------------------------------------------------------------------------

    @functools.cached_property
    def mesh(self) -> tuple[Float[Tensor, "V 3"], Int[Tensor, "F 3"]]:
        """Triangles near the surface (marching cubes, Lewiner et al. 2003): vertices, faces; world units.

        Raises:
            PrtError: for a distance that is not finite in the box, or has no zero there.
        """
        from skimage.measure import marching_cubes

        low, high = (torch.tensor(v, dtype=torch.float64) for v in self._bounds)
        size = float((high - low).max()) / self.cells
        many = ((high - low) / size).ceil().long().clamp(min=1)
        axes = [torch.linspace(float(a), float(b), int(n) + 1, dtype=torch.float64)
                for a, b, n in zip(low, high, many, strict=True)]  # fmt: skip
        grid = torch.cartesian_prod(*axes).float()
        with torch.no_grad():
            values = torch.cat([self.scene.distance(part) for part in grid.split(CHUNK)])
        if not values.isfinite().all():
            where = grid[int((~values.isfinite()).nonzero()[0, 0])].tolist()
            raise PrtError(
                f"the signed distance is not finite at {where}; scene.function must return numbers"
            )
        if not float(values.min()) < 0.0 < float(values.max()):
            raise PrtError(
                f"scene.bounds={self._bounds} holds no surface: the signed distance goes from "
                f"{float(values.min()):.3g} to {float(values.max()):.3g} on {self.cells} cells; move the "
                "box, or raise cells for thin things"
            )
        volume = values.view([len(axis) for axis in axes]).numpy()
        spacing = [float(axis[1] - axis[0]) for axis in axes]
        vertex, face, *_ = marching_cubes(volume, 0.0, spacing=tuple(spacing))
        return low.float() + torch.from_numpy(vertex.copy()).float(), torch.from_numpy(face.copy()).long()

    def sample(self, count: int, seed: int) -> SurfacePoints:
        """Points spread evenly by area, with the gradient's direction as normal.

        One uniform point (Turk 1990) in each of ``count`` equal areas of :attr:`mesh`, moved along the
        gradient onto the zero set (Dhawal 2022, section 4.2). One that does not arrive there, or moves
        further than a cell, is dropped and another drawn.

        Raises:
            PrtError: as :attr:`mesh`; where the distance is not good enough to find the surface by.
        """
        vertex, face = self.mesh
        corners = vertex[face]
        area = triangle_areas(corners)
        generator = torch.Generator().manual_seed(seed)
        position = torch.zeros((count, 3))
        wanted = torch.arange(count)
        for round_number in range(ROUNDS):
            random = torch.rand((len(wanted), 3), generator=generator, dtype=torch.float64)
            # those that stand in for dropped ones come from anywhere: their own place is no good
            triangle, weights = by_area(area, random, wanted if round_number == 0 else None)
            found, good = self._projected(interpolate(corners[triangle], weights.float()))
            position[wanted[good]] = found[good]
            wanted = wanted[~good]
            self._counts["dropped_samples"] += len(wanted)
            if len(wanted) == 0:
                return SurfacePoints(position, sphere_tracing.normals(self.scene.distance, position))
        raise PrtError(
            f"{len(wanted)} of {count} samples found no place on the surface in {ROUNDS} rounds; raise cells "
            f"({self.cells}), or mend the signed distance (continuous, gradient about 1)"
        )

    def _projected(self, start: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Bool[Tensor, "N"]]:
        """Points on the zero set by Newton steps along the gradient, and which of them are."""
        low, high = (torch.tensor(v) for v in self._bounds)
        cell = float((high - low).max()) / self.cells
        position, good = start.clone(), torch.zeros(len(start), dtype=torch.bool)
        index = torch.arange(len(start))
        for number in range(PROJECTIONS + 1):
            distance, slope = sphere_tracing.gradients(self.scene.distance, position[index])
            # in lengths, not in values: a bound may grow slower than the distance
            there = distance.abs() < TOLERANCE * self.epsilon * slope.norm(dim=1).clamp(min=0.01, max=1.0)
            good[index[there]] = True
            index, distance, slope = index[~there], distance[~there], slope[~there]
            if len(index) == 0 or number == PROJECTIONS:
                break
            # a gradient that is nearly 0 says nothing about how far to go
            step = distance[:, None] * slope / slope.square().sum(1, keepdim=True).clamp(min=1e-4)
            position[index] -= step.nan_to_num(0.0)
        near = (position - start).norm(dim=1) < cell
        within = ((position >= low) & (position <= high)).all(1)
        return position, good & near & within

    # --- rays --------------------------------------------------------------------------------------

    def occluded(self, origin: Float[Tensor, "N 3"], direction: Float[Tensor, "N 3"]) -> Bool[Tensor, "N"]:
        """Whether anything of the surface lies in that unit direction; origins lie off it already."""
        hit, exhausted = sphere_tracing.occluded(
            self.scene.distance, self._bounds, origin, direction, self.epsilon, self.steps
        )
        self._counts["exhausted_rays"] += int(exhausted.sum())
        return hit

    @property
    def blocked(self) -> Callable[[Any, Any], Any] | None:
        """:meth:`occluded` of ``mi.Point3f`` and ``mi.Vector3f``, a ``mi.Bool``; None without ``scene.sdf``.

        A symbolic loop, which may stand within another one.
        """
        return None if self.scene.sdf is None else self._blocked

    def _blocked(self, origin: Any, direction: Any) -> Any:
        mi = mitsuba()  # ahead of drjit, which would load an LLVM of its own choice
        import drjit as dr

        if self._exhausted is None:
            self._exhausted = dr.opaque(mi.UInt32, 0, shape=1)
        near, far = _interval(self._bounds, origin, direction)
        sdf, epsilon = self.scene.sdf, self.epsilon

        def at(t):
            return mi.Float(sdf(*(o + t * d for o, d in zip(origin, direction, strict=True))))

        # as sphere_tracing.start_threshold: the surface they leave is not what they meet
        first = at(near)
        enough = dr.select(first > 0, dr.minimum(0.5 * first, epsilon), epsilon)

        def step(t, value, left):
            value = at(t)
            return t + dr.maximum(value, 0.0), value, left - 1

        def under_way(t, value, left):
            return (value >= enough) & (t <= far) & (left > 0)

        # misses of the box get no step at all
        start = dr.select(near < far, dr.inf, -dr.inf)
        state = (mi.Float(near), mi.Float(start), mi.UInt32(self.steps) + dr.zeros(mi.UInt32, dr.width(near)))
        t, value, left = dr.while_loop(state, under_way, step, label="sphere tracing")
        entered = near < far
        exhausted = entered & (left == 0) & (value >= enough) & (t <= far)
        dr.scatter_add(self._exhausted, mi.UInt32(1), mi.UInt32(0), exhausted)
        return entered & ((value < enough) | (exhausted & (value < NEARLY * epsilon)))

    def capture(self, view: View) -> GBuffer:
        """What a camera sees; the colour is the scene's albedo, everywhere diffuse, and uv is 0.

        Raises:
            PrtError: for a degenerate camera.
        """
        direction = torch.from_numpy(pixel_directions(view))
        forward = torch.from_numpy(camera_frame(view)[2].astype(np.float32))
        origin = torch.tensor(view.origin, dtype=torch.float32).expand(len(direction), 3)
        enter, leave = sphere_tracing.box_interval(self._bounds, origin, direction)
        near = torch.maximum(enter, NEAR / (direction @ forward))
        found = sphere_tracing.sphere_trace(
            self.scene.distance, origin, direction, near, leave, self.epsilon, self.steps
        )
        self._counts["exhausted_rays"] += int(found.exhausted.sum())
        hit = found.hit
        position = origin[hit] + found.t[hit, None] * direction[hit]
        outward = sphere_tracing.normals(self.scene.distance, position)
        normal, wo, wr = facing(view, position, outward, outward)
        count = len(position)
        albedo = torch.as_tensor(self.scene.albedo, dtype=torch.float32)
        return GBuffer(
            position=position,
            normal=normal,
            wo=wo,
            wr=wr,
            diffuse=albedo.expand(count, 3).clone(),
            specular=torch.zeros((count, 3)),
            roughness=torch.ones((count, 1)),
            uv=torch.zeros((count, 2)),
            hit=hit,
            view=view,
        )


def _interval(bounds: sphere_tracing.Box, origin: Any, direction: Any) -> tuple[Any, Any]:
    """:func:`sphere_tracing.box_interval` of Dr.Jit's rays."""
    mi = mitsuba()  # ahead of drjit, which would load an LLVM of its own choice
    import drjit as dr

    inverse = dr.select(dr.abs(direction) < 1e-20, 1e20, dr.rcp(direction))
    a = (mi.Point3f(*bounds[0]) - origin) * inverse
    b = (mi.Point3f(*bounds[1]) - origin) * inverse
    return dr.maximum(dr.max(dr.minimum(a, b)), 0.0), dr.min(dr.maximum(a, b))

"""The cubemap as a Mitsuba emitter: exactly the piecewise-constant radiance of docs/architecture.md.

Texels are drawn in proportion to radiance times solid angle and places inside a texel uniformly in the
face's plane (u, v). A unit direction d of a face with major axis m covers du dv / dw = 1 / |d_m|^3, so the
density over solid angle is ``probability(texel) * (R / 2)^2 / |d_m|^3``. (Not the constant density per texel
in w: drawing uniformly in w inside a texel has no simple closed form.)
"""

import functools
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.cubemap import texel_solid_angles
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene

#: Random numbers come in steps of 2^-23; probabilities are whole multiples, so that the stated pdf is exact.
STEPS = 1 << 23


def direction_to_texel(d, resolution):
    """Flat texel index (``mi.UInt32``) and |major component| of unit directions ``d`` (``mi.Vector3f``).

    The same map as ``prt.light.cubemap.direction_to_texel``, for use inside kernels.
    """
    import drjit as dr

    mi = mitsuba()
    ax, ay, az = dr.abs(d.x), dr.abs(d.y), dr.abs(d.z)
    on_x, on_y = (ax >= ay) & (ax >= az), ay >= az
    major = dr.select(on_x, d.x, dr.select(on_y, d.y, d.z))
    size, negative = dr.abs(major), major < 0
    face = dr.select(on_x, mi.UInt32(0), dr.select(on_y, mi.UInt32(2), mi.UInt32(4))) + dr.select(
        negative, mi.UInt32(1), 0
    )
    u = dr.select(on_x, dr.select(negative, d.z, -d.z), dr.select(on_y | ~negative, d.x, -d.x))
    v = dr.select(~on_x & on_y, dr.select(negative, -d.z, d.z), -d.y)
    half = 0.5 * mi.Float(resolution)
    scale = dr.maximum(size, dr.smallest(mi.Float))
    last = mi.Int32(resolution) - 1
    column = dr.clip(mi.Int32(dr.floor((u / scale + 1) * half)), 0, last)
    row = dr.clip(mi.Int32(dr.floor((v / scale + 1) * half)), 0, last)
    return (face * resolution + mi.UInt32(row)) * resolution + mi.UInt32(column), size


def texel_to_direction(texel, place, resolution):
    """The unit direction at ``place`` in [0, 1)^2 (column, row) of a texel, and |major component|."""
    import drjit as dr

    mi = mitsuba()
    column = texel % resolution
    rest = texel // resolution
    row, face = rest % resolution, rest // resolution
    step = 2 * dr.rcp(mi.Float(resolution))
    u = dr.fma(mi.Float(column) + place.x, step, -1)
    v = dr.fma(mi.Float(row) + place.y, step, -1)
    negative = (face & 1) == 1
    on_x, on_y = face < 2, face < 4
    side = dr.select(negative, mi.Float(-1), 1)
    x = dr.select(on_x, side, dr.select(on_y | ~negative, u, -u))
    y = dr.select(~on_x & on_y, side, -v)
    z = dr.select(on_x, dr.select(negative, u, -u), dr.select(on_y, side * v, side))
    size = dr.rsqrt(1 + u * u + v * v)
    return mi.Vector3f(x, y, z) * size, size


class TexelSampler:
    """Draws directions from a density over the texels of a cubemap; its arrays live on Mitsuba's device.

    Args:
        weights: non-negative ``(6, R, R)``, need not add up to one. All zero: nothing is drawn, the pdf is 0.
    """

    def __init__(self, weights: Float[np.ndarray, "6 R R"]):
        self.resolution = weights.shape[1]
        self.update(weights)

    def update(self, weights: Float[np.ndarray, "6 R R"]) -> None:
        """Take other weights of the same resolution; kernels that use this sampler are kept."""
        import drjit as dr

        mi = mitsuba()
        flat = weights.astype(np.float64).ravel()
        total = flat.sum()
        # multiples of the random numbers' step: what is drawn and what pdf() says agree exactly
        steps = (
            np.rint(np.cumsum(flat) * (STEPS / total)).astype(np.int64)
            if total > 0
            else np.zeros(flat.size, np.int64)
        )
        probability = np.diff(steps, prepend=0) / STEPS
        # float32 holds i / 2^23 exactly for i <= 2^23
        self.cumulative = mi.Float((steps / STEPS).astype(np.float32))
        self.probability = mi.Float(probability.astype(np.float32))
        self.any = mi.Bool(bool(total > 0))
        dr.make_opaque(self.cumulative, self.probability, self.any)
        self.total = float(total)

    def sample(self, sample, active: Any = True):
        """From ``sample`` in [0, 1)^2: direction, solid-angle pdf (0 where nothing can be drawn), texel."""
        import drjit as dr

        mi = mitsuba()
        count = 6 * self.resolution**2
        active = mi.Bool(active) & self.any
        texel = dr.binary_search(
            0, count - 1, lambda i: dr.gather(mi.Float, self.cumulative, i, active) <= sample.x
        )
        texel = mi.UInt32(texel)
        probability = dr.gather(mi.Float, self.probability, texel, active)
        before = dr.gather(mi.Float, self.cumulative, texel, active) - probability
        # the random number is used twice: which texel, and where in it
        reused = (sample.x - before) / dr.maximum(probability, 1.0 / STEPS)
        # a hair inside the texel, so that direction_to_texel finds the same one despite rounding
        edge = 1e-6 * self.resolution
        place = dr.clip(mi.Point2f(reused, sample.y), edge, 1 - edge)
        d, size = texel_to_direction(texel, place, self.resolution)
        return d, dr.select(active, self._density(probability, size), 0), texel

    def pdf(self, d, active: Any = True):
        """Solid-angle density of :meth:`sample` at unit directions ``d``."""
        import drjit as dr

        mi = mitsuba()
        texel, size = direction_to_texel(d, self.resolution)
        return self._density(dr.gather(mi.Float, self.probability, texel, active), size)

    def _density(self, probability, size):
        return probability * (0.25 * self.resolution**2) / (size * size * size)


def radiance_weights(cubemap: Float[Tensor, "6 R R 3"]) -> Float[np.ndarray, "6 R R"]:
    """Mean of the colours times solid angle, per texel: what emitter sampling goes by."""
    angle = texel_solid_angles(cubemap.shape[1], torch.float64)
    return (cubemap.double().mean(dim=3) * angle).numpy()


def checked(cubemap: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "6 R R 3"]:
    """The cubemap as float32 on the CPU.

    Raises:
        PrtError: if it is no cubemap or holds NaN, infinite or negative radiance.
    """
    if (
        cubemap.ndim != 4
        or cubemap.shape[0] != 6
        or cubemap.shape[1] != cubemap.shape[2]
        or cubemap.shape[3] != 3
    ):
        raise PrtError(f"lighting of shape {tuple(cubemap.shape)} is no cubemap; it must be (6, R, R, 3)")
    cubemap = cubemap.detach().to("cpu", torch.float32).contiguous()
    bad = int((~torch.isfinite(cubemap) | (cubemap < 0)).sum())
    if bad:
        raise PrtError(
            f"lighting holds {bad} NaN, infinite or negative values; it must be finite and not negative: "
            "mend it with prt.light.sanitise"
        )
    return cubemap


@functools.cache
def emitter_class() -> type:
    """The ``mi.Emitter`` subclass, registered as plugin ``prt_cubemap`` on first use.

    Property ``resolution``; it is black until :meth:`set_radiance`. Give it the scene's size by
    :meth:`set_bounds` (Mitsuba does not hand ``set_scene`` on to Python).
    """
    mi = mitsuba()  # before drjit, which takes the LLVM it finds
    import drjit as dr

    class CubemapEmitter(mi.Emitter):
        def __init__(self, props):
            mi.Emitter.__init__(self, props)
            self.resolution = int(props.get("resolution", 1))
            self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying
            texels = 6 * self.resolution**2
            self.radiance = mi.Float(np.zeros(3 * texels, dtype=np.float32))
            dr.make_opaque(self.radiance)
            self.sampler = TexelSampler(np.zeros((6, self.resolution, self.resolution)))
            self.set_bounds((0.0, 0.0, 0.0), 1.0)

        def set_radiance(self, cubemap: Float[Tensor, "6 R R 3"]) -> None:
            if cubemap.shape[1] != self.resolution:
                raise PrtError(
                    f"lighting of resolution {cubemap.shape[1]} does not fit the emitter, loaded with "
                    f"{self.resolution}; use one resolution, or load the scene anew"
                )
            self.radiance = mi.Float(cubemap.numpy().ravel())
            dr.make_opaque(self.radiance)
            self.sampler.update(radiance_weights(cubemap))

        def set_bounds(self, centre, radius: float) -> None:
            self.centre, self.radius = mi.Point3f(*centre), mi.Float(radius)
            dr.make_opaque(self.centre, self.radius)

        def is_environment(self):
            return True

        def bbox(self):
            return mi.ScalarBoundingBox3f()

        def traverse(self, callback):
            pass

        def to_string(self):
            return f"CubemapEmitter[resolution={self.resolution}]"

        def _lookup(self, d, active):
            texel, _ = direction_to_texel(d, self.resolution)
            return dr.gather(mi.Color3f, self.radiance, texel, active)

        def eval(self, si, active=True):
            return self._lookup(-si.wi, active)

        def eval_direction(self, it, ds, active=True):
            return self._lookup(ds.d, active)

        def pdf_direction(self, it, ds, active=True):
            return self.sampler.pdf(ds.d, active)

        def sample_direction(self, it, sample, active=True):
            d, pdf, texel = self.sampler.sample(sample, active)
            ds = dr.zeros(mi.DirectionSample3f)
            # beyond the scene from everywhere, also from a reference point outside its bounds
            ds.dist = 2 * dr.maximum(self.radius, dr.norm(it.p - self.centre))
            ds.p = it.p + d * ds.dist
            ds.n = mi.Normal3f(-d)
            ds.d = d
            ds.time = it.time
            ds.pdf = pdf
            ds.delta = mi.Bool(False)
            ds.emitter = mi.EmitterPtr(self)
            value = dr.gather(mi.Color3f, self.radiance, texel, mi.Bool(active) & (pdf > 0))
            return ds, dr.select(pdf > 0, value / dr.maximum(pdf, 1e-30), 0)

        def sample_position(self, time, sample, active=True):
            return dr.zeros(mi.PositionSample3f), mi.Float(0)

    mi.register_emitter("prt_cubemap", CubemapEmitter)
    return CubemapEmitter


def scene_with_lighting(scene: Scene, cubemap: Float[Tensor, "6 R R 3"]):
    """The scene loaded into Mitsuba with this lighting as its only emitter (``mi.Scene``).

    Raises:
        PrtError: if the lighting is no cubemap of finite, non-negative radiance.
    """
    emitter_class()
    cubemap = checked(cubemap)
    mi_scene = scene.load({"type": "prt_cubemap", "resolution": cubemap.shape[1]})
    emitter = _emitter(mi_scene)
    box = mi_scene.bbox()
    if box.valid():
        sphere = box.bounding_sphere()
        emitter.set_bounds(list(sphere.center), float(sphere.radius) * 1.001)
    emitter.set_radiance(cubemap)
    return mi_scene


def set_lighting(mi_scene, cubemap: Float[Tensor, "6 R R 3"]) -> None:
    """Change the lighting of a scene from :func:`scene_with_lighting` in place: no reload, no new kernels.

    Raises:
        PrtError: if the resolution differs from the scene's, or the radiance is not finite and non-negative.
    """
    _emitter(mi_scene).set_radiance(checked(cubemap))


def _emitter(mi_scene):
    emitter = mi_scene.environment()
    if not isinstance(emitter, emitter_class()):
        raise PrtError("this scene was not loaded by prt.trace.cubemap_emitter.scene_with_lighting")
    return emitter

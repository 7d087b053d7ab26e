"""Point, spot and directional lights of a :class:`LightRig` as one Mitsuba emitter whose lights can change.

Mitsuba's own emitters are compiled into the kernel one by one; here a rig is an array, so that any number of
lights of any kind runs the kernel of the first one, and a bake of 128 configurations compiles once.
"""

import functools

import numpy as np

from prt.light.local import KINDS, LocalLight
from prt.scene.mitsuba_setup import mitsuba

SPOT, DIRECTIONAL = KINDS.index("spot"), KINDS.index("directional")
#: kind, colour, position, direction, cutoff, beam
COLUMNS = 12


@functools.cache
def rig_emitter_class() -> type:
    """The ``mi.Emitter`` subclass, registered as plugin ``prt_rig``; dark until :meth:`set_lights`."""
    mi = mitsuba()  # before drjit, which takes the LLVM it finds
    import drjit as dr

    class RigEmitter(mi.Emitter):
        def __init__(self, props):
            mi.Emitter.__init__(self, props)
            self.m_flags = mi.EmitterFlags.DeltaPosition | mi.EmitterFlags.SpatiallyVarying
            self.set_lights((), 1.0)

        def set_lights(self, lights: tuple[LocalLight, ...], radius: float) -> None:
            """Take these lights; ``radius`` is that of the asset: directional light starts beyond it."""
            rows = [
                [KINDS.index(light.kind), *light.color, *light.position, *light.direction,
                 np.radians(light.cutoff), np.radians(light.beam)]
                for light in lights
            ] or [[0.0] * COLUMNS]  # fmt: skip
            self.count = mi.UInt32(len(lights))
            self.data = mi.Float(np.asarray(rows, dtype=np.float32).ravel())
            self.reach = mi.Float(4 * radius)
            dr.make_opaque(self.count, self.data, self.reach)

        def _column(self, index, first, active, size=1):
            parts = [dr.gather(mi.Float, self.data, index * COLUMNS + first + k, active) for k in range(size)]
            return parts[0] if size == 1 else mi.Vector3f(*parts)

        def sample_direction(self, it, sample, active=True):
            active = mi.Bool(active) & (self.count > 0)
            # one light at random, all alike
            index = dr.minimum(mi.UInt32(sample.x * mi.Float(self.count)), dr.maximum(self.count, 1) - 1)
            kind = self._column(index, 0, active)
            color = mi.Color3f(*self._column(index, 1, active, 3))
            axis = self._column(index, 7, active, 3)
            away = mi.Vector3f(self._column(index, 4, active, 3) - it.p)
            away = dr.select(kind == DIRECTIONAL, -axis * self.reach, away)
            distance = dr.maximum(dr.norm(away), 1e-9)
            d = away * dr.rcp(distance)
            # the falloff of Mitsuba's spot: linear in the angle between beam and cutoff
            cosine = dr.clip(-dr.dot(d, axis), -1, 1)
            cutoff, beam = self._column(index, 10, active), self._column(index, 11, active)
            slope = dr.clip((cutoff - dr.acos(cosine)) / dr.maximum(cutoff - beam, 1e-9), 0, 1)
            spot = dr.select(cosine >= dr.cos(beam), 1, slope)
            strength = dr.select(kind == DIRECTIONAL, 1, dr.rcp(dr.square(distance)))
            strength *= dr.select(kind == SPOT, spot, 1)
            ds = dr.zeros(mi.DirectionSample3f)
            ds.p, ds.n, ds.d, ds.dist = it.p + away, mi.Normal3f(-d), d, distance
            ds.time = it.time
            ds.pdf = dr.select(active, mi.Float(1), 0)
            ds.delta = mi.Bool(True)
            ds.emitter = mi.EmitterPtr(self)
            return ds, dr.select(active, color * (strength * mi.Float(self.count)), 0)

        def pdf_direction(self, it, ds, active=True):
            return mi.Float(0)

        def eval_direction(self, it, ds, active=True):
            return mi.Color3f(0)

        def eval(self, si, active=True):
            return mi.Color3f(0)

        def sample_position(self, time, sample, active=True):
            return dr.zeros(mi.PositionSample3f), mi.Float(0)

        def bbox(self):
            return mi.ScalarBoundingBox3f()

        def traverse(self, callback):
            pass

        def to_string(self):
            return "RigEmitter[]"

    mi.register_emitter("prt_rig", RigEmitter)
    return RigEmitter

"""Rays for networks that hold the smoothly reflected radiance of a scene (Su 2024, sections 4.3 and 5).

A network is asked only where light is reflected by lobes of finite width. What is emitted is read from the
scene, and what lobes of no width reflect or let through (mirrors, glass, masks) is followed to the next
surfaces, so that an answer is: known light, and a sum of network values times their weights.
"""

import dataclasses

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.nn.radiance_network import RadiancePoints
from prt.scene.capture import rows_of
from prt.scene.mitsuba_setup import mitsuba

#: specular surfaces followed in a row; what is left of the light then is lost
CHAIN = 8
SAMPLING = ("bsdf", "uniform")


@dataclasses.dataclass
class Answers:
    """What P rays bring: ``known`` light, and points whose radiance, times their weight, is added to it."""

    known: Float[Tensor, "P 3"]
    points: RadiancePoints
    #: the same points as ``mi.SurfaceInteraction3f``, a part a surface on the way, where they were asked for
    interactions: list = dataclasses.field(default_factory=list)

    def to(self, device: str | torch.device) -> "Answers":
        return Answers(self.known.to(device), self.points.to(device), self.interactions)

    def total(self, values: Float[Tensor, "N 3"]) -> Float[Tensor, "P 3"]:
        """All light of each path, given the network's values at ``points``."""
        return self.known.index_add(0, self.points.path, self.points.weight * values)


def lobes(delta: bool):
    """A BSDF context of only the lobes of no width, or of only the others."""
    mi = mitsuba()
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.Delta if delta else mi.BSDFFlags.Smooth
    return context


def follow(mi_scene, ray, count: int, seed: int, weight=None, pdf=None, origin=None, keep=False) -> Answers:
    """Where rays arrive, and on along specular lobes.

    Args:
        ray: ``mi.Ray3f`` of ``count`` rays.
        seed: of the lobes that are taken at specular surfaces.
        weight: ``mi.Color3f``, what the rays count for; 1 by default.
        pdf, origin: density of the rays' directions and the interactions they leave, where emitters are
            sampled as well: emitted light that the ray meets first then counts by the balance of both (Veach
            1995, power heuristic).
        keep: return the interactions of the points as well.
    """
    import drjit as dr

    mi = mitsuba()
    throughput = dr.full(mi.Color3f, 1.0, count) if weight is None else mi.Color3f(weight)
    path = np.arange(count)
    known = torch.zeros((count, 3))
    found, kept = [], []
    smooth, delta = lobes(False).type_mask, lobes(True)
    for depth in range(CHAIN + 1):
        many = len(path)
        si = mi_scene.ray_intersect(ray)
        emitter = si.emitter(mi_scene)
        emission = throughput * emitter.eval(si)
        if depth == 0 and pdf is not None:
            seen = mi.DirectionSample3f(mi_scene, si, origin)
            other = mi_scene.pdf_emitter_direction(origin, seen, emitter != None)  # noqa: E711
            emission *= power(pdf, other)
        bsdf = si.bsdf(ray)
        flags = bsdf.flags()
        normal = si.sh_frame.n
        normal = dr.select(dr.dot(normal, ray.d) > 0, -normal, normal)
        albedo = dr.select(si.is_valid(), reflectance(si, bsdf), 0.0)
        valid = si.is_valid() & (dr.max(throughput) > 0)
        asked = valid & mi.has_flag(flags, smooth)
        onward = valid & mi.has_flag(flags, mi.BSDFFlags.Delta)
        dr.eval(si, emission, normal, albedo, asked, onward, throughput)
        known.index_add_(0, torch.from_numpy(path), rows_of(emission, many).nan_to_num(0.0, 0.0, 0.0))
        where = torch.from_numpy(np.flatnonzero(np.array(asked)))
        if len(where):
            found.append(
                RadiancePoints(
                    *(rows_of(part, many)[where] for part in (si.p, normal, -ray.d, albedo, throughput)),
                    torch.from_numpy(path)[where],
                )
            )  # fmt: skip
            if keep:
                index = mi.UInt32(where.numpy().astype(np.uint32))
                kept.append(dr.gather(mi.SurfaceInteraction3f, si, index))
        on = np.flatnonzero(np.array(onward))
        if len(on) == 0 or depth == CHAIN:
            break
        index = mi.UInt32(on.astype(np.uint32))
        si = dr.gather(mi.SurfaceInteraction3f, si, index)
        throughput = dr.gather(mi.Color3f, throughput, index)
        sample = make_sampler(CHAIN * seed + depth + 1, len(on))
        bs, value = si.bsdf().sample(delta, si, sample.next_1d(), sample.next_2d())
        throughput *= value
        ray = si.spawn_ray(si.to_world(bs.wo))
        path = path[on]
    if not found:
        none = torch.zeros((0, 3))
        found = [RadiancePoints(none, none, none, none, none, torch.zeros(0, dtype=torch.long))]
    return Answers(known, RadiancePoints.concatenate(found), kept)


def reflectance(si, bsdf):
    """The colour of surfaces: diffuse reflectance, or of a BSDF that has none what its lobe reflects.

    Mitsuba's ``eval_diffuse_reflectance`` of a rough metal is the value of its narrow lobe far off the mirror
    direction, which is about black and shows no texture. The sample in the middle of the lobe weighs what
    arrives from there by the metal's colour instead.
    """
    import drjit as dr

    mi = mitsuba()
    _, weight = bsdf.sample(lobes(False), si, mi.Float(0.5), mi.Point2f(0.5))
    lobe = dr.select(dr.all(dr.isfinite(weight)), dr.clip(weight, 0.0, 1.0), 0.0)
    diffuse = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
    return dr.select(diffuse, bsdf.eval_diffuse_reflectance(si), lobe)


def power(a, b):
    """Weight of a sample of density a where another strategy has density b (power heuristic)."""
    import drjit as dr

    return dr.select(a > 0, a * a / (a * a + b * b), 0.0)


def make_sampler(seed: int, count: int):
    """Independent random numbers for ``count`` rays; kernels stay the same from seed to seed."""
    mi = mitsuba()
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed & 0xFFFFFFFF, count)
    return sampler


def right_hand_side(
    mi_scene, si, count: int, samples: int, seed: int, sampling: str = "bsdf", emitters: bool = True
) -> Answers:
    """One estimate of the light that each of N points reflects, from ``samples`` directions (equation 10).

    Args:
        si: interactions of ``count`` points, with ``wi`` set to where their light goes.
        sampling: ``bsdf``, or ``uniform`` over the hemisphere (the whole sphere where light passes through).
        emitters: sample them as well, with multiple importance. The paper finds them with its directions
            only, which a small lamp makes noisy.

    Raises:
        PrtError: for another ``sampling`` or fewer than 1 sample.
    """
    import drjit as dr

    mi = mitsuba()
    if sampling not in SAMPLING:
        raise PrtError(f"method.training.sampling={sampling!r} is not one of {', '.join(SAMPLING)}")
    if samples < 1:
        raise PrtError(f"right-hand samples={samples} must be at least 1")
    many = count * samples
    sampler = make_sampler(seed, many)
    number = dr.arange(mi.UInt32, many) // samples
    si = dr.gather(mi.SurfaceInteraction3f, si, number)
    context, bsdf = lobes(False), si.bsdf()
    direct = dr.zeros(mi.Color3f, many)
    if emitters:
        ds, light = mi_scene.sample_emitter_direction(si, sampler.next_2d(), True)
        value, other = bsdf.eval_pdf(context, si, si.to_local(ds.d))
        if sampling == "uniform":
            other = _uniform_pdf(bsdf, si.to_local(ds.d), si)
        direct = value * light * dr.select(ds.delta, 1.0, power(ds.pdf, other))
    if sampling == "bsdf":
        bs, weight = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d())
        local, pdf = bs.wo, bs.pdf
    else:
        local = _uniform_direction(bsdf, si, sampler.next_2d())
        pdf = _uniform_pdf(bsdf, local, si)
        weight = bsdf.eval(context, si, local) / pdf
    weight = dr.select(dr.all(dr.isfinite(weight)), weight / samples, 0.0)
    ray = si.spawn_ray(si.to_world(local))
    dr.eval(ray, weight, pdf, direct, si)
    answers = follow(mi_scene, ray, many, seed, weight, pdf if emitters else None, si if emitters else None)
    known = answers.known + rows_of(direct, many).nan_to_num(0.0, 0.0, 0.0) / samples
    answers.points.path = answers.points.path // samples
    return Answers(known.reshape(count, samples, 3).sum(1), answers.points)


def _two_sided(bsdf):
    mi = mitsuba()
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.Transmission)


def _uniform_direction(bsdf, si, sample):
    import drjit as dr

    mi = mitsuba()
    up = mi.warp.square_to_uniform_hemisphere(sample)
    up.z = dr.select(si.wi.z < 0, -up.z, up.z)
    return dr.select(_two_sided(bsdf), mi.warp.square_to_uniform_sphere(sample), up)


def _uniform_pdf(bsdf, local, si):
    import drjit as dr

    mi = mitsuba()
    same = local.z * si.wi.z > 0
    return dr.select(_two_sided(bsdf), mi.Float(1 / (4 * dr.pi)), dr.select(same, 1 / (2 * dr.pi), 0.0))

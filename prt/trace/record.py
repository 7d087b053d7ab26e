"""Record transport once, relight for free: where light paths leave the scene and what they carry.

Two modes. Without a prior, paths are continued by BSDF sampling alone and each leaves at most one sample,
where it escapes. With a prior (a lighting distribution) every surface vertex also tries a direction drawn
from it, and both are combined by multiple importance sampling (Veach and Guibas 1995, power heuristic). Its
weights depend only on the two pdfs, never on a radiance, so that the record stays exact for every lighting.

Bounces are counted as Mitsuba's ``path`` integrator counts depth: every surface interaction, those with a
transparent mask (null lobes) included; a path that met nothing but null interactions counts as 0 bounces,
background, which ``hide_emitters`` removes from references too. Shadow rays stop at masks, as Mitsuba's do.
"""

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from prt.errors import PrtError
from prt.light.cubemap import texel_solid_angles
from prt.scene.capture import sensor_description
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace.cubemap_emitter import TexelSampler, checked, direction_to_texel, radiance_weights
from prt.trace.transport import Transport

#: Paths, or with a prior paths times vertices, that are traced at a time: bounds the memory.
WAVEFRONT = 1 << 22
#: Share of next-event samples drawn uniformly over the sphere: no direction has zero density.
DEFENSIVE = 0.2
#: From this many bounces on Russian roulette may end a path.
ROULETTE = 8
#: Marks a slot that holds no sample.
EMPTY = -1


def record(
    mi_scene,
    view: View,
    spp: int,
    max_depth: int,
    resolution: int,
    seed: int,
    prior: Float[Tensor, "6 Q Q 3"] | None = None,
    merge: bool = False,
    thin: float = 0.0,
) -> Transport:
    """Trace ``spp`` paths through every pixel and record where and with what throughput they leave.

    Args:
        mi_scene: from ``Scene.load()``; its emitters, if any, are not looked at.
        view: the camera; paths start at random places within the pixel (box filter).
        spp: paths per pixel.
        max_depth: surface bounces D; equals Mitsuba's ``path`` with ``max_depth = D + 1``.
        resolution: R of the cubemap the texels refer to.
        seed: equal seeds give equal records.
        prior: lighting that next-event samples are drawn from, of any resolution; None: BSDF sampling only.
        merge: add up samples of one pixel, texel and class (background, direct, indirect): smaller.
        thin: next-event samples whose throughput times BSDF times cosine is below this are dropped by Russian
            roulette (unbiased; the record gets smaller and noisier); 0 keeps all. Only used with a prior.

    Returns:
        The record of all P = width * height pixels, row-major.

    Raises:
        PrtError: for settings out of range, a prior that is no cubemap, or Mitsuba's scalar variant.
    """
    mi = mitsuba()
    for name, value in (("spp", spp), ("max_depth", max_depth), ("resolution", resolution)):
        if not isinstance(value, int) or value < 1:
            raise PrtError(f"record {name}={value!r} must be a whole number of at least 1")
    if mi.variant().startswith("scalar"):
        raise PrtError(
            "the transport recorder needs a vectorised Mitsuba variant: pip install karellen-llvm-core"
        )
    sampler = prior_sampler(prior) if prior is not None else None
    sensor = mi.load_dict(sensor_description(view))
    pixels = view.width * view.height
    per_path = max_depth + 1 if sampler else 1
    chunk = max(1, WAVEFRONT // (spp * per_path))
    parts = []
    for number, first in enumerate(range(0, pixels, chunk)):
        count = min(chunk, pixels - first)
        parts.append(_record_pixels(mi_scene, sensor, view, first, count, spp, max_depth, resolution,
                                    _chunk_seed(seed, number), sampler, thin))  # fmt: skip
    transport = parts[0] if len(parts) == 1 else Transport.concatenate(parts)
    return merged(transport) if merge else transport


def prior_sampler(prior: Float[Tensor, "6 Q Q 3"]) -> TexelSampler:
    """What next-event directions are drawn from: the prior, mixed with the uniform sphere."""
    weights = radiance_weights(checked(prior))
    uniform = texel_solid_angles(prior.shape[1], torch.float64).numpy()
    uniform = uniform / uniform.sum()
    total = weights.sum()
    return TexelSampler((1 - DEFENSIVE) * weights / total + DEFENSIVE * uniform if total > 0 else uniform)


def merged(transport: Transport) -> Transport:
    """The same transport with at most one sample per pixel, texel and class (0, 1, 2 or more bounces)."""
    texels = 6 * transport.resolution**2
    kind = transport.bounces.clamp(max=2).long()
    key = (transport.pixel_of_sample() * texels + transport.texel) * 3 + kind
    key, where = torch.unique(key, return_inverse=True)
    weight = torch.zeros((len(key), 3), dtype=torch.float64).index_add_(0, where, transport.weight.double())
    counts = torch.bincount(key // (3 * texels), minlength=transport.pixels)
    return Transport(
        transport.resolution, _offsets(counts), (key // 3 % texels).to(torch.int32), weight.float(),
        (key % 3).to(torch.uint8),
    )  # fmt: skip


def _chunk_seed(seed: int, number: int) -> int:
    return int(np.random.SeedSequence([seed & 0xFFFFFFFF, number]).generate_state(1)[0])


def _offsets(counts: Tensor) -> Tensor:
    return torch.cat([torch.zeros(1, dtype=torch.int64), counts.cumsum(0)])


def _record_pixels(
    mi_scene, sensor, view, first, count, spp, max_depth, resolution, seed, sampler, thin
) -> Transport:
    """Record the pixels ``first`` to ``first + count``; samples come out in the order of the paths."""
    import drjit as dr

    mi = mitsuba()
    paths = count * spp
    rng = mi.load_dict({"type": "independent"})
    rng.seed(seed, paths)
    # opaque: another view, another chunk or another number of samples runs the same kernel
    pixel = dr.opaque(mi.UInt32, first) + dr.arange(mi.UInt32, paths) // dr.opaque(mi.UInt32, spp)
    width, height = dr.opaque(mi.UInt32, view.width), dr.opaque(mi.UInt32, view.height)
    place = mi.Point2f(mi.Float(pixel % width), mi.Float(pixel // width)) + rng.next_2d()
    place = place / mi.Point2f(mi.Float(width), mi.Float(height))
    ray, _ = sensor.sample_ray(mi.Float(0), mi.Float(0.5), place, mi.Point2f(0.5))
    ends = follow(mi_scene, mi.Ray3f(ray), rng, paths, max_depth, resolution, sampler, thin)
    return _compact(*ends, count, spp, resolution)


def follow(
    mi_scene, ray, rng, paths: int, max_depth: int, resolution: int, sampler: TexelSampler | None = None,
    thin: float = 0.0,
) -> tuple[Int[Tensor, "N S"], Float[Tensor, "N S 3"], UInt8[Tensor, "N S"]]:  # fmt: skip
    """Where paths that begin with given rays leave the scene, and with what throughput.

    Args:
        ray: N = ``paths`` of them; ``rng``: a Mitsuba sampler seeded for as many.
        sampler: of next-event directions (:func:`prior_sampler`); others as in :func:`record`.

    Returns:
        Texel, weight and bounces of the S samples of each path: with a sampler the next-event samples of its
        surface hits in order, then in any case where it escaped. An :data:`EMPTY` texel marks no sample.
    """
    import drjit as dr

    slots = NextEventSlots(paths, max_depth, resolution, sampler, thin) if sampler else None
    ends = trace(mi_scene, ray, rng, max_depth, resolution, slots)
    dr.eval(ends, slots.arrays if slots else None)
    texel, weight, bounces = (_torch(array)[:, None] for array in ends)
    bounces = bounces.to(torch.uint8)
    if slots:
        near, near_weight = (_torch(array) for array in slots.arrays)
        texel = torch.cat([near.view(max_depth, paths).T, texel], dim=1)
        weight = torch.cat([near_weight.view(max_depth, paths, 3).transpose(0, 1), weight], dim=1)
        vertex = torch.arange(1, max_depth + 1).to(bounces.dtype)
        bounces = torch.cat([vertex.expand(paths, max_depth), bounces], dim=1)
    return texel, weight, bounces


class NextEventSlots:
    """Next-event samples of a wavefront: slot ``vertex * paths + path`` holds texel and weight."""

    def __init__(self, paths: int, max_depth: int, resolution: int, sampler: TexelSampler, thin: float):
        import drjit as dr

        mi = mitsuba()
        self.resolution, self.sampler = resolution, sampler
        self.thinning, self.thin = thin > 0, dr.opaque(mi.Float, thin)
        self.paths, self.path = dr.opaque(mi.UInt32, paths), dr.arange(mi.UInt32, paths)
        self.texel = dr.full(mi.Int32, EMPTY, paths * max_depth)
        self.weight = dr.empty(mi.Float, 3 * paths * max_depth)  # read only where texel is not EMPTY
        dr.make_opaque(self.texel, self.weight)

    @property
    def arrays(self):
        return self.texel, self.weight

    def write(self, vertex, d, weight, active) -> None:
        import drjit as dr

        slot = vertex * self.paths + self.path
        dr.scatter(self.texel, mitsuba().Int32(direction_to_texel(d, self.resolution)[0]), slot, active)
        dr.scatter(self.weight, weight, slot, active)


def power_heuristic(a, b):
    """Weight of a sample drawn with density ``a`` where density ``b`` could have drawn it too."""
    import drjit as dr

    return dr.select(a > 0, dr.rcp(1 + dr.square(b / dr.maximum(a, 1e-30))), 0)


def trace(mi_scene, ray, rng, max_depth: int, resolution: int, slots: NextEventSlots | None):
    """Follow a wavefront of camera rays until they leave, are absorbed or have bounced ``max_depth`` times.

    Fills ``slots``, where given, on the way.

    Returns:
        Per path: the texel it left through (EMPTY if it did not), what it carries there (throughput, times
        the multiple-importance weight with ``slots``), and its bounces.
    """
    import drjit as dr

    mi = mitsuba()
    # the decorator is applied here because drjit must not be imported before mitsuba() has found its LLVM
    loop = dr.syntax(_bounce)
    ray, throughput, depth, solid, escaped, pdf, delta = loop(mi, dr, mi_scene, ray, rng, max_depth, slots)
    if slots is not None:
        weight = power_heuristic(pdf, slots.sampler.pdf(ray.d, escaped))
        throughput = throughput * dr.select(delta, 1, weight)
    texel, _ = direction_to_texel(ray.d, resolution)
    escaped &= carries(throughput)
    return dr.select(escaped, mi.Int32(texel), EMPTY), throughput, dr.select(solid, mi.Int32(depth), 0)


def carries(weight):
    """Whether a sample is worth keeping: some light passes, and no BSDF returned a NaN or an infinity."""
    import drjit as dr

    return (dr.max(weight) > 0) & dr.all(dr.isfinite(weight))


def _bounce(mi, dr, mi_scene, ray, rng, max_depth, slots):
    """The loop of :func:`trace`; Python control flow on arrays, so it must run through ``dr.syntax``."""
    context = mi.BSDFContext()
    throughput, eta = mi.Color3f(1), mi.Float(1)
    depth, solid = mi.UInt32(0), mi.Bool(False)
    pdf, delta = mi.Float(1), mi.Bool(True)
    hit = mi_scene.ray_intersect_preliminary(ray, coherent=True)
    escaped = ~hit.is_valid()
    active = hit.is_valid()
    while dr.hint(active, label="record", max_iterations=max_depth):
        si = hit.compute_surface_interaction(ray)
        bsdf = si.bsdf(ray)
        if dr.hint(slots is not None, mode="scalar"):
            sample, weight = next_event(mi_scene, context, si, bsdf, throughput, depth, rng, slots)
        else:
            sample, weight = bsdf.sample(context, si, rng.next_1d(), rng.next_2d())
        throughput *= weight
        eta *= sample.eta
        pdf = mi.Float(sample.pdf)
        delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        solid |= ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        ray = si.spawn_ray(si.to_world(sample.wo))
        depth += 1
        alive = dr.max(throughput) > 0
        if dr.hint(max_depth > ROULETTE, mode="scalar"):
            chance = dr.select(depth >= ROULETTE, dr.minimum(dr.max(throughput) * dr.square(eta), 0.95), 1)
            alive &= rng.next_1d() < chance
            throughput /= dr.maximum(chance, 1e-6)
        hit = mi_scene.ray_intersect_preliminary(ray, coherent=False, active=alive)
        escaped = alive & ~hit.is_valid()
        active = alive & hit.is_valid() & (depth < max_depth)
    return ray, throughput, depth, solid, escaped, pdf, delta


def next_event(mi_scene, context, si, bsdf, throughput, depth, rng, slots: NextEventSlots):
    """One sample from the prior at a vertex, written to its slot; returns the BSDF sample that goes on."""
    import drjit as dr

    mi = mitsuba()
    active = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    d, pdf, _ = slots.sampler.sample(rng.next_2d(), active)
    wo = si.to_local(d)
    value, bsdf_pdf, sample, weight = bsdf.eval_pdf_sample(context, si, wo, rng.next_1d(), rng.next_2d())
    carried = throughput * value
    active &= (pdf > 0) & carries(carried)
    factor = power_heuristic(pdf, bsdf_pdf) / dr.maximum(pdf, 1e-30)
    if slots.thinning:
        keep = dr.minimum(dr.max(carried) / slots.thin, 1)
        active &= rng.next_1d() < keep
        factor /= dr.maximum(keep, 1e-30)
    active &= ~mi_scene.ray_test(si.spawn_ray(d), active)
    slots.write(depth, d, carried * factor, active)
    return sample, weight


def _torch(array) -> Tensor:
    """A Dr.Jit array as a CPU tensor, one row per entry."""
    values = torch.from_numpy(np.array(array))
    return values.T if values.ndim == 2 else values


def _compact(texel, weight, bounces, pixels, spp, resolution) -> Transport:
    """Drop the empty slots of (paths, slots) arrays and bring the rest into rows."""
    keep = texel != EMPTY
    counts = keep.view(pixels, -1).sum(1)
    kept = keep.flatten().nonzero()[:, 0]
    return Transport(
        resolution, _offsets(counts), texel.flatten()[kept], weight.flatten(0, 1)[kept] / spp,
        bounces.flatten()[kept],
    )  # fmt: skip

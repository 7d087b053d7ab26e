"""Rays from near-mirrors to what they mirror, for networks that cannot hold sharp reflections.

After Su et al. 2024, section 5, "Specular Surfaces": rays go on until a surface is not specular. Of a pixel's
indirect light (two or more surface bounces) its own surface x1 is the last bounce. Rays sampled from the
surface's BSDF lead to surfaces x2, so that

    indirect(x1) = mean over rays of  weight * (direct(x2) + indirect(x2)).

``direct(x2)`` is traced here, the environment sampled together with the BSDF of x2; ``indirect(x2)`` is the
network's. Where x2 mirrors too, the rays go on from there. A ray that leaves the scene from x1 carries direct
light, which is no part of this.

Bounces are counted as by the path integrator (``prt.trace.record``), but for the network's own share: it was
trained on light of up to D bounces and is asked after at least one, so paths of D + 1 bounces and a few more
come in, which a reference of depth D leaves out.
"""

import dataclasses

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.scene.capture import (
    first_opaque_hit,
    looked_through,
    row_numbers,
    rows_of,
    sensor_description,
    surfaces,
    vectors,
)
from prt.scene.gbuffer import GBuffer
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace.radiance_rays import power

#: how far before a point the ray starts that finds its surface again, as a share of its coordinates' size
BACK = 1e-3
#: step of the lattice that the rays of a pixel are drawn from: the golden ratio less 1
GOLDEN = 0.618034


@dataclasses.dataclass
class Reflections:
    """What the rays of P pixels bring.

    Attributes:
        found: points whose surface was met again; for the others there is nothing here. All, of a view.
        known: indirect light that needs no network: direct light at what the rays meet, times their weights.
        points: the M points where indirect light is asked for, ``wo`` towards where the ray came from.
        weight: what the light of each counts for, all weights of its path over the number of rays.
        pixel: whose rays met it.
    """

    found: Bool[Tensor, "P"]
    known: Float[Tensor, "P 3"]
    points: GBuffer
    weight: Float[Tensor, "M 3"]
    pixel: Int[Tensor, "M"]

    def total(self, values: Float[Tensor, "M 3"]) -> Float[Tensor, "P 3"]:
        """Indirect light of the pixels, given that of the points."""
        return self.known.index_add(0, self.pixel, self.weight * values)


class Draws:
    """Random numbers of rays: those of a pixel are spread evenly, and each alone is uniform.

    A lattice over the rays of a pixel, dealt to them in an order (Kensler 2013) and shifted (Cranley and
    Patterson 1976) by hashes of the pixel, the seed and the dimension. Nothing is kept between calls but the
    number of the dimension: equal seeds, equal rays.

    Args:
        pixel, number: ``mi.UInt32`` of each ray: its pixel, and which of the pixel's ``rays`` it is.
    """

    def __init__(self, pixel, number, rays: int, seed: int):
        import drjit as dr

        self.pixel, self.number, self.rays, self.dimension = pixel, number, rays, (seed & 0xFFFFF) << 12
        dr.make_opaque(self.pixel, self.number)

    def select(self, index) -> None:
        """Go on with some of the rays only."""
        import drjit as dr

        mi = mitsuba()
        self.pixel, self.number = (dr.gather(mi.UInt32, a, index) for a in (self.pixel, self.number))
        dr.make_opaque(self.pixel, self.number)

    def one(self):
        """A number a ray."""
        return self.two().x

    def two(self, part: int = 0, parts: int = 1):
        """A pair a ray; of several a ray, ``parts``, asked for in turn, the lattice holds those of all."""
        import drjit as dr

        mi = mitsuba()
        self.dimension += part == 0
        shift, order = mi.sample_tea_32(self.pixel, dr.opaque(mi.UInt32, self.dimension), 6)
        count = self.rays * parts
        # without an order of its own, one dimension would be tied to the next and more rays would not help
        number = mi.Float(mi.permute_kensler(self.number * parts + part, count, order))
        other, _ = mi.sample_tea_32(shift, order, 4)
        pair = mi.Point2f(number / count + unit(shift), GOLDEN * number + unit(other))
        # below 1, which samplers never return
        return dr.minimum(pair - dr.floor(pair), 1 - 2.0**-24)


def unit(bits):
    """``mi.UInt32`` as numbers in [0, 1)."""
    return mitsuba().Float(bits >> 8) * 2.0**-24


def reflections(
    mi_scene,
    gbuffer: GBuffer,
    names: Int[Tensor, "P"],
    view: View | None,
    roughness: float,
    rays: int,
    light_samples: int,
    bounces: int,
    seed: int,
) -> Reflections:
    """Rays of the points of a G-buffer to what they mirror, and on where that mirrors too.

    Args:
        mi_scene: from :func:`prt.trace.cubemap_emitter.scene_with_lighting`; its lighting is the one meant.
        gbuffer: P points of near-mirrors, on the surfaces of the scene.
        names: numbers of the points that their random numbers follow from; of a view, of their pixels.
        view: whose pixels they are. Rays then start all over the pixel, as those of a reference do, and not
            at its centre only: what is mirrored has edges. One that meets no mirror there is an answer of the
            network's like any other, and one that meets nothing is dark. None: rays start at the points.
        roughness: surfaces of a lower sigma are mirrors.
        rays: a pixel.
        light_samples: directions drawn from the lighting at every surface met, beside one from its BSDF.
        bounces: mirrors in a row that are followed, the pixel's own the first; the surface after the last one
            is asked of the network, mirror or not.

    Returns:
        CPU tensors. Points through which a mask lets most light pass are looked through, as in a G-buffer.
    """
    import drjit as dr

    mi = mitsuba()
    count = len(gbuffer) * rays
    if count == 0:
        none, zero = torch.zeros(0, dtype=torch.long), torch.zeros((0, 3))
        return Reflections(none.bool(), zero, gbuffer.rows(none), zero, none)
    number = dr.arange(mi.UInt32, count)
    row = number // dr.opaque(mi.UInt32, rays)
    name = dr.gather(mi.UInt32, row_numbers(names), row)
    draws = Draws(name, number % dr.opaque(mi.UInt32, rays), rays, seed)
    if view is None:
        si, found = surfaces_at(mi_scene, gbuffer, row)
    else:
        si, found = first_opaque_hit(mi_scene, pixel_rays(view, name, draws)), mi.Bool(True)
    found = torch.from_numpy(np.broadcast_to(np.array(found), count)[::rays].copy())

    throughput = dr.full(mi.Color3f, 1 / rays, count)
    known = torch.zeros((len(gbuffer), 3))
    pixel = torch.arange(len(gbuffer)).repeat_interleave(rays)
    asked: list[tuple[GBuffer, Tensor, Tensor]] = []
    for mirrors in range(bounces + 1):
        going = si.is_valid() & (dr.max(throughput) > 0)
        dr.eval(si, throughput, going)
        on = torch.from_numpy(np.array(going)).nonzero()[:, 0]
        many = len(on)
        if many == 0:
            break
        index, pixel = row_numbers(on), pixel[on]
        si = dr.gather(mi.SurfaceInteraction3f, si, index)
        throughput = dr.gather(mi.Color3f, throughput, index)
        draws.select(index)
        points = points_of(si, many)
        # at the pixel's own surface light straight from the environment is none of this
        light, weight, following = lit(mi_scene, si, light_samples if mirrors else None, draws)
        carried = throughput * light
        dr.eval(carried, weight, following)
        known.index_add_(0, pixel, rows_of(carried, many))
        ends = (points.roughness[:, 0] >= roughness) | (mirrors == bounces)
        row = ends.nonzero()[:, 0]
        asked.append((points.rows(row), rows_of(throughput, many)[row], pixel[row]))
        throughput = dr.select(mi.Bool(ends.clone()), 0.0, throughput * weight)
        si = following
    nothing = (gbuffer.rows(torch.arange(0)), torch.zeros((0, 3)), torch.zeros(0, dtype=torch.long))
    points, weights, pixels = zip(*(asked or [nothing]), strict=True)
    return Reflections(found, known, GBuffer.concatenate(list(points)), torch.cat(weights), torch.cat(pixels))


def pixel_rays(view: View, pixel, draws: Draws):
    """Camera rays through places drawn within pixels (``mi.UInt32``, row-major), as ``record`` has them."""
    import drjit as dr

    mi = mitsuba()
    sensor = mi.load_dict(sensor_description(view))
    width, height = dr.opaque(mi.UInt32, view.width), dr.opaque(mi.UInt32, view.height)
    place = mi.Point2f(mi.Float(pixel % width), mi.Float(pixel // width)) + draws.two()
    place = place / mi.Point2f(mi.Float(width), mi.Float(height))
    ray, _ = sensor.sample_ray(mi.Float(0), mi.Float(0.5), place, mi.Point2f(0.5))
    return mi.Ray3f(ray)


def surfaces_at(mi_scene, gbuffer: GBuffer, row):
    """The surfaces that points of a G-buffer lie on, seen along ``wo``, and whether they are there.

    They are not where the point is of another scene, or something stands in its way.

    Args:
        row: which of the points (``mi.UInt32``).

    Returns:
        ``mi.SurfaceInteraction3f``, not valid where nothing was found, and ``mi.Bool``.
    """
    import drjit as dr

    mi = mitsuba()

    position = dr.gather(mi.Point3f, vectors(mi.Point3f, gbuffer.position), row)
    wo = dr.gather(mi.Vector3f, vectors(mi.Vector3f, gbuffer.wo), row)
    back = BACK * (1 + dr.max(dr.abs(position)))
    si = first_opaque_hit(mi_scene, mi.Ray3f(position + back * wo, -wo))
    found = si.is_valid() & (dr.norm(si.p - position) < back)
    si.t = dr.select(found, si.t, dr.inf)
    return si, found


def points_of(si, count: int) -> GBuffer:
    """The G-buffer of ``count`` valid interactions, ``wo`` along their ``wi``."""
    return surfaces(si, count, rows_of(si.to_world(si.wi), count))


def lit(mi_scene, si, light_samples: int | None, draws: Draws):
    """Light that interactions reflect straight from the environment, and the way on from them.

    ``light_samples`` directions from the lighting and one from the BSDF, combined by multiple importance
    sampling (Veach 1995, power heuristic, counts of samples included). None: no such light, the way on alone.

    Returns:
        The estimate (``mi.Color3f``), the weight of the BSDF sample, and the interactions its ray meets.
    """
    import drjit as dr

    mi = mitsuba()
    context, bsdf, environment = mi.BSDFContext(), si.bsdf(), mi_scene.environment()
    sample, weight = bsdf.sample(context, si, draws.one(), draws.two())
    weight = _finite(weight)
    ray = si.spawn_ray(si.to_world(sample.wo))
    first = mi_scene.ray_intersect(ray)
    following = looked_through(mi_scene, ray, first)
    if light_samples is None:
        return mi.Color3f(0.0), weight, following
    ds = dr.zeros(mi.DirectionSample3f)
    ds.d = ray.d
    # the lighting is not sampled along lobes of no width nor through masks, at which shadow rays end
    alone = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta) | first.is_valid()
    share = power(sample.pdf, light_samples * environment.pdf_direction(si, ds))
    light = weight * environment.eval_direction(si, ds) * dr.select(alone, 1.0, share)
    light = dr.select(following.is_valid(), 0.0, light)
    for part in range(light_samples):
        ds, radiance = mi_scene.sample_emitter_direction(si, draws.two(part, light_samples), True)
        value, other = bsdf.eval_pdf(context, si, si.to_local(ds.d))
        light += _finite(value * radiance * power(light_samples * ds.pdf, other)) / light_samples
    return light, weight, following


def _finite(value):
    """A colour, black where it is not finite."""
    import drjit as dr

    return dr.select(dr.all(dr.isfinite(value)), value, 0.0)

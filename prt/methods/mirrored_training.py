"""Training points behind mirrors: what is seen in a mirror only is taught to the network as well.

Secondary rays ask a network for surfaces that no training view may have seen: the backs of things. The
recorded transport knows them. Of the paths of a mirror's pixel those of three bounces or more have bounced at
what is mirrored twice or more: divided by what the mirror reflects, they are the indirect transport of that
place, seen from the mirror. Nothing is recorded anew.
"""

import dataclasses
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.scene.capture import first_opaque_hit, row_numbers, rows_of, vectors
from prt.scene.gbuffer import GBuffer
from prt.scene.mitsuba_setup import mitsuba
from prt.trace.radiance_rays import make_sampler
from prt.trace.secondary import points_of, surfaces_at
from prt.trace.transport import Transport

#: directions of a mirror's lobe that its reflectance is the mean of
LOBE = 16
#: mirrors that reflect less are passed over: their paths are few and dim
LEAST = 0.1


def with_mirrored(data: Any, mi_scene: Any, roughness: float) -> Any:
    """Training data with a point more for every mirror pixel in which a surface is seen that is no mirror.

    Such a point is as sharp as the mirror's lobe is narrow: for near-mirrors (sigma of 0.1, a lobe of half a
    degree) no wider than a pixel.

    Args:
        data: ``gbuffer``, ``transport`` with the bounces of its samples, ``point_view``, ``importance``.
        mi_scene: the scene, with or without an emitter.
        roughness: surfaces of a lower sigma are mirrors.
    """
    rows = (data.gbuffer.roughness[:, 0] < roughness).nonzero()[:, 0]
    if len(rows) == 0:
        return data
    seen, points, reflected = mirrored_points(mi_scene, data.gbuffer.rows(rows), roughness)
    rows = rows[seen]
    if len(rows) == 0:
        return data
    transport = unmirrored(data.transport.rows(rows), reflected)
    importance = {name: torch.cat([value, value[rows]]) for name, value in data.importance.items()}
    importance["specular"][-len(rows) :] = points.specular.mean(1) * (1 - points.roughness[:, 0])
    return dataclasses.replace(
        data,
        gbuffer=GBuffer.concatenate([data.gbuffer, points]),
        transport=Transport.concatenate([data.transport, transport]),
        point_view=torch.cat([data.point_view, data.point_view[rows]]),
        importance=importance,
    )


def mirrored_points(
    mi_scene: Any, mirrors: GBuffer, roughness: float
) -> tuple[Int[Tensor, "M"], GBuffer, Float[Tensor, "M 3"]]:
    """Where the reflected directions of mirrors lead.

    Returns:
        Which of the mirrors show a surface that is no mirror, and reflect enough of it; the M points on it,
        and what share of light each mirror reflects.
    """
    import drjit as dr

    mi = mitsuba()
    count = len(mirrors)
    si, _ = surfaces_at(mi_scene, mirrors, dr.arange(mi.UInt32, count * LOBE) // LOBE)
    sampler = make_sampler(1, count * LOBE)
    _, weight = si.bsdf().sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), si.is_valid())
    reflected = rows_of(weight, count * LOBE).nan_to_num(0.0, 0.0, 0.0).view(count, LOBE, 3).mean(1)
    si, _ = surfaces_at(mi_scene, mirrors, dr.arange(mi.UInt32, count))
    met = first_opaque_hit(mi_scene, si.spawn_ray(vectors(mi.Vector3f, mirrors.wr)))
    valid = met.is_valid() & si.is_valid()
    dr.eval(met, valid)
    seen = torch.from_numpy(np.array(valid)).nonzero()[:, 0]
    if len(seen) == 0:
        return seen, mirrors.rows(seen), reflected[seen]
    met = dr.gather(mi.SurfaceInteraction3f, met, row_numbers(seen))
    points = points_of(met, len(seen))
    good = (points.roughness[:, 0] >= roughness) & (reflected[seen].amin(1) > LEAST)
    good = good.nonzero()[:, 0]
    return seen[good], points.rows(good), reflected[seen[good]]


def unmirrored(transport: Transport, reflected: Float[Tensor, "M 3"]) -> Transport:
    """Of paths that begin at mirrors, the indirect transport of what they show."""
    weight = transport.weight / reflected[transport.pixel_of_sample()]
    shown = dataclasses.replace(transport, weight=weight).samples(transport.bounces >= 3)
    return dataclasses.replace(shown, bounces=shown.bounces - 1)

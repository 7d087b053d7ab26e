"""Where mirror rays arrive: the places that a pixel's reflection shows."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.scene.capture import rows_of, vectors
from prt.scene.gbuffer import GBuffer
from prt.scene.mitsuba_setup import mitsuba

#: the ray starts this far off the surface, as a share of the scene's size
OFFSET = 1e-4


def mirrored(mi_scene, gbuffer: GBuffer) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 1"]]:
    """The first surface along ``wr`` of each point, and 1 where there is one, 0 where the ray leaves.

    Rays that leave have the point itself as their place. Masks are taken for surfaces.
    """
    import drjit as dr

    mi = mitsuba()
    count = len(gbuffer)
    if count == 0:
        return torch.zeros((0, 3)), torch.zeros((0, 1))
    box = mi_scene.bbox()
    step = OFFSET * float(np.linalg.norm(np.array(box.max) - np.array(box.min)))
    start = vectors(mi.Point3f, gbuffer.position + step * gbuffer.normal)
    ray = mi.Ray3f(start, vectors(mi.Vector3f, gbuffer.wr))
    hit = mi_scene.ray_intersect_preliminary(ray, coherent=False)
    valid = hit.is_valid()
    place = dr.select(valid, ray(hit.t), start)
    dr.eval(place, valid)
    return rows_of(place, count), torch.from_numpy(np.array(valid))[:, None].float()

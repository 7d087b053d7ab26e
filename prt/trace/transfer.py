"""Transfer of direct light by ray casting: cosine-weighted visibility in spherical harmonics.

Dhawal 2022, section 4.2: "The ground truth transfer is calculated using ray-tracing for each sampled point";
a transfer vector holds the integrals of ``V(d) max(0, n.d) y_i(d) / pi``. Directions are a Hammersley set in
proportion to the cosine, moved at random from point to point, so the estimate is the mean of ``V y_i``.
"""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.sh import sh_basis
from prt.progress import track
from prt.scene.frames import perpendicular
from prt.scene.lightmap_points import OFFSET
from prt.scene.mitsuba_setup import mitsuba
from prt.trace.sh_transfer import cosine_directions, sphere_directions
from prt.trace.surface import Surface

#: points that a kernel works on, rays that are cast at a time otherwise
POINTS, RAYS = 1 << 16, 1 << 20
#: bands that Dr.Jit's harmonics have
MOST_BANDS = 10


def bake(
    surface: Surface,
    position: Float[Tensor, "N 3"],
    normal: Float[Tensor, "N 3"],
    order: int,
    directions: int,
    seed: int,
    label: str = "",
) -> Float[Tensor, "N K"]:
    """Transfer vectors of points, the whole surface casting shadows.

    Args:
        normal: unit, on the side that is lit; rays start a little along it.
        order: bands, ``K = order^2``.
        directions: rays a point.
        seed: of the random shifts.
        label: of the progress bar; none without.

    Raises:
        PrtError: for no direction, or more bands than 10.
    """
    origin = position + OFFSET * surface.extent * normal
    return _bake(surface, origin, normal, order, directions, seed, label)


def bake_visibility(
    surface: Surface, position: Float[Tensor, "N 3"], order: int, directions: int, seed: int, label: str = ""
) -> Float[Tensor, "N K"]:
    """Integrals of ``V(d) y_i(d)`` over the whole sphere at points in space; arguments as in :func:`bake`."""
    return 4 * math.pi * _bake(surface, position, None, order, directions, seed, label)


def _bake(
    surface: Surface,
    origin: Tensor,
    normal: Tensor | None,
    order: int,
    directions: int,
    seed: int,
    label: str,
) -> Float[Tensor, "N K"]:
    if not 1 <= order <= MOST_BANDS:
        raise PrtError(f"order={order} must lie between 1 and {MOST_BANDS} (bands of spherical harmonics)")
    if directions < 1:
        raise PrtError(f"directions={directions} must be at least 1 (rays a point)")
    shift = torch.rand((len(origin), 2), generator=torch.Generator().manual_seed(seed))
    one = _kernel if surface.blocked is not None else _by_rays
    parts = [slice(k, k + POINTS) for k in range(0, len(origin), POINTS)]
    shown = track(parts, label, len(parts)) if label else parts
    found = [
        one(surface, origin[k], None if normal is None else normal[k], order, directions, shift[k])
        for k in shown
    ]
    return torch.cat([torch.zeros((0, order**2)), *found])


def _by_rays(
    surface: Surface, origin: Tensor, normal: Tensor | None, order: int, directions: int, shift: Tensor
) -> Float[Tensor, "N K"]:
    """Mean of ``V y_i``; readable, and the only one where the surface has no Dr.Jit code."""
    out = []
    for rows in torch.arange(len(origin)).split(max(RAYS // directions, 1)):
        if normal is None:
            d = sphere_directions(directions, shift[rows][:, None]).flatten(0, 1)
        else:
            d = cosine_directions(normal[rows], directions, shift[rows][:, None]).flatten(0, 1)
        free = ~surface.occluded(origin[rows].repeat_interleave(directions, 0), d)
        values = sh_basis(d, order - 1) * free[:, None]
        out.append(values.view(len(rows), directions, -1).mean(1))
    return torch.cat(out)


def _kernel(
    surface: Surface, origin: Tensor, normal: Tensor | None, order: int, directions: int, shift: Tensor
) -> Float[Tensor, "N K"]:
    """The same, each point's directions one after the other in one kernel: nothing but sums is stored."""
    mi = mitsuba()
    import drjit as dr

    blocked = surface.blocked
    assert blocked is not None
    axis = origin.new_tensor([[0.0, 0.0, 1.0]]).expand(len(origin), 3) if normal is None else normal
    tangent, other = (_vector(v) for v in perpendicular(axis))
    o, n, whole = mi.Point3f(_vector(origin)), _vector(axis), normal is None
    move = mi.Point2f(np.ascontiguousarray(shift.numpy().T, dtype=np.float32))
    many = dr.opaque(mi.UInt32, directions)

    def step(index, *sums):
        u = (mi.Float(index) + 0.5) / mi.Float(many) + move.x
        v = mi.Float(dr.brev(index)) * 2.0**-32 + move.y
        u, v = u - dr.floor(u), v - dr.floor(v)
        height = 1 - 2 * u if whole else dr.sqrt(dr.maximum(1 - u, 0))
        radius, angle = dr.sqrt(dr.maximum(1 - height * height, 0)), 2 * dr.pi * v
        d = radius * dr.cos(angle) * tangent + radius * dr.sin(angle) * other
        d = mi.Vector3f(d + height * n)
        free = ~blocked(o, d)
        values = dr.sh_eval(d, order - 1)
        return index + 1, *(a + dr.select(free, b, 0) for a, b in zip(sums, values, strict=True))

    state = (dr.zeros(mi.UInt32, len(origin)), *(dr.zeros(mi.Float, len(origin)) for _ in range(order**2)))
    found = dr.while_loop(state, lambda index, *_: index < many, step, label="transfer")
    dr.eval(found)  # all sums at once: reading them one by one would run the loop for each
    sums = np.stack([np.array(part) for part in found[1:]], 1) / directions
    return torch.from_numpy(sums).float() * _signs(order)


def _signs(order: int) -> Float[Tensor, "K"]:
    """Dr.Jit's harmonics carry the Condon-Shortley sign, ours do not."""
    signs = [(-1.0) ** m for l in range(order) for m in range(-l, l + 1)]
    return torch.tensor(signs)


def _vector(values: Float[Tensor, "N 3"]):
    return mitsuba().Vector3f(np.ascontiguousarray(values.numpy().T, dtype=np.float32))

"""Sphere tracing (Hart 1996) of signed distances in torch, on the CPU or a GPU.

A ray goes forward by the distance to the nearest surface until that is below ``epsilon``. The distance has
to be a bound: nowhere greater than the true one, which holds where its gradient is no longer than 1. Within
that, it may be any torch callable from ``(N, 3)`` to ``(N,)``, negative inside.
"""

import dataclasses
from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from prt.errors import PrtError

Distance = Callable[[Tensor], Tensor]
Box = tuple[tuple[float, ...], tuple[float, ...]]

#: where a ray has arrived, and steps at most; EPSILON as a share of the extent (half the diagonal of the box)
EPSILON, STEPS = 1e-5, 1024
#: a ray that met the step limit counts as a hit if it was nearer than so many epsilons
NEARLY = 10.0
#: rays at a time: measured on a CPU, where fewer spend their time on the last few rays; GPUs want them all
CHUNK, GPU_CHUNK = 1 << 18, 1 << 22
#: positions whose gradient is taken at a time on a CPU: all that leads to it is kept
GRADIENT_CHUNK = 1 << 14
#: rays are packed anew once no more than this share of them is still on its way
PACK = 0.75


@dataclasses.dataclass
class Trace:
    """Where N rays ended.

    Attributes:
        t: along the ray, in lengths of its direction; where there is no hit, where it was given up.
        hit: whether it met the surface.
        exhausted: whether it met the step limit first. Such a ray is a hit if it was nearer to the surface
            than ``NEARLY * epsilon``: it crept along or into it, and a hole there would be seen. Else it
            is a miss. Either way it is known here that the answer is a guess.
    """

    t: Float[Tensor, "N"]
    hit: Bool[Tensor, "N"]
    exhausted: Bool[Tensor, "N"]


def sphere_trace(
    distance: Distance,
    origin: Float[Tensor, "N 3"],
    direction: Float[Tensor, "N 3"],
    near: Float[Tensor, "N"] | float,
    far: Float[Tensor, "N"] | float,
    epsilon: float,
    steps: int = STEPS,
    pack: float = PACK,
    chunk: int | None = None,
    leaving: bool = False,
) -> Trace:
    """Follow rays from ``near`` to ``far``, both in lengths of the unit ``direction``.

    A ray whose ``near`` is not less than its ``far`` misses; one that starts inside hits where it starts.

    Args:
        distance: gets positions ``(n, 3)`` whose columns lie together in memory, as ``unbind(1)`` likes them.
        epsilon: world units.
        steps: evaluations of the distance a ray may take.
        pack: share of rays under way at which they are packed anew: 0 never packs, 1 always.
        chunk: rays at a time; by default :data:`CHUNK`, or :data:`GPU_CHUNK`.
        leaving: rays start next to the surface and must not find it where they start: one has arrived at
            half the value it started with, where that is less than ``epsilon``. A bound may grow much
            slower than the true distance, and then an origin that lies well off the surface has a value
            that says it has arrived.

    Raises:
        PrtError: for an ``epsilon`` that is not above 0, or fewer than 1 step.
    """
    if not epsilon > 0:
        raise PrtError(f"epsilon={epsilon!r} must be above 0 (where a ray has arrived, world units)")
    if steps < 1:
        raise PrtError(f"steps={steps!r} must be at least 1 (evaluations of the distance a ray)")
    chunk = chunk or (CHUNK if origin.device.type == "cpu" else GPU_CHUNK)
    count = len(origin)
    near, far = (
        torch.as_tensor(v, dtype=origin.dtype, device=origin.device).expand(count) for v in (near, far)
    )
    with torch.no_grad():
        parts = [
            _trace(
                distance,
                *(v[k : k + chunk] for v in (origin, direction, near, far)),
                epsilon,
                steps,
                pack,
                leaving,
            )  # fmt: skip
            for k in range(0, count, chunk)
        ]
    if not parts:
        none = torch.zeros(0, dtype=torch.bool, device=origin.device)
        return Trace(origin.new_zeros(0), none, none)
    return Trace(*(torch.cat([getattr(part, name) for part in parts]) for name in ("t", "hit", "exhausted")))


def _trace(
    distance: Distance,
    origin: Tensor,
    direction: Tensor,
    near: Tensor,
    far: Tensor,
    epsilon: float,
    steps: int,
    pack: float,
    leaving: bool,
) -> Trace:
    t = near.clone()
    hit, exhausted = (torch.zeros_like(t, dtype=torch.bool) for _ in range(2))
    # those under way: their numbers, and what is needed of them, as columns
    index = (near < far).nonzero()[:, 0]
    o, d = (v.index_select(0, index).T.contiguous() for v in (origin, direction))
    along, end = t[index], far[index]
    under_way = torch.ones_like(index, dtype=torch.bool)
    last = torch.full_like(along, torch.inf)
    enough = torch.full_like(along, epsilon)
    for number in range(steps):
        if len(index) == 0:
            break
        # an ended ray that is not yet packed away stays where it is
        value = distance(torch.addcmul(o, d, along).T)
        if leaving and number == 0:
            enough = start_threshold(value, epsilon)
        last = torch.where(under_way, value, last)
        arrived = under_way & (value < enough)
        # the rest of the way of a ray that has arrived is shorter than epsilon
        along = torch.where(under_way, along + value.clamp(min=0.0), along)
        under_way = under_way & ~arrived & (along <= end)
        left = int(under_way.sum())
        if left == 0 or left <= pack * len(index):
            done = ~under_way
            where = index[done]
            t[where] = along[done]
            hit[where] = last[done] < enough[done]
            keep = under_way.nonzero()[:, 0]
            index, along, end, last, enough = (v[keep] for v in (index, along, end, last, enough))
            o, d = o.index_select(1, keep), d.index_select(1, keep)
            under_way = under_way[keep]
    t[index] = along
    exhausted[index] = under_way
    hit[index] = torch.where(under_way, last < NEARLY * epsilon, last < enough)
    return Trace(t, hit, exhausted)


def start_threshold(value: Float[Tensor, "N"], epsilon: float) -> Float[Tensor, "N"]:
    """The distance at which rays that start at ``value`` have arrived; one that starts inside has."""
    return torch.where(value > 0, (0.5 * value).clamp(max=epsilon), epsilon)


def box_interval(
    bounds: Box, origin: Float[Tensor, "N 3"], direction: Float[Tensor, "N 3"]
) -> tuple[Float[Tensor, "N"], Float[Tensor, "N"]]:
    """Where rays enter and leave a box, from the origin on; enter is not less than leave where they miss."""
    low, high = (torch.tensor(v, dtype=origin.dtype, device=origin.device) for v in bounds)
    # no division by zero, whose product with zero would be no number
    slow = direction.abs() < 1e-20
    inverse = torch.where(slow, torch.full_like(direction, 1e20), direction).reciprocal()
    inverse = torch.where(slow, torch.full_like(direction, 1e20), inverse)
    a, b = (low - origin) * inverse, (high - origin) * inverse
    return torch.minimum(a, b).amax(1).clamp(min=0.0), torch.maximum(a, b).amin(1)


def occluded(
    distance: Distance,
    bounds: Box,
    origin: Float[Tensor, "N 3"],
    direction: Float[Tensor, "N 3"],
    epsilon: float,
    steps: int = STEPS,
    chunk: int | None = None,
) -> tuple[Bool[Tensor, "N"], Bool[Tensor, "N"]]:
    """Whether something lies in unit directions, and whether the step limit was met (see :class:`Trace`).

    Args:
        bounds: a box that holds the whole surface; rays are followed within it only.
        origin: off the surface already.
        epsilon, steps, chunk: as in :func:`sphere_trace`.
    """
    near, far = box_interval(bounds, origin, direction)
    found = sphere_trace(distance, origin, direction, near, far, epsilon, steps, chunk=chunk, leaving=True)
    return found.hit, found.exhausted


def gradients(
    distance: Distance, position: Float[Tensor, "N 3"], chunk: int | None = None
) -> tuple[Float[Tensor, "N"], Float[Tensor, "N 3"]]:
    """The distance and its gradient by automatic differentiation, in chunks.

    Raises:
        PrtError: for a distance that torch cannot differentiate.
    """
    chunk = chunk or (GRADIENT_CHUNK if position.device.type == "cpu" else GPU_CHUNK)
    values, slopes = [position.new_zeros(0)], [position.new_zeros((0, 3))]
    for part in position.detach().split(chunk) if len(position) else ():
        with torch.enable_grad():
            where = part.T.contiguous().T.requires_grad_()
            value = distance(where)
            if not value.requires_grad:
                raise PrtError(
                    "the signed distance has no gradient: write it with torch operations on its argument, "
                    "without detach, numpy or no_grad"
                )
            slope = torch.autograd.grad(value.sum(), where)[0]
        values.append(value.detach())
        slopes.append(slope.detach())
    return torch.cat(values), torch.cat(slopes)


def normals(
    distance: Distance, position: Float[Tensor, "N 3"], chunk: int | None = None
) -> Float[Tensor, "N 3"]:
    """Unit outward normals: the direction of the gradient.

    Where automatic differentiation finds none (the square root of 0 at an edge gives NaN), it is taken from
    differences between four points around; +y where these are equal too.
    """
    slope = gradients(distance, position, chunk)[1]
    bad = ~(slope.square().sum(1) > 1e-12)
    if bad.any():
        slope[bad] = _differences(distance, position[bad])
    length = slope.norm(dim=1, keepdim=True)
    up = torch.tensor([0.0, 1.0, 0.0], dtype=slope.dtype, device=slope.device)
    return torch.where(length > 0, slope / length, up)


def _differences(distance: Distance, position: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Along the corners of a tetrahedron, which takes four evaluations rather than six (Quilez 2015)."""
    corner = position.new_tensor([[1, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]])
    step = 1e-3 * position.abs().amax(1, keepdim=True).clamp(min=1e-3)
    with torch.no_grad():
        return sum(k * distance(position + step * k)[:, None] for k in corner)  # type: ignore[return-value]

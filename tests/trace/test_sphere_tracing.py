"""Sphere tracing against closed forms; packing and chunks change nothing."""

import math

import pytest
import torch

from prt.errors import PrtError
from prt.trace.sphere_tracing import (
    STEPS,
    box_interval,
    gradients,
    normals,
    occluded,
    sphere_trace,
)

BOX = ((-1.5, -1.5, -1.5), (1.5, 1.5, 1.5))
EPSILON = 1e-5


def sphere(position, radius: float = 1.0):
    return position.norm(dim=1) - radius


def torus(position, radius: float = 0.9, tube: float = 0.35):
    x, y, z = position.unbind(1)
    around = (x * x + z * z).sqrt() - radius
    return (around * around + y * y).sqrt() - tube


def rays(count: int, seed: int = 0, distance: float = 4.0):
    """From a sphere around, towards points near the middle."""
    generator = torch.Generator().manual_seed(seed)
    origin = distance * torch.nn.functional.normalize(torch.randn((count, 3), generator=generator), dim=1)
    target = 2.4 * torch.rand((count, 3), generator=generator) - 1.2
    return origin, torch.nn.functional.normalize(target - origin, dim=1)


def test_a_sphere_is_hit_where_algebra_says():
    origin, direction = rays(20_000)
    near, far = box_interval(BOX, origin, direction)
    found = sphere_trace(sphere, origin, direction, near, far, EPSILON)
    o, d = origin.double(), direction.double()
    middle = -(o * d).sum(1)
    inside = 1 - (o + middle[:, None] * d).square().sum(1)
    # rays that pass within epsilon of the sphere count as hits
    clear = (1 - inside).sqrt() - 1
    sure = (clear < -1e-4) | (clear > 2 * EPSILON)
    assert ((inside > 0) == found.hit)[sure].all() and 0.2 < found.hit.float().mean() < 0.9
    there = found.hit & (inside > 1e-2)
    true = middle - inside.clamp(min=0).sqrt()
    assert (found.t - true)[there].abs().max() < 2e-4
    assert (found.t - true)[there].abs().mean() < EPSILON
    assert found.exhausted.float().mean() < 1e-3


@pytest.mark.parametrize("above, hit", [(1e-3, False), (1e-4, False), (-1e-4, True), (-1e-3, True)])
def test_rays_that_graze_a_sphere(above, hit):
    angle = torch.linspace(0, 2 * math.pi, 100)[:-1]
    origin = (1 + above) * torch.stack([torch.zeros_like(angle), angle.cos(), angle.sin()], 1)
    origin[:, 0] = -1.4
    direction = torch.tensor([[1.0, 0.0, 0.0]]).expand(len(origin), 3)
    found = sphere_trace(sphere, origin, direction, 0.0, 2.8, EPSILON, steps=256)
    assert (found.hit == hit).all()
    # closer still, they creep, and it is known that they did
    assert (found.exhausted == (abs(above) < 1e-3)).all()


def test_packing_and_chunks_change_nothing():
    origin, direction = rays(5000, seed=2)
    near, far = box_interval(BOX, origin, direction)
    plain = sphere_trace(torus, origin, direction, near, far, EPSILON, steps=20, pack=0.0)
    assert plain.exhausted.any() and plain.hit.any() and not plain.hit.all()
    for pack, chunk in ((0.75, None), (1.0, None), (0.5, 37)):
        packed = sphere_trace(torus, origin, direction, near, far, EPSILON, 20, pack, chunk)
        assert (packed.hit == plain.hit).all() and (packed.exhausted == plain.exhausted).all()
        assert (packed.t - plain.t).abs().max() < 1e-5


def test_rays_that_meet_the_step_limit_are_counted_not_lost():
    # 1e-3 above a floor and parallel to it: a thousand steps to the far end
    origin = torch.tensor([[0.0, 1e-3, 0.0], [0.0, 5e-5, 0.0], [0.0, 1.0, 0.0]])
    direction = torch.tensor([[1.0, 0.0, 0.0]]).expand(3, 3)
    found = sphere_trace(lambda p: p[:, 1], origin, direction, 0.0, 1.0, EPSILON, steps=50)
    assert found.exhausted.tolist() == [True, True, False]
    assert found.hit.tolist() == [False, True, False]  # the second is nearer than ten epsilons


def test_rays_beside_the_box_take_no_step():
    def never(position):
        raise AssertionError("evaluated")

    origin, direction = torch.tensor([[3.0, 3.0, 3.0]]), torch.tensor([[1.0, 0.0, 0.0]])
    blocked, exhausted = occluded(never, BOX, origin, direction, EPSILON)
    assert not blocked.any() and not exhausted.any()
    assert len(sphere_trace(never, origin[:0], direction[:0], 0.0, 1.0, EPSILON).t) == 0


def test_box_interval_of_axis_parallel_rays_on_the_box():
    origin = torch.tensor([[-1.5, 0.0, 0.0], [-1.5, 1.5, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    direction = torch.tensor([[1.0, 0.0, 0.0]]).expand(4, 3)
    near, far = box_interval(BOX, origin, direction)
    assert near.isfinite().all() and far.isfinite().all()
    assert near[[0, 2]].tolist() == [0.0, 0.0] and far[[0, 2]].tolist() == [3.0, 1.5]
    assert far[3] < near[3]


def test_rays_that_leave_a_sphere_are_free_and_rays_into_it_are_not():
    generator = torch.Generator().manual_seed(3)
    normal = torch.nn.functional.normalize(torch.randn((5000, 3), generator=generator), dim=1)
    other = torch.nn.functional.normalize(torch.randn((5000, 3), generator=generator), dim=1)
    cosine = (normal * other).sum(1)
    blocked, exhausted = occluded(sphere, BOX, 1.0002 * normal, other, EPSILON)
    sure = cosine.abs() > 0.03
    assert (blocked == (cosine < 0))[sure].all() and exhausted.float().mean() < 1e-2


def test_normals_of_a_sphere_and_where_the_gradient_is_undefined():
    position = torch.nn.functional.normalize(
        torch.randn((1000, 3), generator=torch.Generator().manual_seed(0)), dim=1
    )
    assert (normals(sphere, position, chunk=300) - position).abs().max() < 1e-6

    def slab(p):  # its square root is taken of 0 below y = 0.5
        return (p[:, 1] - 0.5).clamp(min=0.0).square().sqrt() + (p[:, 1] - 0.5).clamp(max=0.0)

    found = normals(slab, torch.tensor([[0.3, 0.4, 0.2], [0.0, 0.5, 0.0]]))
    assert (found - torch.tensor([0.0, 1.0, 0.0])).abs().max() < 1e-5


def test_impossible_settings_and_distances_are_refused():
    ray = torch.zeros((1, 3)), torch.tensor([[1.0, 0.0, 0.0]])
    with pytest.raises(PrtError, match="epsilon=0"):
        sphere_trace(sphere, *ray, 0.0, 1.0, 0.0)
    with pytest.raises(PrtError, match="steps=0"):
        sphere_trace(sphere, *ray, 0.0, 1.0, EPSILON, steps=0)
    with pytest.raises(PrtError, match="no gradient"):
        gradients(lambda p: p.detach().norm(dim=1), ray[0])
    assert STEPS >= 64

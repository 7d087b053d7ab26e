"""Matrices of places against what a wall of known brightness sends there."""

import math

import pytest
import torch
from trace_scenes import DictScene, diffuse

from prt.light.cubemap import texel_directions
from prt.light.sh import project, sh_basis
from prt.scene.mitsuba_setup import mitsuba
from prt.trace.record import prior_sampler
from prt.trace.vertex_matrices import hemisphere_directions, incident_matrices

R, DEGREE = 4, 3


def canopy(reflectance: float, half: float = 0.2):
    """A diffuse square at height 1 above the origin, facing down, and nothing else."""
    to_world = mitsuba().ScalarTransform4f().translate([0, 1, 0]).rotate([1, 0, 0], 90).scale(half)
    return DictScene({"canopy": {"type": "rectangle", "to_world": to_world, "bsdf": diffuse(reflectance)}})


def matrices(scene, paths: int = 1 << 14, max_depth: int = 3, sampler=None) -> torch.Tensor:
    origin = torch.tensor([[0.0, 0.0, 0.0], [0.0, -4.0, 0.0]])
    up = torch.tensor([[0.0, 1.0, 0.0]]).repeat(2, 1)
    return incident_matrices(scene.load(), origin, up, DEGREE, paths, max_depth, R, 5, sampler)


def test_a_small_square_sends_its_radiance_from_where_it_is():
    found = matrices(canopy(0.5))
    solid_angle = 4 * math.asin(0.2**2 / (1 + 0.2**2))
    arriving = found[0, 0] @ project(torch.ones(6, R, R, 1), DEGREE)
    # seen from below it is lit by half the sky: it sends on half of radiance 1
    expected = 0.5 * solid_angle * sh_basis(torch.tensor([[0.0, 1.0, 0.0]]), DEGREE)[0]
    # it is no point: the upper bands are a little smaller
    assert (arriving[:, 0] - expected).abs().max() < 0.1 * expected.abs().max()
    assert float(arriving[0, 0]) == pytest.approx(float(expected[0]), rel=0.03)
    # light from above does not reach its lower side
    from_above = (texel_directions(R)[..., 1] > 0).float()[..., None]
    lit = [found[0, 0] @ project(side, DEGREE) for side in (from_above, 1 - from_above)]
    assert lit[0][0].abs() < 0.1 * lit[1][0]
    # from five times as far it is a twenty-fifth as large
    assert float(found[1, 0, 0, 0] / found[0, 0, 0, 0]) * 25 < 1.3
    assert torch.equal(found[:, 0], found[:, 2])


def test_what_leaves_at_once_is_left_out_and_so_is_what_is_absorbed():
    assert matrices(canopy(0.0), 64).abs().max() == 0


def test_next_event_samples_estimate_the_same():
    sampler = prior_sampler(torch.ones(6, R, R, 3))
    scene = canopy(0.5, half=2.0)
    plain, sampled = (matrices(scene, sampler=s)[0, :, :4, :4] for s in (None, sampler))
    assert (plain - sampled).norm() < 0.03 * plain.norm()


def test_directions_are_even_over_the_hemisphere():
    normal = torch.nn.functional.normalize(torch.tensor([[0.3, -0.8, 0.2], [0.0, 0.0, 1.0]]), dim=1)
    d = hemisphere_directions(normal, 2048, torch.rand((2, 1, 2), generator=torch.Generator().manual_seed(0)))
    assert torch.allclose(d.norm(dim=2), torch.ones(2, 2048), atol=1e-5)
    height = (d * normal[:, None]).sum(2)
    assert height.min() >= -1e-6
    assert torch.allclose(d.mean(1), normal / 2, atol=2e-3)
    assert torch.allclose(height.square().mean(1), torch.full((2,), 1 / 3), atol=1e-3)
    assert math.isclose(float(height.mean()), 0.5, abs_tol=1e-3)

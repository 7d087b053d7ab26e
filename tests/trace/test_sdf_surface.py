"""Surfaces of signed distances: even samples, rays in torch and in Dr.Jit, what a camera sees."""

import math
import types

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.scene.lightmap_points import OFFSET
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace.sdf_surface import SdfSurface
from prt.trace.surface import Surface
from prt.trace.transfer import bake

RADIUS, TUBE = 0.7, 0.25


def root(value):
    if isinstance(value, torch.Tensor):
        return value.sqrt()
    import drjit as dr

    return dr.sqrt(value)


def sphere(x, y, z):
    return root(x * x + y * y + z * z) - 0.8


def torus(x, y, z):
    around = root(x * x + z * z) - RADIUS
    return root(around * around + y * y) - TUBE


def scene(formula, reach: float = 1.0):
    """What SdfSurface asks of a scene."""
    return types.SimpleNamespace(
        name="test",
        distance=lambda position: formula(*position.unbind(1)),
        sdf=formula,
        bounds=((-reach, -reach, -reach), (reach, reach, reach)),
        albedo=(0.5, 0.6, 0.7),
        fingerprint=lambda: {"formula": formula.__name__},
    )


def chi_square(counts, expected) -> float:
    """The statistic per degree of freedom: about 1 for independent draws, below it for stratified ones."""
    return float(((counts - expected) ** 2 / expected).sum() / (len(counts) - 1))


def leaving(surface, count: int, seed: int = 0):
    """Points of the surface and directions on their outer side."""
    points = surface.sample(count, seed)
    generator = torch.Generator().manual_seed(seed)
    random = torch.nn.functional.normalize(torch.randn((count, 3), generator=generator), dim=1)
    direction = torch.nn.functional.normalize(points.normal + 0.999 * random, dim=1)
    return points.position + OFFSET * surface.extent * points.normal, direction


def dr_blocked(surface, origin, direction):
    mi = mitsuba()
    o, d = (np.ascontiguousarray(v.numpy().T) for v in (origin, direction))
    return torch.from_numpy(np.array(surface.blocked(mi.Point3f(o), mi.Vector3f(d))))


def test_it_is_a_surface():
    surface = SdfSurface(scene(torus), cells=24)
    assert isinstance(surface, Surface)
    assert surface.extent == pytest.approx(math.sqrt(3)) and surface.bounds[1] == (1.0, 1.0, 1.0)
    other = SdfSurface(scene(torus), cells=32)
    assert surface.fingerprint() != other.fingerprint()


def test_samples_of_a_sphere_are_even():
    surface = SdfSurface(scene(sphere), cells=48)
    points = surface.sample(20_000, 0)
    assert (points.position.norm(dim=1) - 0.8).abs().max() < surface.epsilon
    assert (points.normal - points.position / 0.8).abs().max() < 1e-4
    # equal slices of height hold equal areas (Archimedes), as do equal angles
    slices = torch.histc(points.position[:, 1], 40, -0.8, 0.8).numpy()
    assert chi_square(slices, np.full(40, 500.0)) < 1.5
    angle = torch.atan2(points.position[:, 0], points.position[:, 2])
    assert chi_square(torch.histc(angle, 40, -math.pi, math.pi).numpy(), np.full(40, 500.0)) < 1.5
    assert not torch.equal(points.position, surface.sample(20_000, 1).position)
    assert torch.equal(points.position, surface.sample(20_000, 0).position)
    assert surface.counts["dropped_samples"] == 0


def test_samples_of_a_torus_are_even():
    points = SdfSurface(scene(torus), cells=48).sample(20_000, 0)
    x, y, z = points.position.unbind(1)
    about = torch.atan2(y, (x * x + z * z).sqrt() - RADIUS)
    edges = np.linspace(-math.pi, math.pi, 33)
    # area between two angles about the tube: the integral of R + r cos
    expected = np.diff(RADIUS * edges + TUBE * np.sin(edges)) / (2 * math.pi * RADIUS) * 20_000
    assert chi_square(np.histogram(about.numpy(), edges)[0], expected) < 1.5


def test_samples_that_do_not_arrive_are_drawn_again_and_counted():
    def jump(x, y, z):  # changes sign at x = 0.5 without a zero
        return torch.where(x > 0.5, sphere(x, y, z) + 0.05, sphere(x, y, z))

    surface = SdfSurface(scene(jump), cells=32)
    points = surface.sample(2000, 0)
    assert surface.counts["dropped_samples"] > 0
    assert surface.scene.distance(points.position).abs().max() < surface.epsilon


def test_dr_jit_says_the_same_as_torch():
    surface = SdfSurface(scene(torus), cells=32)
    origin, direction = leaving(surface, 20_000)
    found = surface.occluded(origin, direction)
    assert 0.02 < found.float().mean() < 0.3
    exhausted = surface.counts["exhausted_rays"]
    assert (dr_blocked(surface, origin, direction) != found).float().mean() < 1e-4
    assert surface.counts["exhausted_rays"] == pytest.approx(2 * exhausted, abs=5)
    # rays that start beside the box, or look away from it
    away = torch.tensor([[3.0, 0.0, 0.0], [3.0, 0.1, 0.2]]), torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    assert dr_blocked(surface, *away).tolist() == surface.occluded(*away).tolist() == [False, True]


def flat_sphere(x, y, z):
    """A bound whose gradient is 0.05: off the surface by an offset, it is still below epsilon."""
    return 0.05 * sphere(x, y, z)


def test_a_bound_that_grows_slowly_does_not_shadow_itself():
    surface = SdfSurface(scene(flat_sphere))
    origin, direction = leaving(surface, 400)
    assert (surface.scene.distance(origin) < surface.epsilon).all()
    assert not surface.occluded(origin, direction).any()
    assert not dr_blocked(surface, origin, direction).any()
    inward = -torch.nn.functional.normalize(origin, dim=1)
    assert surface.occluded(origin, inward).all()
    assert dr_blocked(surface, origin, inward).all()


def test_both_count_the_rays_that_meet_the_step_limit():
    torch_surface, dr_surface = (SdfSurface(scene(torus), cells=32, steps=8) for _ in range(2))
    origin, direction = leaving(torch_surface, 5000)
    found = torch_surface.occluded(origin, direction)
    count = torch_surface.counts["exhausted_rays"]
    assert count > 500
    assert (dr_blocked(dr_surface, origin, direction) != found).float().mean() < 1e-3
    assert dr_surface.counts["exhausted_rays"] == pytest.approx(count, rel=1e-2)


def test_transfer_in_one_kernel_is_transfer_by_rays():
    fused, plain = (SdfSurface(scene(torus), cells=32) for _ in range(2))
    plain.scene.sdf = None
    assert plain.blocked is None
    points = fused.sample(500, 0)
    found = [bake(s, points.position, points.normal, 3, 16, seed=0) for s in (fused, plain)]
    assert (found[0] - found[1]).abs().max() < 1e-5
    # nothing but a fraction of the rays is blocked
    assert 0.7 < float((found[0][:, 0] / 0.28209479).mean()) < 0.99


def test_capture_of_a_sphere():
    surface = SdfSurface(scene(sphere), cells=16)
    view = View((0.0, 1.0, 4.0), (0.0, 0.0, 0.0), fov=40.0, width=48, height=32)
    seen = surface.capture(view)
    assert int(seen.hit.sum()) == len(seen) and seen.hit.numel() == 48 * 32
    assert (seen.position.norm(dim=1) - 0.8).abs().max() < 2 * surface.epsilon
    assert ((seen.normal * seen.wo).sum(1) >= -1e-6).all()
    assert (seen.normal - seen.position / 0.8).abs().max() < 2e-2
    towards = torch.tensor(view.origin) - seen.position
    assert (seen.wo - torch.nn.functional.normalize(towards, dim=1)).abs().max() < 1e-5
    assert torch.equal(seen.diffuse, torch.tensor([0.5, 0.6, 0.7]).expand(len(seen), 3))
    assert not seen.specular.any() and (seen.roughness == 1).all() and seen.uv.shape == (len(seen), 2)
    # the disk that a sphere of radius 0.8 covers from a distance of sqrt(17)
    share = math.pi * 0.8**2 / (17 - 0.8**2) / (4 * view.half_width**2 * 32 / 48)
    assert float(seen.hit.float().mean()) == pytest.approx(share, rel=0.05)
    away = surface.capture(View((0.0, 1.0, 4.0), (0.0, 1.0, 8.0), width=8, height=8))
    assert len(away) == 0 and not away.hit.any()


@pytest.mark.parametrize(
    "formula, words",
    [
        (lambda x, y, z: sphere(x, y, z) + 2.0, "holds no surface"),
        (lambda x, y, z: sphere(x, y, z) - 9.0, "holds no surface"),
        (lambda x, y, z: sphere(x, y, z) / (x - x), "not finite"),
    ],
)
def test_without_a_zero_set_there_is_one_line(formula, words):
    with pytest.raises(PrtError, match=words) as error:
        SdfSurface(scene(formula), cells=16).sample(10, 0)
    assert "\n" not in str(error.value)


def test_settings_out_of_range_are_refused():
    with pytest.raises(PrtError, match="cells=4"):
        SdfSurface(scene(sphere), cells=4)
    with pytest.raises(PrtError, match="steps=0"):
        SdfSurface(scene(sphere), steps=0)
    with pytest.raises(PrtError, match="no box"):
        SdfSurface(scene(sphere, reach=-1.0))

"""Secondary rays of near-mirrors against the renderer's own path tracing, and against furnaces."""

import numpy as np
import pytest
import torch
from mirror_scenes import BELOW, VIEW, MirrorScene, bounced, box, diffuse, floor, metal, twosided
from trace_scenes import DictScene, lightings

from prt.scene.capture import capture
from prt.scene.gbuffer import GBuffer
from prt.scene.mitsuba_setup import mitsuba
from prt.trace.cubemap_emitter import scene_with_lighting, set_lighting
from prt.trace.reference import ReferenceRenderer
from prt.trace.secondary import Draws, reflections

RESOLUTION = 4
LIGHTINGS = lightings(RESOLUTION)


def mirrors_of(mi_scene, view=VIEW, below=BELOW) -> GBuffer:
    gbuffer = capture(mi_scene, view)
    return gbuffer.rows((gbuffer.roughness[:, 0] < below).nonzero()[:, 0])


def traced(mi_scene, points, rays=4, light_samples=2, bounces=4, below=BELOW, seed=0):
    names = torch.arange(len(points))
    return reflections(mi_scene, points, names, None, below, rays, light_samples, bounces, seed)


@pytest.mark.parametrize(("name", "noise"), [("constant", 0.05), ("one texel", 0.3)])
def test_with_the_true_light_of_what_is_mirrored_the_image_is_the_reference(name, noise):
    scene, depth = MirrorScene(max_depth=4), 4
    renderer = ReferenceRenderer(scene, RESOLUTION)
    set_lighting(renderer.mi_scene, LIGHTINGS[name])
    points = mirrors_of(renderer.mi_scene)
    assert len(points) > 25
    found = traced(renderer.mi_scene, points, rays=48, light_samples=8)
    # a path of 4 bounces has 3 at most from x2 on
    ours = found.total(bounced(renderer.mi_scene, found.points, depth - 1, 24, 1))
    truth = bounced(renderer.mi_scene, points, depth, 2000, 2)
    assert found.found.all()
    assert ours.mean() == pytest.approx(float(truth.mean()), rel=0.03)
    # one texel mirrored by the floor makes caustics, which both find by chance
    assert (ours - truth).norm() / truth.norm() < noise


def test_the_image_of_a_view_is_the_reference_edges_and_all():
    """Pixels that the floor covers in part: rays start all over the pixel, as those of a reference do."""
    renderer = ReferenceRenderer(MirrorScene(max_depth=4), RESOLUTION)
    reference = renderer.render(VIEW, LIGHTINGS["constant"], 2000, 1)["indirect"].reshape(-1, 3)
    gbuffer = capture(renderer.mi_scene, VIEW)
    rows = (gbuffer.roughness[:, 0] < BELOW).nonzero()[:, 0]
    points, names = gbuffer.rows(rows), gbuffer.hit.nonzero()[:, 0][rows]
    found = reflections(renderer.mi_scene, points, names, VIEW, BELOW, 64, 8, 4, 0)
    ours = found.total(bounced(renderer.mi_scene, found.points, 3, 24, 1))
    assert (found.points.position[:, 2] < -0.9).any(), "the wall, which some of these pixels see directly"
    assert ours.mean() == pytest.approx(float(reference[names].mean()), rel=0.03)
    # places in a pixel are few at its edges
    assert (ours - reference[names]).norm() / reference[names].norm() < 0.08


def test_two_bounces_need_no_network():
    """All of it is direct light at what is mirrored: without noise to speak of at a smooth mirror."""
    renderer = ReferenceRenderer(MirrorScene(max_depth=2, sigma=0.02), RESOLUTION)
    for lighting in LIGHTINGS.values():
        set_lighting(renderer.mi_scene, lighting)
        points = mirrors_of(renderer.mi_scene)
        known = traced(renderer.mi_scene, points, rays=64, light_samples=16).known
        truth = bounced(renderer.mi_scene, points, 2, 2000, 3)
        assert known.mean() == pytest.approx(float(truth.mean()), rel=0.03)
        assert (known - truth).norm() / truth.norm() < 0.1


def test_a_chain_of_mirrors_is_followed_to_what_is_none():
    """The box over the mirror is a mirror too: what it shows is the wall, the floor, and the sky."""
    renderer = ReferenceRenderer(MirrorScene(max_depth=6, above=metal(0.1)), RESOLUTION)
    set_lighting(renderer.mi_scene, LIGHTINGS["contrast"])
    points = mirrors_of(renderer.mi_scene)
    found = traced(renderer.mi_scene, points, rays=64, light_samples=4)
    # few paths are longer than four mirrors in a row; those are asked at a mirror
    ended_at_mirrors = (found.points.roughness < BELOW).float().mean()
    assert 0 <= ended_at_mirrors < 0.05
    ours = found.total(bounced(renderer.mi_scene, found.points, 4, 16, 1))
    truth = bounced(renderer.mi_scene, points, 6, 2000, 2)
    assert ours.mean() == pytest.approx(float(truth.mean()), rel=0.04)
    short = traced(renderer.mi_scene, points, rays=64, light_samples=4, bounces=1)
    assert (short.points.roughness < BELOW).float().mean() > 0.2
    ours = short.total(bounced(renderer.mi_scene, short.points, 5, 16, 1))
    assert ours.mean() == pytest.approx(float(truth.mean()), rel=0.04)


def test_rays_that_escape_add_nothing():
    """A mirror alone under a bright sky has direct light only."""
    mi_scene = scene_with_lighting(DictScene({"floor": floor(metal(0.05))}), LIGHTINGS["constant"])
    points = mirrors_of(mi_scene)
    found = traced(mi_scene, points)
    assert found.found.all() and len(points) > 20
    assert len(found.points) == 0
    assert torch.equal(found.total(torch.zeros(0, 3)), torch.zeros(len(points), 3))


def test_a_white_furnace_is_white():
    """Everything reflects all light under a sky of 1: at every point of a mirror all radiance is 1."""
    white = {"type": "conductor", "material": "none"}
    shapes = {"floor": floor(twosided(white)), "box": box(diffuse(1.0), [0, 0.6, 0], 0.3)}
    mi_scene = scene_with_lighting(DictScene(shapes), LIGHTINGS["constant"])
    points = mirrors_of(mi_scene)
    found = traced(mi_scene, points, rays=64, light_samples=8)
    # light that bounces on is what direct light leaves of 1, which an ideal network gives
    met = torch.zeros(len(points)).index_add_(0, found.pixel, found.weight[:, 0])
    assert (met - met.round()).abs().max() < 1e-4, "a smooth mirror's rays all go one way"
    bounces = bounced(mi_scene, found.points, 60, 8, 1)
    total = found.total(bounces)[met > 0.5]
    assert len(total) > 4
    assert total.mean() == pytest.approx(1.0, abs=0.03)


def test_equal_seeds_give_equal_rays_and_others_do_not():
    mi_scene = scene_with_lighting(MirrorScene(4), LIGHTINGS["contrast"])
    points = mirrors_of(mi_scene)
    one, same, other = (traced(mi_scene, points, seed=seed) for seed in (3, 3, 4))
    assert torch.equal(one.known, same.known)
    assert torch.equal(one.points.position, same.points.position)
    assert not torch.equal(one.known, other.known)


def test_a_pixel_has_its_own_rays_whatever_is_traced_beside_it():
    mi_scene = scene_with_lighting(MirrorScene(4), LIGHTINGS["contrast"])
    points = mirrors_of(mi_scene)
    names = torch.arange(len(points))
    whole = reflections(mi_scene, points, names, None, BELOW, 4, 2, 4, 0)
    part = reflections(mi_scene, points.rows(names[5:9]), names[5:9], None, BELOW, 4, 2, 4, 0)
    assert torch.equal(part.known, whole.known[5:9])


def test_points_of_no_surface_are_not_found():
    mi_scene = scene_with_lighting(MirrorScene(4), LIGHTINGS["constant"])
    points = mirrors_of(mi_scene).rows(torch.arange(6))
    points.position[2] += torch.tensor([0.0, 0.5, 0.0])
    found = traced(mi_scene, points)
    assert found.found.tolist() == [True, True, False, True, True, True]
    assert not (found.pixel == 2).any()
    assert torch.equal(found.known[2], torch.zeros(3))


def test_other_points_lights_and_seeds_compile_nothing():
    import drjit as dr

    mi_scene = scene_with_lighting(MirrorScene(4), LIGHTINGS["contrast"])
    points = mirrors_of(mi_scene)
    traced(mi_scene, points)
    # a part of the surfaces may be met, and the kernels that read materials are of those
    traced(mi_scene, points.rows(torch.arange(3, 20)))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        set_lighting(mi_scene, LIGHTINGS["one texel"])
        traced(mi_scene, points.rows(torch.arange(len(points) - 5)), seed=9)
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert len(kernels) > 5
    assert all(kernel["cache_hit"] for kernel in kernels)


def test_no_points_are_no_rays():
    mi_scene = scene_with_lighting(MirrorScene(4), LIGHTINGS["constant"])
    found = traced(mi_scene, mirrors_of(mi_scene).rows(torch.arange(0)))
    assert len(found.known) == len(found.points) == len(found.found) == 0


def test_light_comes_through_masks():
    """A sheet with holes everywhere casts no shadow, and is no surface that a mirror shows."""
    hole = {"type": "mask", "opacity": 0.0, "nested": diffuse(0.5)}
    above = mitsuba().ScalarTransform4f().translate([0, 1.4, 0]).rotate([1, 0, 0], 90).scale(5.0)
    covered = MirrorScene(3, others={"sheet": {"type": "rectangle", "to_world": above, "bsdf": hole}})
    found = {}
    for name, scene in (("open", MirrorScene(3)), ("covered", covered)):
        mi_scene = scene_with_lighting(scene, LIGHTINGS["constant"])
        found[name] = traced(mi_scene, mirrors_of(mi_scene), rays=64, light_samples=2)
    assert len(found["open"].points) == len(found["covered"].points)
    assert found["covered"].known.mean() == pytest.approx(float(found["open"].known.mean()), rel=0.03)


@pytest.mark.parametrize("parts", [1, 3])
def test_numbers_are_uniform_and_those_of_a_pixel_are_spread(parts):
    import drjit as dr

    mi = mitsuba()
    pixels, rays = 4000, 4
    number = dr.arange(mi.UInt32, pixels * rays)
    draws = Draws(number // rays, number % rays, rays, 5)
    dr.eval(number)
    pairs = np.stack([np.array(draws.two(part, parts)) for part in range(parts)])
    line = np.array(draws.one())
    for values in (*pairs.reshape(-1, pixels * rays), line):
        assert values.min() >= 0 and values.max() < 1
        assert np.histogram(values, 8, (0, 1))[0].std() / (pixels * rays / 8) < 0.05
    first = np.sort(pairs[:, 0].reshape(parts, pixels, rays).transpose(1, 0, 2).reshape(pixels, -1), axis=1)
    gaps = np.diff(first, axis=1)
    assert np.allclose(gaps, 1 / (rays * parts), atol=1e-5)
    # which of a pixel's places goes with which is anew at every dimension
    line, again = (np.array(draws.one()).reshape(pixels, rays) for _ in range(2))
    same = np.argsort(np.argsort(line, axis=1), axis=1) == np.argsort(np.argsort(again, axis=1), axis=1)
    assert same.mean() == pytest.approx(1 / rays, abs=0.02)

"""Rays of dynamic radiosity against cases with a known answer: white furnaces, mirrors, glass, lamps."""

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba
from prt.trace.radiance_rays import follow, make_sampler, right_hand_side
from prt.trace.surface_states import SurfaceStates, triangle_areas


def sphere(bsdf, radius=1.0, **more):
    return {"type": "sphere", "radius": radius, "bsdf": bsdf, **more}


def diffuse(value):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [value] * 3}}


def lit(shapes, radiance=1.0):
    light = {"type": "constant", "radiance": {"type": "rgb", "value": [radiance] * 3}}
    return mitsuba().load_dict({"type": "scene", "light": light, **shapes})


def room():
    """Diffuse boxes and a rough metal ball under a small lamp."""
    mi = mitsuba()
    scene = mi.cornell_box()
    for name in ("sensor", "integrator"):
        scene.pop(name, None)
    metal = {"type": "roughconductor", "alpha": 0.3}
    scene["ball"] = {"type": "sphere", "radius": 0.3, "center": [0.4, -0.6, 0.5], "bsdf": metal}
    return mi.load_dict(scene)


def rays(count, origin=(0.0, 0.0, 5.0), seed=0):
    """From a point toward the unit ball."""
    mi = mitsuba()
    rng = np.random.default_rng(seed)
    target = rng.uniform(-0.5, 0.5, (count, 3))
    direction = target - np.asarray(origin)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    start = np.tile(np.asarray(origin), (count, 1))
    return mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32)))


@pytest.mark.parametrize("sampling", ["bsdf", "uniform"])
@pytest.mark.parametrize("emitters", [True, False])
def test_a_convex_body_in_a_furnace_reflects_its_albedo(sampling, emitters):
    scene = lit({"ball": sphere(diffuse(0.6))})
    si, count = SurfaceStates(scene).sample(4000, 1)
    points = right_hand_side(scene, si, count, 16, 2, sampling, emitters)
    values = torch.ones((len(points.points), 3))
    mean = points.total(values).mean(0)
    # half of the points lie on the inside, where all that is seen is the network's 1; one-sided BSDFs give 0
    outside = np.array(si.wi.z) > 0
    assert mean == pytest.approx([0.6 * outside.mean()] * 3, rel=0.02)


def test_three_estimates_of_one_integral_agree():
    scene = room()
    si, count = SurfaceStates(scene).sample(3000, 3)
    totals = []
    for sampling, emitters, samples in (("bsdf", True, 64), ("bsdf", False, 256), ("uniform", True, 128)):
        found = right_hand_side(scene, si, count, samples, 5, sampling, emitters)
        # any function of the place will do in place of the network
        values = 0.5 + 0.4 * torch.sin(3 * found.points.position)
        totals.append(found.total(values).mean(0))
    torch.testing.assert_close(totals[1], totals[0], rtol=0.02, atol=0)
    torch.testing.assert_close(totals[2], totals[0], rtol=0.02, atol=0)


def test_a_mirror_is_followed_and_not_asked():
    mirror = {"type": "conductor", "material": "none"}
    scene = lit({"ball": sphere(mirror)}, radiance=0.7)
    found = follow(scene, rays(500), 500, 0)
    assert len(found.points) == 0
    torch.testing.assert_close(found.known, torch.full((500, 3), 0.7))


def test_glass_splits_nothing_and_loses_nothing():
    scene = lit({"ball": sphere({"type": "dielectric"})})
    found = follow(scene, rays(4000), 4000, 1)
    assert len(found.points) == 0
    # radiance is scaled by the square of the index inside and back again; long inner chains are cut
    assert found.known.mean() == pytest.approx(1.0, abs=0.01)


def test_a_plastic_is_asked_for_its_body_and_followed_for_its_coat():
    coat = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.0] * 3}}
    scene = lit({"ball": sphere(coat)})
    found = follow(scene, rays(2000), 2000, 1)
    assert sorted(found.points.path.tolist()) == list(range(2000))
    # Fresnel's share, between normal incidence (0.04) and grazing
    assert 0.038 < found.known.mean() < 0.3
    body = torch.full((len(found.points), 3), 0.5)
    torch.testing.assert_close(found.total(body), found.known + 0.5)


def test_what_is_behind_a_mask_shows_by_its_transparency():
    mask = {"type": "mask", "opacity": 0.25, "nested": {"type": "twosided", "bsdf": diffuse(0.5)}}
    sheet = {"type": "rectangle", "to_world": mitsuba().ScalarTransform4f().scale(9.0), "bsdf": mask}
    scene = lit({"sheet": sheet})
    found = follow(scene, rays(3000), 3000, 1)
    assert found.known.mean() == pytest.approx(0.75, abs=0.02)


def test_points_lie_evenly_on_all_shapes_and_on_the_sides_that_are_seen():
    mi = mitsuba()
    big = mi.ScalarTransform4f().scale(2.0)
    shapes = {
        "cube": {"type": "cube", "to_world": big, "bsdf": diffuse(0.5)},
        "ball": sphere(diffuse(0.5), radius=2.0, center=[9.0, 0.0, 0.0]),
    }
    scene = lit(shapes)
    si, count = SurfaceStates(scene).sample(6000, 0)
    assert count == 6000
    x = np.array(si.p.x)
    cube, ball = 6 * 16.0, 4 * np.pi * 4
    assert (x > 5).mean() == pytest.approx(ball / (cube + ball), abs=0.01)
    from prt.scene.view import View

    view = View((0.0, 3.0, 30.0), (4.0, 0.0, 0.0), (0.0, 1.0, 0.0), 50.0, 64, 64)
    seen = SurfaceStates(scene, [view])
    si, count = seen.sample(2000, 0)
    assert (np.array(si.wi.z) > 0).all(), "no one sees the insides"


def test_shapes_of_other_scenes_that_cannot_be_sampled_do_no_harm(tmp_path):
    (tmp_path / "hair.txt").write_text("0 0 0 0.1\n0 1 0 0.1\n0 2 0 0.1\n0 3 0 0.1\n")
    other = mitsuba().load_dict({"type": "bsplinecurve", "filename": str(tmp_path / "hair.txt")})
    scene = lit({"ball": sphere(diffuse(0.5))})
    assert SurfaceStates(scene).sample(100, 0)[1] == 100
    assert other.class_name()


def test_points_follow_a_shape_that_moves():
    mi = mitsuba()
    scene = lit({"cube": {"type": "cube", "bsdf": diffuse(0.5)}})
    surface = SurfaceStates(scene)
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.endswith("vertex_positions"))
    moved = np.array(params[key]).reshape(-1, 3) + [5.0, 0.0, 0.0]
    params[key] = mi.Float(moved.astype(np.float32).ravel())
    params.update()
    si, _ = surface.sample(500, 0)
    x = np.array(si.p.x)
    assert x.min() > 3.99 and x.max() < 6.01
    assert triangle_areas(scene.shapes()[0]).sum() == pytest.approx(24.0)


def test_seeds_repeat_and_differ():
    a, b, c = (np.array(make_sampler(seed, 8).next_1d()) for seed in (1, 1, 2))
    assert (a == b).all() and (a != c).any()


def test_settings_out_of_range_are_refused():
    scene = lit({"ball": sphere(diffuse(0.5))})
    si, count = SurfaceStates(scene).sample(8, 0)
    with pytest.raises(PrtError, match="sampling='cosine' is not one of bsdf, uniform"):
        right_hand_side(scene, si, count, 4, 0, "cosine")
    with pytest.raises(PrtError, match="at least 1"):
        right_hand_side(scene, si, count, 0, 0)


def test_colours_are_those_of_the_surface_whatever_its_lobes():
    """Of matt paint its reflectance; of a rough metal with a texture the texture, from every side."""
    values = {
        "type": "checkerboard",
        "color0": 0.2,
        "color1": 0.8,
        "to_uv": mitsuba().ScalarTransform4f().scale([4, 4, 1]),
    }
    smooth = {"type": "roughconductor", "alpha": 0.1, "specular_reflectance": values, "material": "none"}
    for bsdf, allowed in ((diffuse(0.3), [0.3]), ({"type": "twosided", "bsdf": smooth}, [0.2, 0.8])):
        scene = lit({"ball": sphere(bsdf)})
        albedo = follow(scene, rays(400), 400, 1).points.albedo[:, 0]
        near = (albedo[:, None] - torch.tensor(allowed)).abs().amin(dim=1)
        # the middle of a lobe loses a little to shadowing
        assert float(near.quantile(0.9)) < 0.03, bsdf
        assert all(bool(((albedo - value).abs() < 0.03).any()) for value in allowed)

"""Lightmaps, images and shadows of an asset under light rigs, against Mitsuba's own and known answers."""

import math

import numpy as np
import pytest
import torch
from mitsuba_lights import mitsuba_light

from prt.light.local import LightRig, LocalLight
from prt.scene.cornell_box import CornellBox
from prt.scene.mitsuba_file import MitsubaScene
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace.measure import SKY, Meter, averaged
from prt.trace.rig import LitAsset

CAMERA = View((0.0, 0.9, 2.5), (0.0, 0.5, 0.0), width=24, height=24)
LIGHTS = [
    LocalLight("point", (3.0, 2.0, 1.0), position=(0.4, 1.6, 0.6)),
    LocalLight("spot", (5.0, 5.0, 4.0), position=(-0.5, 1.7, 0.8), direction=(0.3, -0.9, -0.316),
               cutoff=50.0, beam=30.0),
    LocalLight("directional", (1.0, 1.5, 2.0), direction=(-0.36, -0.8, -0.48)),
]  # fmt: skip


def shape(kind, **more):
    return {
        "type": kind,
        "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", **more.pop("bsdf", {})}},
        **more,
    }


@pytest.fixture(scope="module")
def corner():
    """A floor and a box on it, open above."""
    mi = mitsuba()
    up = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(1.5)
    box = mi.ScalarTransform4f().translate([0.3, 0.3, -0.2]).scale(0.3)
    content = {"floor": shape("rectangle", to_world=up), "box": shape("cube", to_world=box)}
    return MitsubaScene("corner", content, _cameras(CAMERA), max_depth=4).asset(32)


def _cameras(view):
    def one(places):
        return [view for _ in places]

    return {"train": [one], "far": [one]}


@pytest.mark.parametrize("lights", [(0,), (1,), (2,), (0, 1, 2)])
def test_images_are_those_of_mitsubas_own_emitters(corner, lights):
    mi = mitsuba()
    chosen = [LIGHTS[i] for i in lights]
    lit = LitAsset(corner)
    found = lit.render(LightRig(tuple(chosen)), CAMERA, 1024, 1)
    scene = corner.load({f"light{i}": mitsuba_light(light) for i, light in enumerate(chosen)})
    from prt.trace.reference import component_integrators, render_components

    truth = render_components(scene, component_integrators(4), CAMERA, 1024, 2)
    for part in ("direct", "indirect"):
        assert float(found[part].mean()) == pytest.approx(float(truth[part].mean()), rel=0.05)
        assert float((found[part] - truth[part]).abs().mean() / truth[part].mean()) < 0.25
    assert mi is not None


def test_lights_change_in_place(corner):
    lit = LitAsset(corner)
    first = lit.lit(LightRig((LIGHTS[0],)))
    one = lit.render(LightRig((LIGHTS[0],)), CAMERA, 16, 1)["direct"]
    assert lit.lit(LightRig((LIGHTS[1], LIGHTS[2]))) is first  # nothing was loaded again
    lit.render(LightRig((LIGHTS[1],)), CAMERA, 16, 1)
    assert torch.equal(lit.render(LightRig((LIGHTS[0],)), CAMERA, 16, 1)["direct"], one)
    assert float(lit.render(LightRig(), CAMERA, 16, 1)["full"].max()) == 0


@pytest.mark.parametrize("max_depth", [2, 3, None])
def test_a_lightmap_is_what_cameras_see(max_depth):
    """Diffuse surfaces: lightmap times albedo is the indirect radiance of any view, bounce by bounce."""
    asset = _cornell().asset(48)
    lit, rig = LitAsset(asset, max_depth=max_depth), LightRig((LIGHTS[0],))
    values = lit.lightmap(rig, asset.sites(), 256, 3)
    view = asset.scene.views("far", 1, 24)[0]
    gbuffer = asset.capture(lit.dark, view)
    height, width = asset.size
    row, column = (gbuffer.uv[:, 1] * height).long(), (gbuffer.uv[:, 0] * width).long()
    place = row.clamp(max=height - 1) * width + column.clamp(max=width - 1)
    found = gbuffer.image(values[asset.fill[place]] * (gbuffer.diffuse + gbuffer.specular))
    truth = lit.render(rig, view, 256, 4)["indirect"]
    assert float(found.mean()) == pytest.approx(float(truth.mean()), rel=0.02)
    blocks = [image.view(6, 4, 6, 4, 3).mean((1, 3)) for image in (found, truth)]
    assert float((blocks[0] - blocks[1]).abs().mean() / blocks[1].mean()) < 0.06


def _cornell():
    from prt.bench.build import build
    from prt.bench.compose import compose

    cfg = compose(["task=local_lights", "lighting=spots_inside", "scene=cornell_box", "method=svd_transfer"])
    scene = build(cfg, "scene")
    assert isinstance(scene, CornellBox)
    return scene


def test_inside_a_closed_sphere_light_is_even():
    """A lamp in the middle of a diffuse sphere of radius R and albedo a: every point receives E0 directly,
    and a E0 / (1 - a) after any number of reflections, whatever the place."""
    albedo = 0.5
    ball = shape(
        "sphere", radius=1.0, flip_normals=True, bsdf={"reflectance": {"type": "rgb", "value": albedo}}
    )
    view = View((0.0, 0.0, 0.5), (0.0, 0.0, -1.0), width=16, height=16, fov=80.0)
    asset = MitsubaScene("ball", {"ball": ball}, _cameras(view), max_depth=24).asset(24)
    lit = LitAsset(asset)
    values = lit.lightmap(LightRig((LocalLight("point", (1.0, 1.0, 1.0)),)), asset.sites(), 64, 1)
    expected = albedo / (1 - albedo) / math.pi  # irradiance 1 from the lamp; mean radiance is E / pi
    assert float(values.mean()) == pytest.approx(expected, rel=0.02)
    assert float(values.std()) < 0.1 * expected


def test_equal_seeds_give_equal_lightmaps(corner):
    lit, rig = LitAsset(corner), LightRig((LIGHTS[1],))
    sites = corner.sites()
    first = lit.lightmap(rig, sites, 8, 1)
    assert torch.equal(first, lit.lightmap(rig, sites, 8, 1))
    assert not torch.equal(first, lit.lightmap(rig, sites, 8, 2))
    # light transport is linear: along the same paths twice the light is twice the lightmap
    assert torch.allclose(lit.lightmap(rig.scaled(2.0), sites, 8, 1), 2 * first, rtol=1e-4)


def test_texels_under_the_box_are_hidden_and_filled(corner):
    sites = corner.sites()
    floor = (sites.position[:, 1].abs() < 1e-3) & (sites.normal[:, 1] > 0.9)
    x, z = sites.position[floor, 0], sites.position[floor, 2]
    under = ((x - 0.3).abs() < 0.25) & ((z + 0.2).abs() < 0.25)
    assert int(floor.sum()) > 100 and not bool(under.any())
    assert bool(corner.covered[sites.texel.unique()].all()) and int(corner.fill.max()) < int(
        corner.covered.sum()
    )


def test_measurements_are_mitsubas_direct_light(corner):
    mi = mitsuba()
    meter = Meter(corner, 64, 1)
    points = meter.points()
    for lights in (LIGHTS[:1], LIGHTS[1:2], LIGHTS[2:], LIGHTS):
        found = meter(LightRig(tuple(lights)))
        scene = corner.load({f"light{i}": mitsuba_light(light) for i, light in enumerate(lights)})
        up = points.position + 1e-3 * points.normal
        ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(up.numpy().T.copy()),
                                            mi.Vector3f(-points.normal.numpy().T.copy())))  # fmt: skip
        integrator = mi.load_dict({"type": "path", "max_depth": 2, "hide_emitters": True})
        truth = torch.zeros((64, 3))
        for seed in range(24):
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(seed, 64)
            truth += torch.from_numpy(np.array(integrator.sample(scene, sampler, ray)[0]).T / 24)
        truth = truth[points.group.argsort()]
        share = 1e-3 if len(lights) == 1 else 0.25  # Mitsuba picks one of several lights at random
        assert float((found - truth).norm()) <= share * float(truth.norm()) and float(truth.norm()) > 0


def test_supersampling_averages_and_black_is_black(corner):
    meter, fine = Meter(corner, 16, 1), Meter(corner, 16, 8)
    assert len(fine.points().position) == 128 and bool((torch.bincount(fine.points().group) == 8).all())
    assert meter(LightRig()).abs().max() == 0 and meter(LightRig((LIGHTS[0],))).shape == (16, 3)
    rig = LightRig((LIGHTS[2],))
    one = Meter(corner, 128, 1, 0)
    assert float(fine(rig).mean()) == pytest.approx(float(one(rig).mean()), rel=0.15)


def test_an_even_sky_is_measured_as_its_visible_share(corner):
    meter = Meter(corner, 64, 1)
    found = meter(LightRig((), torch.ones((6, 8, 8, 3))))
    points = meter.points()
    top = (points.position[:, 1] > 0.59)[points.group.argsort()]
    albedo = points.albedo[points.group.argsort()]
    # nothing stands above the box: a sky of radiance 1 gives it irradiance pi
    assert int(top.sum()) > 0 and torch.allclose(found[top], albedo[top], rtol=0.03)
    assert bool((found <= albedo * 1.03).all()) and float(found.min()) >= 0


@pytest.mark.parametrize("resolution", [4, 16, 32])
def test_skies_are_averaged_without_losing_energy(resolution):
    from prt.light.cubemap import mean_radiance

    sky = torch.rand((6, resolution, resolution, 3))
    small = averaged(sky)
    assert small.shape == (6, SKY, SKY, 3)
    assert torch.allclose(mean_radiance(small), mean_radiance(sky), rtol=1e-4)


def test_a_medium_sends_light_through():
    content = {
        "ball": {
            "type": "cube", "bsdf": {"type": "null"},
            "interior": {"type": "homogeneous", "sigma_t": 4.0, "albedo": 0.9},
        }
    }  # fmt: skip
    scene = MitsubaScene("block", content, _cameras(View((0, 0, 4), (0, 0, 0))), max_depth=16)
    scene.medium = "volume"
    asset = scene.asset(16)
    lamp = LocalLight("directional", (1.0, 1.0, 1.0), direction=(0.0, 0.0, -1.0))
    values = LitAsset(asset).lightmap(LightRig((lamp,)), asset.sites(), 64, 1)
    points = asset.texel_gbuffer()
    front, back = points.normal[:, 2] > 0.9, points.normal[:, 2] < -0.9
    assert bool(values.isfinite().all())
    assert 0 < float(values[back].mean()) < float(values[front].mean()) < 1

import math

import numpy as np
import pytest
import torch
from trace_scenes import DOWN_VIEW, DictScene, diffuse, plane

from prt.errors import PrtError
from prt.light.cubemap import direction_to_texel, face_directions, texel_directions
from prt.scene.capture import sensor_description
from prt.scene.mitsuba_setup import mitsuba
from prt.trace import cubemap_emitter as emitter


def directions(count, seed=0):
    d = torch.randn((count, 3), generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.normalize(d, dim=1)


def render(scene, view=DOWN_VIEW, spp=64, max_depth=2, seed=0):
    mi = mitsuba()
    integrator = mi.load_dict({"type": "path", "max_depth": max_depth, "hide_emitters": True})
    sensor = mi.load_dict(sensor_description(view))
    return np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=seed))


def texel_cosine(face, row, column, resolution, n=400):
    """Integral of max(cos, 0) about +y over a texel, by the midpoint rule in (u, v)."""
    place = (torch.arange(n, dtype=torch.float64) + 0.5) / n
    u = (2 * (column + place) / resolution - 1)[None, :].expand(n, n)
    v = (2 * (row + place) / resolution - 1)[:, None].expand(n, n)
    d = face_directions(torch.full((n, n), face), u, v)
    weight = (1 + u * u + v * v) ** -1.5 * (2 / resolution / n) ** 2
    return float((d[..., 1].clamp_min(0) * weight).sum())


@pytest.mark.parametrize("resolution", [1, 4, 33])
def test_texel_map_equals_the_light_floor(resolution):
    mi = mitsuba()
    axes = torch.tensor([[x, y, z] for x in (-1.0, 0, 1) for y in (-1.0, 0, 1) for z in (-1.0, 0, 1)])
    axes = axes[axes.abs().sum(1) > 0]
    d = torch.cat([directions(20000), torch.nn.functional.normalize(axes, dim=1)])
    texel, _ = emitter.direction_to_texel(mi.Vector3f(d.numpy().T.copy()), resolution)
    assert np.array_equal(np.array(texel), direction_to_texel(d, resolution).numpy())
    centre, _ = emitter.texel_to_direction(
        mi.UInt32(np.arange(6 * resolution**2, dtype=np.uint32)), mi.Point2f(0.5), resolution
    )
    assert np.allclose(np.array(centre).T, texel_directions(resolution).reshape(-1, 3), atol=1e-6)


def test_samples_follow_the_stated_pdf():
    mi = mitsuba()
    resolution, count = 8, 400_000
    weights = np.random.default_rng(0).random((6, resolution, resolution)) ** 3 + 0.01
    sampler = emitter.TexelSampler(weights)
    random = np.random.default_rng(1).random((2, count), dtype=np.float32)
    d, pdf, texel = sampler.sample(mi.Point2f(random))
    drawn = np.array(texel)
    again = direction_to_texel(torch.from_numpy(np.array(d).T.copy()), resolution).numpy()
    assert np.array_equal(drawn, again)
    assert np.array_equal(np.array(sampler.pdf(d)), np.array(pdf))
    expected = weights.ravel() / weights.sum() * count
    chi2 = float(((np.bincount(drawn, minlength=expected.size) - expected) ** 2 / expected).sum())
    assert chi2 < expected.size + 5 * math.sqrt(2 * expected.size)
    # E[1 / pdf] is the solid angle that can be drawn: all of it
    inverse = 1 / np.array(pdf, dtype=np.float64)
    assert abs(inverse.mean() - 4 * math.pi) < 5 * inverse.std() / math.sqrt(count)
    # and the pdf integrates to one
    integral = np.array(sampler.pdf(mi.Vector3f(directions(count).numpy().T.copy()))).mean() * 4 * math.pi
    assert abs(integral - 1) < 0.01


def test_constant_cubemap_equals_the_constant_emitter():
    scene = DictScene(
        {"plane": plane(diffuse(0.6)), "ball": {"type": "sphere", "center": [0.3, 0.2, 0], "radius": 0.2}}
    )
    ours = render(emitter.scene_with_lighting(scene, torch.full((6, 4, 4, 3), 2.0)), spp=1024)
    theirs = render(scene.load({"type": "constant", "radiance": 2.0}), spp=1024, seed=1)
    assert abs(ours.mean() / theirs.mean() - 1) < 0.01
    assert np.abs(ours - theirs).max() < 0.1


@pytest.mark.parametrize("face, row, column", [(2, 1, 2), (0, 0, 3), (5, 1, 0)])
def test_irradiance_of_a_single_texel(face, row, column):
    albedo, radiance, resolution = 0.5, 3.0, 4
    lighting = torch.zeros((6, resolution, resolution, 3))
    lighting[face, row, column] = torch.tensor([radiance, 1e6, 0.0])
    scene = emitter.scene_with_lighting(DictScene({"plane": plane(diffuse(albedo))}), lighting)
    image = render(scene, spp=1024)
    expected = albedo / math.pi * texel_cosine(face, row, column, resolution)
    assert image[..., 0].mean() == pytest.approx(radiance * expected, rel=0.01)
    assert image[..., 1].mean() == pytest.approx(1e6 * expected, rel=0.01)
    assert image[..., 2].max() == 0


def test_black_then_other_lighting_in_place_without_new_kernels():
    import drjit as dr

    scene = emitter.scene_with_lighting(DictScene({"plane": plane(diffuse(0.5))}), torch.zeros((6, 2, 2, 3)))
    assert np.array_equal(render(scene), np.zeros((8, 8, 3), dtype=np.float32))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        emitter.set_lighting(scene, torch.ones((6, 2, 2, 3)))
        image = render(scene, spp=256)
        history = dr.kernel_history()
    # hits in memory or on disk: nothing may have to be compiled
    compiled = [
        kernel for kernel in history if kernel.get("type") == dr.KernelType.JIT and not kernel["cache_hit"]
    ]
    assert not compiled
    assert image.mean() == pytest.approx(0.5, rel=0.01)
    emitter.set_lighting(scene, torch.zeros((6, 2, 2, 3)))
    assert render(scene).max() == 0


def test_wrong_lightings_are_refused_in_one_line():
    scene = DictScene({"plane": plane(diffuse(0.5))})
    for value in (math.nan, math.inf, -1.0):
        lighting = torch.ones((6, 2, 2, 3))
        lighting[1, 0, 1, 2] = value
        with pytest.raises(PrtError, match="1 NaN, infinite or negative"):
            emitter.scene_with_lighting(scene, lighting)
    with pytest.raises(PrtError, match=r"\(6, R, R, 3\)"):
        emitter.scene_with_lighting(scene, torch.ones((5, 2, 2, 3)))
    loaded = emitter.scene_with_lighting(scene, torch.ones((6, 2, 2, 3)))
    with pytest.raises(PrtError, match="resolution 4"):
        emitter.set_lighting(loaded, torch.ones((6, 4, 4, 3)))
    with pytest.raises(PrtError, match="scene_with_lighting"):
        emitter.set_lighting(scene.load(), torch.ones((6, 2, 2, 3)))

"""Measured direct light: skies against brute force, groups, keyframes."""

import numpy as np
import pytest
import torch

from prt.bench.build import build
from prt.bench.compose import compose
from prt.errors import PrtError
from prt.light.local import LightRig, LocalLight
from prt.scene.mitsuba_setup import mitsuba
from prt.trace.cubemap_emitter import emitter_class
from prt.trace.measure import Meter, averaged

SPOT = LocalLight("spot", (9.0, 6.0, 3.0), (0.2, 2.2, 1.5), (0.0, -0.8, -0.6), cutoff=45.0, beam=20.0)
SUN = LocalLight("directional", (1.0, 2.0, 3.0), direction=(-0.48, -0.8, -0.36))


@pytest.fixture(scope="module")
def asset():
    """Two keyframes of a column beside a wall: shadows, and three colours."""
    settings = ["task=local_lights", "lighting=spots", "scene=bending", "method=svd_transfer", "budget=smoke"]
    return build(compose(settings), "scene").asset(24)


def direct(asset, emitters: dict, position, normal, spp: int, pose: int = 0, size=None) -> torch.Tensor:
    """What Mitsuba's path integrator sees of one bounce, looking straight down on the points."""
    mi = mitsuba()
    scene = asset.load(emitters, pose)
    for emitter in scene.emitters():
        if size is not None:
            emitter.set_bounds(asset.centre, 2 * asset.radius)
            emitter.set_radiance(size)
    up = (position + 1e-3 * normal).repeat_interleave(spp, 0)
    down = -normal.repeat_interleave(spp, 0)
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(up.numpy().T.copy()), mi.Vector3f(down.numpy().T.copy())))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(5, len(up))
    path = mi.load_dict({"type": "path", "max_depth": 2, "hide_emitters": True})
    value = path.sample(scene, sampler, ray)[0]
    return torch.from_numpy(np.array(value).T.copy()).view(-1, spp, 3).mean(1)


def sun() -> dict:
    return {"sun": {"type": "directional", "direction": list(SUN.direction),
                    "irradiance": {"type": "rgb", "value": list(SUN.color)}}}  # fmt: skip


@pytest.mark.parametrize("resolution", [8, 16])
def test_skies_are_what_brute_force_finds(asset, resolution):
    generator = torch.Generator().manual_seed(resolution)
    sky = torch.rand((6, resolution, resolution, 3), generator=generator) ** 4
    sky[0, : resolution // 2] += 3.0  # light from one side
    meter = Meter(asset, 48, 1)
    points = meter.points()
    emitter_class()
    found = meter(LightRig((), sky))[points.group]
    emitters = {"sky": {"type": "prt_cubemap", "resolution": resolution}}
    truth = direct(asset, emitters, points.position, points.normal, 2048, size=sky)
    assert float((found - truth).norm() / truth.norm()) < 0.06
    # it is a sky with sides: another one upside down is measured otherwise
    assert float((meter(LightRig((), sky.flip(0)))[points.group] - truth).norm() / truth.norm()) > 0.5
    both = meter(LightRig((SUN,), sky))
    assert torch.allclose(both, meter(LightRig((SUN,))) + meter(LightRig((), sky)), atol=1e-5)


@pytest.mark.parametrize("supersample", [1, 4])
@pytest.mark.parametrize("pose", [0, 1])
def test_a_measurement_is_the_mean_of_its_points(asset, supersample, pose):
    meter = Meter(asset, 256, supersample, seed=3)
    points = meter.points(pose)
    every = direct(asset, sun(), points.position, points.normal, 1, pose)
    assert (every.amax(1) == 0).any() and (every.amax(1) > 0).any()  # there are shadows
    wanted = torch.stack([every[points.group == group].mean(0) for group in range(256)])
    found = meter(LightRig((SUN,), pose=pose))
    same = ((found - wanted).abs() < 1e-3 + 1e-3 * wanted).all(1)
    assert int((~same).sum()) <= 2  # points on the very edge of a shadow


def test_light_that_is_faced_away_from_or_blocked_is_none(asset):
    meter = Meter(asset, 32, 2)
    below = LocalLight("directional", (1.0, 1.0, 1.0), direction=(0.0, 1.0, 0.0))
    plate = meter.points().normal[:, 1] > 0.99
    found = meter(LightRig((below,)))
    assert bool(plate.any()) and float(found[meter.points().group[plate]].max()) < 0.2
    assert meter(LightRig()).abs().max() == 0
    assert meter(LightRig((LocalLight("point", (0.0, 0.0, 0.0)),))).abs().max() == 0
    black = LightRig((), torch.zeros((6, 8, 8, 3)))
    assert meter(black).abs().max() == 0
    assert torch.allclose(meter(LightRig((SPOT,)).scaled(3.0)), 3 * meter(LightRig((SPOT,))), rtol=1e-4)


@pytest.mark.parametrize(
    "points, supersample, message",
    [
        (0, 1, "method.points=0"), (70000, 1, "method.points=70000"), (1.5, 1, "method.points=1.5"),
        (True, 1, "method.points=True"), (8, 0, "method.supersample=0"), (8, 65, "method.supersample=65"),
    ],
)  # fmt: skip
def test_counts_out_of_range_are_one_line(asset, points, supersample, message):
    with pytest.raises(PrtError, match=message) as caught:
        Meter(asset, points, supersample)
    assert "\n" not in str(caught.value)


def test_a_coarse_sky_is_the_same_sky_in_more_texels():
    sky = torch.rand((6, 4, 4, 3), generator=torch.Generator().manual_seed(1))
    fine = averaged(sky)
    assert torch.equal(fine[:, 5, 9], sky[:, 1, 2]) and torch.equal(fine[:, 15, 0], sky[:, 3, 0])
    even = averaged(torch.full((6, 64, 64, 3), 0.7))
    assert torch.allclose(even, torch.full_like(even, 0.7))

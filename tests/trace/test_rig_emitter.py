"""The emitter that holds a whole rig, to the last bit where Mitsuba's own emitter draws the same numbers."""

import gc

import pytest
import torch
from mitsuba_lights import mitsuba_light
from trace_scenes import disagreement

from prt.light.local import LightRig, LocalLight
from prt.scene.mitsuba_file import MitsubaScene
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace.reference import render_components
from prt.trace.rig import LitAsset

VIEW = View((0.3, 1.2, 3.0), (0.0, 0.4, 0.0), width=16, height=16)
AXIS = (0.48, -0.8, -0.36)
LIGHTS = {
    "point": LocalLight("point", (3.0, 2.0, 1.0), position=(0.4, 1.6, 0.6)),
    "spot": LocalLight("spot", (5.0, 5.0, 4.0), (-0.7, 1.7, 0.8), AXIS, cutoff=40.0, beam=20.0),
    "directional": LocalLight("directional", (1.0, 1.5, 2.0), direction=AXIS),
}


def asset(medium: bool = False):
    transform = mitsuba().ScalarTransform4f
    grey = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    content = {
        "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90), "bsdf": grey},
        "box": {"type": "cube", "to_world": transform().translate([0.2, 0.3, -0.2]).scale(0.3), "bsdf": grey},
    }
    if medium:
        inside = {"type": "homogeneous", "sigma_t": 3.0, "albedo": 0.9}
        content = {"ball": {"type": "sphere", "center": [0, 0.5, 0], "radius": 0.5, "bsdf": {"type": "null"},
                            "interior": inside}}  # fmt: skip
    cameras = {split: [lambda places: [VIEW for _ in places]] for split in ("train", "far")}
    scene = MitsubaScene("corner", content, cameras, max_depth=4)
    scene.medium = "volume" if medium else None
    return scene.asset(48)


@pytest.mark.parametrize("medium", [False, True])
@pytest.mark.parametrize("kind", LIGHTS)
def test_one_light_is_mitsubas_to_the_last_sample(kind, medium):
    lit = LitAsset(asset(medium))
    found = lit.render(LightRig((LIGHTS[kind],)), VIEW, 16, 1)
    scene = lit.asset.load({"light": mitsuba_light(LIGHTS[kind])})
    integrators = {"direct": lit.integrators["full"], **lit.integrators}
    truth = render_components(scene, integrators, VIEW, 16, 1)
    for part in ("full",) if medium else ("direct", "indirect"):
        assert float(truth[part].mean()) > 1e-4
        # where the falloff of a spot is rounded differently a path may end otherwise
        off = (found[part] - truth[part]).abs() > 1e-3 * truth[part].mean() + 1e-3 * truth[part]
        assert float(off.float().mean()) < 0.01, part


def test_several_lights_add_up():
    lit, seeds = LitAsset(asset()), range(6)
    together = LightRig(tuple(LIGHTS.values()))
    found = torch.stack([lit.render(together, VIEW, 64, seed)["full"] for seed in seeds])
    alone = [LightRig((light,)) for light in LIGHTS.values()]
    truth = torch.stack([
        sum(lit.render(rig, VIEW, 32, 100 + 10 * seed + k)["full"] for k, rig in enumerate(alone))
        for seed in seeds
    ])  # fmt: skip
    blocks, mean = disagreement(found, truth)
    assert blocks < 2.5 and abs(mean) < 4


def test_any_rig_runs_the_kernels_of_the_first():
    gc.collect()  # kernels hold the code of every emitter there is: those of other tests shall not go midway
    lit = LitAsset(asset())
    sites = lit.asset.sites()
    import drjit as dr

    def compiled(rig) -> int:
        dr.kernel_history_clear()
        lit.render(rig, VIEW, 4, 1), lit.lightmap(rig, sites, 4, 1)
        history = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
        assert history
        return sum(not k["cache_hit"] for k in history)

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        compiled(LightRig((LIGHTS["point"],)))
        for rig in (LightRig((LIGHTS["spot"],)), LightRig(tuple(LIGHTS.values())), LightRig(),
                    LightRig((LIGHTS["directional"],))):  # fmt: skip
            assert compiled(rig) == 0


@pytest.mark.parametrize("lights", [(), (LIGHTS["point"],)])
def test_lightmaps_under_environments_are_what_cameras_see(lights):
    sky = torch.rand((6, 4, 4, 3), generator=torch.Generator().manual_seed(0)) ** 3
    lit, rig = LitAsset(asset()), LightRig(lights, sky)
    values = lit.lightmap(rig, lit.asset.sites(), 128, 3)
    gbuffer = lit.asset.capture(lit.dark, VIEW.resized(64, 64))
    gbuffer.supersample = 4  # pixel centres alone are 10 % off
    height, width = lit.asset.size
    texel = (gbuffer.uv[:, 1] * height).long() * width + (gbuffer.uv[:, 0] * width).long()
    found = gbuffer.image(values[lit.asset.fill[texel]] * gbuffer.diffuse)
    truth = lit.render(rig, VIEW, 1024, 4)["indirect"]
    assert float(found.mean()) == pytest.approx(float(truth.mean()), rel=0.04)
    more = lit.lightmap(LightRig(lights, 2 * sky), lit.asset.sites(), 64, 3)
    assert float(more.mean()) > 1.2 * float(values.mean())

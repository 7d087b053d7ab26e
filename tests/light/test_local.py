"""Local lights against Mitsuba's own emitters."""

import json
import math

import numpy as np
import pytest
import torch
from mitsuba_lights import mitsuba_light

from prt.errors import PrtError
from prt.light.local import LightRig, LocalLight
from prt.scene.mitsuba_setup import mitsuba

AXIS = (0.36, -0.48, 0.8)
LIGHTS = {
    "point": LocalLight("point", (1.0, 2.0, 0.5), position=(0.3, 1.0, -0.2)),
    "spot": LocalLight("spot", (3.0, 1.0, 2.0), (0.3, 1.0, -0.2), AXIS, cutoff=40.0, beam=25.0),
    "sharp spot": LocalLight("spot", (1.0, 1.0, 1.0), (0.3, 1.0, -0.2), AXIS, cutoff=30.0, beam=30.0),
    "directional": LocalLight("directional", (0.5, 1.0, 2.0), direction=AXIS),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_incident_is_what_mitsubas_emitter_sends(name):
    mi, light = mitsuba(), LIGHTS[name]
    import drjit as dr

    generator = torch.Generator().manual_seed(1)
    point = 4 * torch.rand((4000, 3), generator=generator) - 2
    it = dr.zeros(mi.SurfaceInteraction3f, len(point))
    it.p = mi.Point3f(np.ascontiguousarray(point.numpy().T))
    scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}, "light": mitsuba_light(light)})
    ds, value = scene.emitters()[0].sample_direction(it, mi.Point2f(0.5, 0.5))
    wanted = torch.from_numpy(np.array(mi.Color3f(value)).T.copy())
    wanted = wanted.expand(len(point), 3)
    d = torch.from_numpy(np.array(mi.Vector3f(ds.d)).T.copy()).expand(len(point), 3)

    to_light, distance, irradiance = light.incident(point)
    assert torch.allclose(to_light, d, atol=1e-5)
    # at the very edge of a sharp spot rounding decides
    close = ((irradiance - wanted).abs() <= 2e-4 * wanted.max(1, keepdim=True)[0] + 1e-5).all(1)
    assert close.float().mean() > (0.998 if name == "sharp spot" else 0.9999)
    if light.kind == "directional":
        assert bool(distance.isinf().all())
    else:
        assert torch.allclose(distance, torch.from_numpy(np.array(ds.dist)), rtol=1e-5)
    if name == "spot":  # the points meet all three parts of it
        share = irradiance[:, 0] * distance**2 / light.color[0]
        assert (share == 0).any() and (share > 0.999).any() and ((share > 0.1) & (share < 0.9)).sum() > 50


@pytest.mark.parametrize(
    "settings, message",
    [
        (dict(kind="area"), "'area' is not one of point, spot, directional"),
        (dict(color=(1.0, -1.0, 0.0)), "color .* finite and not negative"),
        (dict(color=(1.0, math.nan, 0.0)), "color .* finite and not negative"),
        (dict(position=(1.0, math.inf, 0.0)), "position .* finite"),
        (dict(kind="spot", beam=31.0, cutoff=30.0), "beam=31.0 <= cutoff=30.0 < 90"),
        (dict(kind="spot", cutoff=90.0), "cutoff=90.0 < 90"),
        (dict(kind="spot", direction=(0.0, -2.0, 0.0)), "direction .* spot light must have length 1"),
        (dict(kind="directional", direction=(0.0, 0.0, 0.0)), "direction .* must have length 1"),
    ],
)
def test_what_is_no_light_is_refused_in_one_line(settings, message):
    with pytest.raises(PrtError, match=message) as caught:
        LocalLight(**{"kind": "point", "color": (1.0, 1.0, 1.0), **settings})
    assert "\n" not in str(caught.value)


def test_scaled_rigs_are_brighter_in_all_their_parts():
    rig = LightRig((LIGHTS["spot"], LIGHTS["point"]), torch.full((6, 2, 2, 3), 0.5), pose=3)
    twice = rig.scaled(2.0)
    assert [light.color for light in twice.lights] == [(6.0, 2.0, 4.0), (2.0, 4.0, 1.0)]
    assert twice.environment is not None and bool((twice.environment == 1.0).all()) and twice.pose == 3
    assert twice.lights[0].position == rig.lights[0].position and rig.to("cpu") is rig
    assert LightRig(rig.lights).scaled(2.0).environment is None


def test_fingerprints_tell_rigs_apart():
    sky = torch.zeros((6, 2, 2, 3))
    other = sky.clone()
    other[0, 0, 0, 0] = 1e-6
    rigs = [
        LightRig(), LightRig((LIGHTS["spot"],)), LightRig((LIGHTS["spot"], LIGHTS["point"])),
        LightRig((LIGHTS["spot"],), pose=1), LightRig((), sky), LightRig((), other),
    ]  # fmt: skip
    prints = [json.dumps(rig.fingerprint(), sort_keys=True) for rig in rigs]
    assert len(set(prints)) == len(rigs)
    assert prints[4] == json.dumps(LightRig((), sky.clone()).fingerprint(), sort_keys=True)

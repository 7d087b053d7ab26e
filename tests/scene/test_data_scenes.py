"""The scenes made from PRT_DATA: cameras see objects and stand clear of them, and the rooms are open."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from data_scenes import check_missing_data_is_named, scene

from prt.errors import PrtError
from prt.scene.capture import camera_rays, capture
from prt.scene.mitsuba_setup import mitsuba

CONF = Path(__file__).resolve().parents[2] / "conf" / "scene"
MESH_SCENES = ("four_animals", "armadillo")
ROOMS = ("kitchen", "diffuse_kitchen", "bathroom")


@pytest.fixture(scope="module")
def data():
    if not os.environ.get("PRT_DATA"):
        pytest.skip("PRT_DATA is not set: scenes made from its meshes and rooms are not tested")


@pytest.fixture(scope="module")
def loaded(data):
    """Each scene once, with its views of 32 pixels."""
    found = {}
    for name in (*MESH_SCENES, "kitchen", "bathroom"):
        s = scene(name)
        found[name] = s, s.load(), s.views("train", 6, 32) + s.views("far", 6, 32)
    return found


def leaving(mi_scene, views, depth: int) -> float:
    """Share of BSDF-sampled paths from visible points that leave the scene within ``depth`` bounces."""
    import drjit as dr

    mi = mitsuba()
    started = left = 0
    for view in views:
        count = view.width * view.height
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1, count)
        ray, active = camera_rays(view), dr.full(mi.Bool, True, count)
        for bounce in range(depth + 1):
            si = mi_scene.ray_intersect(ray, active)
            out = int(np.array(active & ~si.is_valid()).sum())
            if bounce == 0:
                started += count - out
            else:
                left += out
            active &= si.is_valid()
            sample, weight = si.bsdf().sample(
                mi.BSDFContext(), si, sampler.next_1d(active), sampler.next_2d(active), active
            )
            active &= dr.max(weight) > 0
            ray = si.spawn_ray(si.to_world(sample.wo))
            dr.eval(ray, active)
    return left / started


@pytest.mark.parametrize("name", [*MESH_SCENES, "kitchen", "bathroom"])
def test_cameras_see_the_scene_from_a_clear_place(loaded, name):
    _, mi_scene, views = loaded[name]
    for view in views:
        g = capture(mi_scene, view)
        distance = (g.position - torch.tensor(view.origin, dtype=torch.float32)).norm(dim=1)
        assert len(g) > 0.6 * 32 * 32
        assert distance.min() > 0.3 and distance.median() > 1.0
        for field in g.FIELDS:
            assert getattr(g, field).isfinite().all()
        assert g.diffuse.max() <= 1.0 and g.specular.min() >= 0.0 and g.roughness.max() <= 1.0
        assert torch.allclose(g.normal.norm(dim=1), torch.ones(len(g)), atol=1e-4)


@pytest.mark.parametrize("name", ["kitchen", "bathroom"])
def test_rooms_are_open(loaded, name):
    s, mi_scene, views = loaded[name]
    assert s.record == {"kitchen": "bsdf", "bathroom": "nee"}[name]
    assert leaving(mi_scene, views[::4], s.max_depth) > 0.3


@pytest.mark.parametrize("name", MESH_SCENES)
def test_meshes_stand_on_the_ground(loaded, name):
    low, high = loaded[name][0].bounds
    assert -0.06 <= low[1] <= 0.0 and 1.0 < high[1] < 2.5


def test_diffuse_kitchen_has_roughness_one(loaded):
    view = loaded["kitchen"][2][0]
    diffuse_kitchen = scene("diffuse_kitchen")
    plain, rough = capture(loaded["kitchen"][1], view), capture(diffuse_kitchen.load(), view)
    assert plain.roughness.min() < 0.4
    assert (rough.roughness > 0.999).float().mean() > 0.99  # thin glass has no rough version
    assert torch.allclose(plain.diffuse, rough.diffuse, atol=1e-4)
    assert diffuse_kitchen.fingerprint() != loaded["kitchen"][0].fingerprint()


def test_bathroom_mirror_has_the_papers_roughness(loaded):
    _, mi_scene, views = loaded["bathroom"]
    g = capture(mi_scene, views[1].resized(64, 64))
    x, y, z = g.position.unbind(1)
    mirror = (x > -2.1) & (x < -0.6) & (y > 1.1) & (y < 1.9) & (z < -2.4) & (g.specular.min(1).values > 0.99)
    assert mirror.sum() > 10
    assert torch.allclose(g.roughness[mirror] ** 2, torch.tensor(0.05), atol=1e-3)


@pytest.mark.parametrize("name", [*MESH_SCENES, *ROOMS])
def test_missing_data_is_named(name, tmp_path, monkeypatch):
    check_missing_data_is_named(name, tmp_path, monkeypatch)


def test_fingerprints_tell_settings_apart(loaded):
    plain = loaded["four_animals"][0].fingerprint()
    assert plain == scene("four_animals").fingerprint()
    assert plain != scene("four_animals", "scene.ground_roughness=0.2").fingerprint()


def test_scene_mitsuba_asks_for_a_path():
    with pytest.raises(PrtError, match=r"scene\.path is not set"):
        scene("mitsuba")

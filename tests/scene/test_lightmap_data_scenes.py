"""The scenes with meshes from PRT_DATA that lightmaps are baked for."""

import numpy as np
import pytest
from data_scenes import need_data, scene

from prt.errors import PrtError
from prt.scene.capture import camera_rays, sensor_description
from prt.scene.closing import mesh_data, open_edges
from prt.scene.mitsuba_setup import mitsuba

SURFACES = ("alcove", "lion")
TRANSLUCENT = ("nefertiti", "armadillo_translucent")


@pytest.fixture(scope="module")
def data():
    need_data()


@pytest.fixture(scope="module")
def loaded(data):
    found = {}
    for name in (*SURFACES, *TRANSLUCENT):
        s = scene(name)
        found[name] = s, s.load()
    return found


@pytest.mark.parametrize("name, least", [("alcove", 0.6), ("lion", 0.2), *((n, 0.15) for n in TRANSLUCENT)])
def test_cameras_see_all_of_the_scene_from_a_clear_place(loaded, name, least):
    s, mi_scene = loaded[name]
    for view in s.views("train", 8, 32) + s.views("far", 8, 32):
        si = mi_scene.ray_intersect(camera_rays(view))
        hit = np.array(si.is_valid())
        assert hit.mean() > least
        assert np.array(si.t)[hit].min() > 1.0
        if name != "alcove":  # an object alone is not cut off by the picture's edge
            frame = hit.reshape(32, 32)
            assert not (frame[0].any() or frame[-1].any() or frame[:, 0].any() or frame[:, -1].any())


def test_alcove_is_closed_where_it_is_looked_at_and_open_to_the_light(loaded):
    s, mi_scene = loaded["alcove"]
    low, high = s.bounds
    assert -0.1 < low[1] < 0.0 and 1.8 < high[1] < 2.1
    mi = mitsuba()
    wrong = total = 0
    for view in s.views("train", 8, 48) + s.views("far", 8, 48):
        ray = camera_rays(view)
        si = mi_scene.ray_intersect(ray)
        hit = np.array(si.is_valid())
        facing = (np.array(mi.Vector3f(si.n)) * np.array(ray.d)).sum(0)
        wrong += (facing[hit] > 0).sum()
        total += hit.sum()
    assert wrong < 1e-3 * total, "sides that are left out are seen from within"


def test_lion_is_closed_and_its_plinth_hardly_larger_than_it(loaded):
    s, mi_scene = loaded["lion"]
    parts = {shape.id(): mesh_data(shape) for shape in mi_scene.shapes()}
    lion, plinth = parts["lion"], parts["plinth"]
    assert len(open_edges(lion)) == 0 == len(open_edges(plinth))
    extent = np.ptp(lion.position, axis=0)
    assert extent[1] == pytest.approx(1.2, rel=1e-3)
    assert (np.ptp(plinth.position, axis=0)[[0, 2]] < 1.5 * extent[[0, 2]]).all()
    assert lion.position[:, 1].min() > plinth.position[:, 1].min()


@pytest.mark.parametrize("name", TRANSLUCENT)
def test_the_medium_is_enclosed_and_lets_light_through(loaded, name):
    s, mi_scene = loaded[name]
    assert s.medium == "volume" and s.max_depth == 8
    (body,) = mi_scene.shapes()
    assert body.is_medium_transition() and len(open_edges(mesh_data(body))) == 0
    assert s.bounds[0][1] == pytest.approx(0.0, abs=1e-5) and s.bounds[1][1] == pytest.approx(1.6, rel=1e-5)
    mi = mitsuba()
    lamp = {"type": "directional", "direction": [0.0, 0.0, 1.0], "irradiance": {"type": "rgb", "value": 1.0}}
    view = s.views("far", 1, 16)[0]  # from behind the lamp's far side or near it: some of both is lit
    image = np.array(
        mi.render(
            s.load_with({"lamp": lamp}),
            integrator=mi.load_dict({"type": "volpath", "max_depth": 40, "rr_depth": 1000}),
            sensor=mi.load_dict(sensor_description(view)),
            spp=16,
            seed=0,
        )
    )
    hit = np.array(mi_scene.ray_intersect(camera_rays(view)).is_valid()).reshape(16, 16)
    assert (
        np.isfinite(image).all() and image[hit].mean() > 0.01 and image[~hit].mean() < 0.1 * image[hit].mean()
    )


def test_mesh_that_is_not_closed_holds_no_medium(data):
    with pytest.raises(PrtError, match=r"bunny\.ply has 223 open edges") as caught:
        scene("nefertiti", "scene.mesh=meshes/bunny.ply").load()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "name, overrides",
    [
        ("alcove", ["elephant_albedo=0.5"]),
        ("lion", ["albedo=0.5"]),
        (
            "nefertiti",
            ["height=2", "turn=30", "tilt=0", "mean_free_path=0.02", "albedo=[0.9,0.9,0.9]", "anisotropy=0.3",
             "mesh=meshes/armadillo.ply"],
        ),
    ],
)  # fmt: skip
def test_fingerprints_tell_settings_apart(loaded, name, overrides):
    plain = loaded[name][0].fingerprint()
    assert plain == scene(name).fingerprint()
    for override in overrides:
        assert scene(name, f"scene.{override}").fingerprint() != plain, override


def test_settings_reach_the_medium(loaded):
    medium = scene("nefertiti", "scene.anisotropy=0.3", "scene.height=2").description()["body"]["interior"]
    assert medium["sigma_t"] == pytest.approx(1 / 0.06) and medium["phase"] == {"type": "hg", "g": 0.3}
    assert scene("nefertiti").description()["body"]["interior"]["phase"] == {"type": "isotropic"}


@pytest.mark.parametrize(
    "name, override, message",
    [
        ("alcove", "elephant_albedo=1", "elephant_albedo=1"),
        ("lion", "albedo=-0.1", "albedo=-0.1"),
        ("nefertiti", "albedo=[1,1,1]", "albedo=1"),
        ("nefertiti", "albedo=0.9", "list of 3"),
        ("nefertiti", "mean_free_path=0", "mean_free_path=0"),
        ("nefertiti", "anisotropy=1", "anisotropy=1"),
        ("nefertiti", "height=-1", "height=-1"),
    ],
)
def test_wrong_settings_are_refused_when_built(name, override, message):
    with pytest.raises(PrtError, match=message) as caught:
        scene(name, f"scene.{override}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", [*SURFACES, *TRANSLUCENT])
def test_missing_data_is_named(name, tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_DATA", str(tmp_path))
    with pytest.raises(PrtError, match=f"{tmp_path}/.*") as caught:
        scene(name).load()
    assert "\n" not in str(caught.value)

import math

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.light.cubemap import mean_radiance, texel_directions, texel_solid_angles
from prt.scene.mitsuba_setup import mitsuba
from prt.trace import room_model, sky
from prt.trace.rooms import ProceduralEnvironments, RoomTracer, jittered_directions


@pytest.fixture(scope="module")
def tracer():
    if "scalar" in mitsuba().variant():
        pytest.skip("procedural rooms need a vectorised Mitsuba variant")
    return RoomTracer(4, 16, 5, denoise=False)


@pytest.mark.parametrize("seed", range(40))
def test_every_room_is_lit_and_its_eye_is_in_the_open(seed):
    room = room_model.random_room(seed)
    assert room.vertices.shape == (8 * room_model.BOXES, 3)
    assert room.frames.shape == (room_model.RECTANGLES, 4, 4)
    assert room.radiance.max() > 0 and (room.radiance >= 0).all()
    assert ((room.face_colours >= 0) & (room.face_colours <= 0.95)).all()
    boxes = room.vertices.reshape(-1, 8, 3)
    low, high = boxes.min(1), boxes.max(1)
    inside = ((low < room.eye) & (room.eye < high)).all(1)
    # the shell only; a turned box may hold the eye in its bounding box, never in itself
    assert inside[0]
    for corners in boxes[1:][inside[1:]]:
        edges = corners[[1, 2, 4]] - corners[0]
        place = (edges @ (room.eye - corners[0])) / (edges**2).sum(1)
        assert not ((place > 0) & (place < 1)).all()
    # lights shine into the room
    lit = room.radiance.max(1) > 0
    assert (room.frames[lit, 1, 3] > 0).all()


def test_jittered_directions_stay_in_their_texels():
    from prt.light.cubemap import direction_to_texel

    d = jittered_directions(4, 9, seed=3)
    assert torch.equal(direction_to_texel(d, 4), torch.arange(96).repeat_interleave(9))


def test_equal_seeds_give_equal_rooms_also_after_another_room(tracer):
    first = tracer.trace(room_model.random_room(3), 3)
    other = tracer.trace(room_model.random_room(4), 4)
    again = tracer.trace(room_model.random_room(3), 3)
    torch.testing.assert_close(first, again, rtol=1e-5, atol=1e-6)
    assert not torch.allclose(first, other)


def test_a_white_furnace_room(tracer):
    """A closed box of reflectance 1/2 with one glowing wall, against the form factor of parallel squares."""
    room = room_model.random_room(0)
    room.vertices = np.tile(room_model._CORNERS * 0.01 - 100.0, (room_model.BOXES, 1))
    room.vertices[:8] = room_model._CORNERS
    room.face_colours[:] = 0.0
    room.eye = np.zeros(3)
    room.radiance[:] = 0.0
    room.radiance[0] = [1.0, 2.0, 3.0]
    # the wall -x, shining to +x
    room.frames[0] = room_model.frame(
        np.array([-0.999, 0, 0]), np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]).astype(float)
    )
    seen = tracer.trace(room, 1)
    assert torch.allclose(seen[1], torch.tensor([1.0, 2.0, 3.0]), atol=1e-3)
    assert seen[[0, 2, 3, 4, 5], 1:3, 1:3].max() < 1e-6
    room.face_colours[:] = 0.5
    seen = tracer.trace(room, 1)
    # the opposite wall receives F of the glowing square, 0.2 on average and 0.239 at its centre: one bounce
    # gives half of that, and the others, each weaker than the last, at most as much again
    centre = seen[0, 1:3, 1:3, 0].mean().item()
    assert 0.5 * 0.2 < centre < 2 * 0.5 * 0.26


def test_sun_energy_does_not_depend_on_the_resolution():
    up = np.array([0.3, 0.9, 0.2]) / np.linalg.norm([0.3, 0.9, 0.2])
    means = []
    for R in (4, 16):
        lit = sky.sky(R, up, 3.0, np.zeros(3), sun_scale=1.0) - sky.sky(
            R, up, 3.0, np.zeros(3), sun_scale=0.0
        )
        means.append(mean_radiance(lit))
        brightest = lit[..., 1].reshape(-1).argmax()
        d = texel_directions(R).reshape(-1, 3)[brightest]
        assert math.degrees(math.acos(float((d * torch.tensor(up)).sum().clamp(-1, 1)))) < 90 / R
    torch.testing.assert_close(means[0], means[1], rtol=1e-4, atol=0)
    assert means[0].min() > 0


def test_the_ground_reflects_what_the_sky_sends():
    R = 8
    out = sky.sky(R, np.array([0.0, 1.0, 0.0]), 3.0, np.full(3, 0.5), sun_scale=0.5)
    d = texel_directions(R)
    irradiance = (out * (d[..., 1].clamp_min(0) * texel_solid_angles(R))[..., None]).sum((0, 1, 2))
    torch.testing.assert_close(out[3, 3, 3], 0.5 * irradiance / math.pi, rtol=0.02, atol=0)


def test_sets_are_normalised_disjoint_and_cached(tmp_path, monkeypatch, tracer):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path))
    settings = dict(resolution=4, train_rooms=2, train_skies=1, test_rooms=1, test_skies=1, spp=4)
    lights = ProceduralEnvironments(**settings)
    names, radiance = lights.train()
    tests, test_radiance = lights.test()
    assert len(names) == len(set(names)) == len(radiance) == 9
    assert tests == ["room_test00", "sky_test00"] and len(test_radiance) == 2
    torch.testing.assert_close(mean_radiance(radiance).mean(-1), torch.ones(9), rtol=1e-4, atol=0)
    assert radiance.isfinite().all() and (radiance >= 0).all()
    assert not set(lights.seeds("train", 100)) & set(lights.seeds("test", 100))
    assert (tmp_path / "environments").exists()
    monkeypatch.setattr(ProceduralEnvironments, "build", None)
    assert torch.equal(ProceduralEnvironments(**settings).train()[1], radiance)
    assert ProceduralEnvironments(**settings).fingerprint() == lights.fingerprint()
    assert ProceduralEnvironments(**{**settings, "seed": 1}).fingerprint() != lights.fingerprint()


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"train_rooms": -1}, "train_rooms=-1"),
        ({"train_rooms": 0, "train_skies": 0}, "at least one"),
        ({"spp": 0}, "spp=0"),
        ({"rotations": []}, "rotations"),
        ({"lamps": -1}, "lamps=-1"),
        ({"resolution": 5}, "power of two"),
    ],
)
def test_wrong_settings_are_errors(settings, message):
    with pytest.raises(PrtError, match=message):
        ProceduralEnvironments(**{"resolution": 4, **settings})

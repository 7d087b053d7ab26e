import pytest
import torch
from trace_scenes import (
    CORNER_VIEW,
    DOWN_VIEW,
    DictScene,
    diffuse,
    disagreement,
    glossy_corner,
    lightings,
    plane,
)

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace import record as module
from prt.trace.record import merged, record
from prt.trace.reference import COMPONENTS, ReferenceRenderer

R, DEPTH, SEEDS = 4, 4, 6


@pytest.fixture(scope="module")
def corner():
    return glossy_corner(DEPTH)


@pytest.fixture(scope="module")
def references(corner):
    """(seeds, H, W, 3) per lighting and component, by the renderer's own integrator."""
    renderer = ReferenceRenderer(corner, R)
    out = {}
    for name, lighting in lightings(R).items():
        images = [renderer.render(CORNER_VIEW, lighting, 64, seed) for seed in range(SEEDS)]
        for part in COMPONENTS:
            out[name, part] = torch.stack([image[part] for image in images])
    return out


def images(transports, lighting, part):
    flat = lighting.reshape(1, -1, 3)
    size = (CORNER_VIEW.height, CORNER_VIEW.width, 3)
    return torch.stack([t.component(part).relight(flat)[0].reshape(size) for t in transports])


@pytest.mark.parametrize("mode", ["bsdf", "nee", "nee, thinned", "nee, other prior"])
def test_relit_records_agree_with_references(corner, references, mode):
    prior = {"bsdf": None, "nee, other prior": lightings(2)["one texel"]}.get(mode, lightings(R)["contrast"])
    thin = 0.1 if "thinned" in mode else 0.0
    scene = corner.load()
    transports = [
        record(scene, CORNER_VIEW, 128, DEPTH, R, 50 + s, prior=prior, thin=thin) for s in range(SEEDS)
    ]
    for (name, part), reference in references.items():
        ours = images(transports, lightings(R)[name], part)
        per_block, whole = disagreement(ours, reference)
        assert per_block < 2.2 and abs(whole) < 4, (name, part, per_block, whole)
    # the test can tell three percent, where the noise is small enough
    spoilt = 1.03 * images(transports, lightings(R)["constant"], "full")
    assert abs(disagreement(spoilt, references["constant", "full"])[1]) > 4


def test_white_furnace_convex():
    """Each path from a white convex body carries all of the light: exactly 1, without noise."""
    scene = DictScene({"ball": {"type": "sphere", "radius": 1.0, "bsdf": diffuse(1.0)}}).load()
    view = View((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), fov=15.0, width=4, height=4)
    transport = record(scene, view, 32, 3, R, 0)
    radiance = transport.relight(torch.ones((1, 6 * R * R, 3)))
    assert torch.allclose(radiance, torch.ones_like(radiance), atol=1e-5)
    assert set(transport.bounces.tolist()) == {1}
    half = record(scene, view, 512, 3, R, 0, prior=torch.ones((6, 2, 2, 3)))
    assert float(half.relight(torch.ones((1, 6 * R * R, 3))).mean()) == pytest.approx(1.0, abs=0.01)


def test_white_furnace_of_a_corner_with_many_bounces():
    to_world = mitsuba().ScalarTransform4f().translate([0, 1, -1])
    shapes = {
        "floor": plane(diffuse(1.0)),
        "wall": {"type": "rectangle", "to_world": to_world, "bsdf": diffuse(1.0)},
    }
    view = View((0.0, 1.2, 1.2), (0.0, 0.5, -1.0), fov=30.0, width=4, height=4)
    scene = DictScene(shapes).load()
    ones = torch.ones((1, 6 * R * R, 3))
    deep = record(scene, view, 256, 40, R, 0)
    assert torch.allclose(deep.relight(ones), torch.ones(1, 16, 3), atol=0.1)
    assert float(deep.relight(ones).mean()) == pytest.approx(1.0, abs=0.01)
    shallow = record(scene, view, 256, 2, R, 0)
    assert int(shallow.bounces.max()) == 2 and float(shallow.relight(ones).mean()) < 0.995


def test_diffuse_plane_closed_form():
    """Light from the +y face only: albedo times the form factor of a square above the plane."""
    albedo, lighting = 0.4, torch.zeros((6, R, R, 3))
    lighting[2] = 2.0
    scene = DictScene({"plane": plane(diffuse(albedo), scale=100.0)}).load()
    # form factor of a square of half-width 1 at distance 1, from a point below its middle
    fraction = 4 / torch.pi * (0.5**0.5) * torch.atan(torch.tensor(0.5**0.5))
    for prior in (None, lighting):
        transport = record(scene, DOWN_VIEW, 512, 3, R, 1, prior=prior)
        image = transport.relight(lighting.reshape(1, -1, 3))
        assert float(image.mean()) == pytest.approx(2.0 * albedo * float(fraction), rel=0.01)
        assert transport.component("indirect").texel.numel() == 0


def test_components_add_up(corner):
    transport = record(corner.load(), CORNER_VIEW, 16, DEPTH, R, 0)
    light = lightings(R)["contrast"].reshape(1, -1, 3)
    parts = {
        name: transport.component(name).relight(light)
        for name in ("background", "direct", "indirect", "full")
    }
    assert torch.allclose(parts["direct"] + parts["indirect"], parts["full"], atol=1e-5)
    assert torch.allclose(parts["background"] + parts["full"], transport.relight(light), atol=1e-5)
    assert all(float(part.sum()) > 0 for part in parts.values())
    assert int(transport.bounces.max()) <= DEPTH


def test_mirror_is_a_delta_lobe_in_both_modes():
    """A perfect mirror sends every path to one place; next-event samples cannot add to it."""
    scene = DictScene({"plane": plane({"type": "conductor", "material": "none"})}).load()
    for prior in (None, torch.ones((6, 2, 2, 3))):
        transport = record(scene, DOWN_VIEW, 8, 3, 1, 0, prior=prior)
        assert set(transport.texel.tolist()) == {2} and transport.texel.numel() == 8 * 64
        assert torch.allclose(transport.relight(torch.ones((1, 6, 3))), torch.ones(1, 64, 3), atol=1e-5)


def test_a_view_of_nothing(corner):
    away = View((0.0, 1.0, 3.0), (0.0, 1.0, 9.0), width=4, height=4)
    for prior in (None, torch.ones((6, 2, 2, 3))):
        transport = record(corner.load(), away, 8, DEPTH, R, 0, prior=prior)
        assert transport.pixels == 16 and set(transport.bounces.tolist()) == {0}
        nothing = transport.component("full")
        assert nothing.pixels == 16 and nothing.texel.numel() == 0
        assert torch.equal(nothing.relight(torch.ones((2, 6 * R * R, 3))), torch.zeros(2, 16, 3))


def test_seed_decides_and_chunks_only_change_the_random_numbers(corner, monkeypatch):
    scene, prior = corner.load(), lightings(R)["contrast"]
    for given in (None, prior):
        first, again, other = (
            record(scene, CORNER_VIEW, 8, DEPTH, R, seed, prior=given) for seed in (5, 5, 6)
        )
        assert all(
            torch.equal(getattr(first, n), getattr(again, n))
            for n in ("offsets", "texel", "weight", "bounces")
        )
        assert not (len(first.texel) == len(other.texel) and torch.equal(first.texel, other.texel))
    ones = torch.ones((1, 6 * R * R, 3))
    whole = record(scene, CORNER_VIEW, 64, DEPTH, R, 5)
    monkeypatch.setattr(module, "WAVEFRONT", 64 * 100)
    parts = record(scene, CORNER_VIEW, 64, DEPTH, R, 5)
    assert parts.pixels == 256
    assert float((whole.relight(ones) - parts.relight(ones)).abs().mean()) < 0.1


def test_merging_keeps_every_component(corner):
    transport = record(corner.load(), CORNER_VIEW, 64, DEPTH, R, 0)
    small = merged(transport)
    assert small.texel.numel() < transport.texel.numel()
    light = lightings(R)["contrast"].reshape(1, -1, 3)
    for part in ("background", "direct", "indirect"):
        expected = transport.component(part).relight(light)
        assert torch.allclose(small.component(part).relight(light), expected, atol=1e-5)


def test_black_prior_and_wrong_settings(corner):
    scene = corner.load()
    black = record(scene, CORNER_VIEW, 4, DEPTH, R, 0, prior=torch.zeros((6, 2, 2, 3)))
    assert bool(torch.isfinite(black.weight).all()) and black.texel.numel() > 0
    for setting in ({"spp": 0}, {"max_depth": 0}, {"resolution": 0}, {"spp": 1.5}):
        with pytest.raises(PrtError, match=next(iter(setting))):
            record(scene, CORNER_VIEW, **{"spp": 1, "max_depth": 2, "resolution": 2, "seed": 0, **setting})
    with pytest.raises(PrtError, match="cubemap"):
        record(scene, CORNER_VIEW, 1, 2, 2, 0, prior=torch.ones((4, 4, 3)))

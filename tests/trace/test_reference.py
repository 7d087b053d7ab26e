import math

import pytest
import torch
from trace_scenes import CORNER_VIEW, DOWN_VIEW, DictScene, diffuse, glossy_corner, lightings, plane

from prt.errors import PrtError
from prt.scene.view import View
from prt.trace import reference
from prt.trace.reference import ReferenceRenderer, noise_floor, render

R = 4


def test_components_are_consistent_and_not_negative():
    images = render(glossy_corner(), CORNER_VIEW, lightings(R)["contrast"], 64, 4, seed=0)
    assert set(images) == {"full", "direct", "indirect"}
    assert all(image.shape == (16, 16, 3) and image.dtype == torch.float32 for image in images.values())
    assert torch.allclose(images["direct"] + images["indirect"], images["full"], atol=1e-5)
    assert float(images["indirect"].min()) >= 0 and float(images["indirect"].mean()) > 0.001


def test_indirect_is_free_of_the_noise_of_direct_light():
    """On a convex scene there is no indirect light, and the difference of the two images is exactly zero."""
    scene = DictScene({"plane": plane(diffuse(0.5))})
    images = render(scene, DOWN_VIEW, lightings(R)["contrast"], 8, 4, seed=0)
    assert float(images["indirect"].max()) == 0
    assert float(images["direct"].std()) > 0.001


def test_background_is_no_part_of_a_reference():
    view = View((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), fov=60.0, width=9, height=9)
    scene = DictScene({"ball": {"type": "sphere", "radius": 1.0, "bsdf": diffuse(1.0)}})
    image = render(scene, view, torch.ones((6, R, R, 3)), 64, 3, seed=0)["full"]
    assert float(image[0, 0].max()) == 0
    assert float(image[4, 4].mean()) == pytest.approx(1.0, abs=0.02)


def test_depth_one_is_direct_light_only():
    images = render(glossy_corner(), CORNER_VIEW, lightings(R)["constant"], 4, 1, seed=0)
    assert torch.equal(images["full"], images["direct"]) and float(images["indirect"].max()) == 0


def test_passes_add_up_and_seeds_repeat(monkeypatch):
    renderer = ReferenceRenderer(glossy_corner(), R)
    light = lightings(R)["constant"]
    once = renderer.render(CORNER_VIEW, light, 256, 1)
    assert torch.equal(once["full"], renderer.render(CORNER_VIEW, light, 256, 1)["full"])
    monkeypatch.setattr(reference, "WAVEFRONT", 16 * 16 * 100)
    passes = renderer.render(CORNER_VIEW, light, 256, 1)
    assert not torch.equal(once["full"], passes["full"])
    assert float((once["full"] - passes["full"]).abs().mean()) < 0.02
    with pytest.raises(PrtError, match="spp=0"):
        renderer.render(CORNER_VIEW, light, 0, 1)


def test_noise_floor_predicts_the_error_of_the_mean():
    generator = torch.Generator().manual_seed(0)
    truth = torch.rand((64, 64, 3), generator=generator)
    a, b = (truth + 0.05 * torch.randn(truth.shape, generator=generator) for _ in range(2))

    def psnr(image, target):
        return -10 * math.log10(float((image - target).square().mean()))

    assert noise_floor(a, b, psnr) == pytest.approx(psnr((a + b) / 2, truth), abs=0.2)
    assert noise_floor(a, b) == pytest.approx(psnr((a + b) / 2, truth), abs=1.5)  # its peak is not exactly 1
    assert noise_floor(a, a) == math.inf


def test_render_with_floor():
    renderer = ReferenceRenderer(glossy_corner(), R)
    light = lightings(R)["contrast"]

    def psnr(image, target):
        return -10 * math.log10(float((image - target).square().mean()))

    few, many = (renderer.render_with_floor(CORNER_VIEW, light, spp, 0, psnr)[1] for spp in (16, 256))
    # sixteen times the samples: 12 dB
    assert all(many[part] - few[part] == pytest.approx(12, abs=3) for part in ("full", "direct", "indirect"))

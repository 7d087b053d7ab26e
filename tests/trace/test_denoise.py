import pytest
import torch
from trace_scenes import CORNER_VIEW, glossy_corner, lightings

from prt.errors import PrtError
from prt.scene.capture import capture
from prt.trace import denoise as module
from prt.trace.denoise import denoise
from prt.trace.reference import ReferenceRenderer

pytestmark = pytest.mark.skipif(module.available() is not None, reason=str(module.available()))


@pytest.fixture(scope="module")
def corner():
    scene, view = glossy_corner(), CORNER_VIEW.resized(64, 64)
    renderer = ReferenceRenderer(scene, 4)
    light = lightings(4)["contrast"]
    gbuffer = capture(scene.load(), view)
    guides = {"albedo": gbuffer.image((gbuffer.diffuse + gbuffer.specular).clamp(0, 1)),
              "normal": gbuffer.image(gbuffer.normal)}  # fmt: skip
    return renderer.render(view, light, 8, 0), renderer.render(view, light, 2048, 1), guides


@pytest.mark.parametrize("part", ["full", "indirect"])
@pytest.mark.parametrize("guided", [True, False])
def test_error_falls_and_energy_stays(corner, part, guided):
    noisy, clean, guides = corner
    out = denoise(noisy[part], **(guides if guided else {}))
    before, after = ((image - clean[part]).square().mean().sqrt() for image in (noisy[part], out))
    assert float(after) < 0.6 * float(before)
    assert float(out.mean()) == pytest.approx(float(clean[part].mean()), rel=0.05)
    assert float(out.min()) >= 0


def test_exposure_does_not_matter(corner):
    noisy, _, guides = corner
    one, bright = denoise(noisy["full"], **guides), denoise(noisy["full"] * 1e4, **guides) / 1e4
    assert torch.allclose(one, bright, atol=0.01 * float(one.max()))


def test_black_and_wrong_input(monkeypatch):
    assert torch.equal(denoise(torch.zeros((8, 8, 3))), torch.zeros((8, 8, 3)))
    with pytest.raises(PrtError, match="NaN"):
        denoise(torch.full((8, 8, 3), torch.nan))
    with pytest.raises(PrtError, match=r"albedo of shape \(4, 8, 3\)"):
        denoise(torch.ones((8, 8, 3)), albedo=torch.ones((4, 8, 3)))
    with pytest.raises(PrtError, match="albedo"):
        denoise(torch.ones((8, 8, 3)), normal=torch.ones((8, 8, 3)))
    monkeypatch.setattr(module, "available", lambda: "it is not there; pip install mitsuba-oidn")
    with pytest.raises(PrtError, match="pip install mitsuba-oidn"):
        denoise(torch.ones((8, 8, 3)))

"""Blending against a texel-by-texel reference, both orders of the work, and what is refused."""

import math

import pytest
import torch

from prt.errors import PrtError
from prt.methods.lightmap_blend import TEXELS_PER_POINT, Blender, blend, sample

HEIGHT, WIDTH = 7, 11


def random(*shape, seed=0):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def places(count=60):
    """Random places, the corners of the lightmap, and one outside it."""
    uv = torch.rand((count, 2), generator=torch.Generator().manual_seed(1))
    edges = torch.tensor([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [0.5, 1.0], [-0.3, 1.4]])
    return torch.cat([edges, uv])


def looked_up(image, u, v):
    """One value of a bilinear look-up, clamped to the edge: from the definition."""
    height, width = image.shape
    x, y = u * width - 0.5, v * height - 0.5
    total = 0.0
    for i in (math.floor(y), math.floor(y) + 1):
        for j in (math.floor(x), math.floor(x) + 1):
            texel = image[min(max(i, 0), height - 1), min(max(j, 0), width - 1)]
            total += float(texel) * (1 - abs(x - j)) * (1 - abs(y - i))
    return total


def blended(basis, coefficients, uv):
    """The sum of the definition, colour by colour."""
    out = torch.zeros(len(uv), 3)
    for p, (u, v) in enumerate(uv.tolist()):
        for c in range(3):
            for k in range(len(basis)):
                image = basis[k, ..., c if basis.shape[3] == 3 else 0]
                out[p, c] += float(coefficients[k, c]) * looked_up(image, u, v)
    return out


def test_sample_follows_the_definition():
    lightmaps, uv = random(3, HEIGHT, WIDTH), places()
    expected = [[looked_up(image, u, v) for u, v in uv.tolist()] for image in lightmaps]
    torch.testing.assert_close(sample(lightmaps, uv), torch.tensor(expected), atol=1e-5, rtol=1e-5)


def test_sample_at_a_centre_is_the_texel():
    lightmaps = random(2, HEIGHT, WIDTH)
    rows, columns = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    uv = torch.stack([(columns + 0.5) / WIDTH, (rows + 0.5) / HEIGHT], dim=-1).view(-1, 2)
    torch.testing.assert_close(sample(lightmaps, uv), lightmaps.flatten(1), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("elements", [1, 5])
def test_both_orders_of_the_work_follow_the_definition(elements, channels):
    basis, coefficients, uv = random(elements, HEIGHT, WIDTH, channels), random(elements, 3, seed=2), places()
    blender, expected = Blender(basis), blended(basis, coefficients, uv)
    for found in (blender.blend_first(coefficients, uv), blender.sample_first(coefficients, uv)):
        torch.testing.assert_close(found, expected, atol=2e-5, rtol=1e-5)


def test_the_counts_choose_the_order(monkeypatch):
    blender, coefficients = Blender(random(2, 8, 8)), random(2, 3)
    used = []
    for name in ("blend_first", "sample_first"):
        monkeypatch.setattr(blender, name, lambda c, uv, name=name: used.append(name) or torch.zeros(1, 3))
    enough = 64 // TEXELS_PER_POINT
    for count in (enough, enough - 1, 1000):
        blender.blend(coefficients, places()[:1].expand(count, -1))
    assert used == ["blend_first", "sample_first", "blend_first"]


def test_gamma_clamps_and_raises_but_linear_sums_keep_their_sign():
    basis, coefficients, uv = random(4, HEIGHT, WIDTH), random(4, 3, seed=2), places()
    linear = blend(basis, coefficients, uv)
    assert (linear < 0).any() and (linear > 0).any()
    torch.testing.assert_close(blend(basis, coefficients, uv, 2.2), linear.clamp_min(0) ** 2.2)


def test_one_channel_of_three_dimensions_or_four():
    basis, coefficients, uv = random(4, HEIGHT, WIDTH), random(4, 3, seed=2), places()
    assert torch.equal(blend(basis, coefficients, uv), blend(basis[..., None], coefficients, uv))


def test_a_lightmap_of_one_texel_is_constant():
    found = blend(torch.full((1, 1, 1), 2.0), torch.tensor([[1.0, 2.0, 3.0]]), places())
    torch.testing.assert_close(found, torch.tensor([2.0, 4.0, 6.0]).expand(len(found), 3))


def test_what_does_not_fit_is_refused():
    basis, coefficients, uv = random(4, HEIGHT, WIDTH), random(4, 3), places()
    for shape in ((4, HEIGHT), (4, HEIGHT, WIDTH, 2), (0, HEIGHT, WIDTH)):
        with pytest.raises(PrtError, match="a lightmap basis of shape"):
            Blender(torch.zeros(shape))
    for wrong in (coefficients[:3], coefficients[:, :1], coefficients[:, 0]):
        with pytest.raises(PrtError, match="do not fit a basis of 4 elements"):
            blend(basis, wrong, uv)
    for gamma in (0.0, -1.0, math.nan):
        with pytest.raises(PrtError, match="gamma=.* must be above 0"):
            blend(basis, coefficients, uv, gamma)


@pytest.mark.parametrize("device", ["cpu", *(["cuda"] if torch.cuda.is_available() else [])])
@pytest.mark.parametrize("channels", [1, 3])
def test_every_device_here_agrees_with_the_cpu(channels, device):
    basis, coefficients, uv = random(6, HEIGHT, WIDTH, channels), random(6, 3, seed=2), places()
    cpu, other = Blender(basis), Blender(basis.to(device))
    for order in ("blend_first", "sample_first"):
        expected = getattr(cpu, order)(coefficients, uv)
        found = getattr(other, order)(coefficients.to(device), uv.to(device)).cpu()
        torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)

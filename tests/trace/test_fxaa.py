import time

import pytest
import torch

from prt.errors import PrtError
from prt.trace.fxaa import fxaa

SIDE = 64


def half_plane(slope: float, samples: int, low: float = 0.1, high: float = 0.8) -> torch.Tensor:
    """A bright half-plane over a dark one, ``samples`` squared a pixel; the edge goes through the middle."""
    place = (torch.arange(SIDE * samples) + 0.5) / samples - SIDE / 2
    inside = (place[:, None] - 0.3 < slope * place).float()
    share = inside.view(SIDE, samples, SIDE, samples).mean((1, 3))
    return (low + (high - low) * share)[..., None].repeat(1, 1, 3)


def rmse(a: torch.Tensor, b: torch.Tensor) -> float:
    return (a - b).square().mean().sqrt().item()


@pytest.mark.parametrize("value", [0.0, 0.37, 1.0, 1e5])
def test_constant_image_is_unchanged(value):
    image = torch.full((9, 13, 3), value) * torch.tensor([1.0, 0.7, 0.1])
    assert torch.equal(fxaa(image), image)


@pytest.mark.parametrize("turned", [False, True])
def test_edge_along_an_axis_is_unchanged(turned):
    image = half_plane(0.0, 1)
    image = image.transpose(0, 1).contiguous() if turned else image
    torch.testing.assert_close(fxaa(image), image, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("slope", "factor"), [(0.1, 1.7), (0.2, 3.5), (0.3, 1.5), (0.7, 1.8), (1.0, 1.3), (-0.2, 3.5), (5.0, 2.5)]
)
def test_slanted_edge_comes_closer_to_a_supersampled_one(slope, factor):
    jagged, smooth = half_plane(slope, 1), half_plane(slope, 16)
    assert rmse(fxaa(jagged), smooth) * factor < rmse(jagged, smooth)


@pytest.mark.parametrize("slope", [0.05, 0.3, 1.0, 2.0])
def test_energy_stays(slope):
    image = half_plane(slope, 1, low=0.01, high=3.0)
    assert fxaa(image).mean() / image.mean() == pytest.approx(1, abs=0.01)


def test_a_larger_radius_smooths_longer_steps():
    jagged, smooth = half_plane(0.05, 1), half_plane(0.05, 16)
    errors = [rmse(fxaa(jagged, radius=radius), smooth) for radius in (2.0, 4.0, 8.0)]
    assert errors == sorted(errors, reverse=True)


def test_edges_are_those_that_are_seen():
    """Where both sides are clipped to white there is no edge; a lower exposure shows it."""
    image = half_plane(0.3, 1, low=2.0, high=9.0)
    assert torch.equal(fxaa(image), image)
    assert not torch.equal(fxaa(image, exposure=0.1), image)


def test_scale_of_radiance_and_exposure_cancel():
    image = half_plane(0.3, 1)
    torch.testing.assert_close(fxaa(image * 64, exposure=1 / 64), fxaa(image) * 64)


def test_very_bright_pixels():
    generator = torch.Generator().manual_seed(0)
    image = torch.rand((SIDE, SIDE, 3), generator=generator)
    image[torch.rand((SIDE, SIDE), generator=generator) < 0.1] = 1e5
    out = fxaa(image)
    assert torch.isfinite(out).all() and out.min() >= 0 and out.max() <= 1e5


def test_colours_stay_between_those_around():
    image = torch.rand((20, 30, 3), generator=torch.Generator().manual_seed(0))
    out = fxaa(image)
    pool = torch.nn.MaxPool2d(7, 1, 3)
    high, low = pool(image.permute(2, 0, 1)[None])[0], -pool(-image.permute(2, 0, 1)[None])[0]
    assert (out <= high.permute(1, 2, 0) + 1e-6).all() and (out >= low.permute(1, 2, 0) - 1e-6).all()


@pytest.mark.parametrize("size", [(0, 4), (1, 1), (1, 5), (2, 2), (3, 2)])
def test_images_smaller_than_the_kernel(size):
    image = torch.rand((*size, 3), generator=torch.Generator().manual_seed(0))
    before = image.clone()
    out = fxaa(image)
    assert out.shape == image.shape and torch.isfinite(out).all()
    assert torch.equal(image, before)


def test_is_fast():
    """An image of blocks with slanted edges; the limit is for a core that is shared."""
    image = half_plane(0.3, 1).repeat(4, 4, 1)
    seconds = []
    for _ in range(5):
        start = time.process_time()
        fxaa(image)
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.02


@pytest.mark.parametrize("setting", ["exposure", "radius"])
def test_mistakes(setting):
    with pytest.raises(PrtError, match=setting):
        fxaa(torch.zeros(4, 4, 3), **{setting: 0.0})

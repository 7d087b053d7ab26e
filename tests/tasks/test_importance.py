"""The statistics behind the sampling strategies, on images and points whose answers are known."""

import pytest
import torch

from prt.scene.gbuffer import GBuffer
from prt.tasks import importance


def gbuffer(specular, roughness) -> GBuffer:
    count = len(roughness)
    zero = torch.zeros((count, 3))
    return GBuffer(zero, zero, zero, zero, zero, torch.tensor(specular), torch.tensor(roughness)[:, None],
                   torch.zeros((count, 2)), torch.ones(count, dtype=torch.bool))  # fmt: skip


def test_specular_is_k_s_times_one_minus_sigma():
    found = importance.specular(gbuffer([[0.3, 0.6, 0.9], [1.0, 1.0, 1.0], [0.5, 0.5, 0.5]], [0.5, 0.0, 1.0]))
    assert found.tolist() == pytest.approx([0.3, 1.0, 0.0])


def test_high_frequency_is_zero_on_a_flat_image_even_beside_the_background():
    image, hit = torch.full((12, 12, 3), 0.7), torch.ones(144, dtype=torch.bool)
    hit.view(12, 12)[:, 5:] = False
    hit.view(12, 12)[8, 9] = True  # one pixel all alone
    image.view(144, 3)[~hit] = 0
    found = importance.high_frequency(image, hit)
    assert found.shape == (61,) and found.max() < 1e-6


def test_high_frequency_finds_an_edge_and_only_there():
    image, hit = torch.zeros((9, 20, 3)), torch.ones(180, dtype=torch.bool)
    image[:, 10:] = 1.0
    found = importance.high_frequency(image, hit, radius=2).view(9, 20)
    # in the column beside the edge two of five columns of the window are on the other side
    assert found[4].tolist() == pytest.approx([0] * 8 + [0.2, 0.4, 0.4, 0.2] + [0] * 8, abs=1e-6)


def test_high_frequency_of_an_empty_view():
    assert importance.high_frequency(torch.zeros((4, 4, 3)), torch.zeros(16, dtype=torch.bool)).shape == (0,)


def test_view_variance_is_between_views_not_within_one():
    # two places on the surface, three views; each view sees each place with two points of mean 1 + shift
    corners = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    place = torch.arange(2).repeat_interleave(6)
    view = torch.arange(3).repeat_interleave(2).repeat(2)
    shift = torch.where(place == 1, view.float() * 3, torch.zeros(12))
    spread = torch.tensor([-0.5, 0.5]).repeat(6)  # within one view and place: texture, not a view effect
    radiance = (1 + shift + spread)[:, None].expand(12, 3)
    found = importance.view_variance(corners[place], radiance, view, cells=4)
    assert found.tolist() == pytest.approx([0.0] * 6 + [6.0] * 6, abs=1e-5)  # variance of 0, 3, 6


def test_a_place_seen_by_one_view_has_no_variance():
    position = torch.rand((50, 3), generator=torch.Generator().manual_seed(0))
    found = importance.view_variance(position, 10 * position, torch.zeros(50, dtype=torch.int64), cells=2)
    assert found.shape == (50,) and found.abs().max() < 1e-6

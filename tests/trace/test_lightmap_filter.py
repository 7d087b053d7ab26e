"""Lightmaps of hair share paths with the nearest texels in space, not with those beside them in the map."""

from types import SimpleNamespace

import torch

from prt.scene.lightmap_points import Sites
from prt.trace import lightmap_filter


def two_bundles() -> tuple[Sites, torch.Tensor]:
    """40 texels, even ones in one place and odd ones far away, two sites each; texel 5 is not covered."""
    texel = torch.arange(40).repeat_interleave(2)
    texel = texel + (texel >= 5).long()
    side = (texel % 2).float()
    position = torch.stack(
        [10 * side, torch.rand(80, generator=torch.Generator().manual_seed(1)), 0 * side], 1
    )
    return Sites(texel, position, torch.zeros_like(position), (1, 41)), side[::2]


def test_the_mean_stays_in_its_own_bundle_and_loses_noise():
    sites, side = two_bundles()
    noise = torch.randn((40, 3), generator=torch.Generator().manual_seed(0))
    values = 5 * side[:, None] + noise
    out = lightmap_filter.filtered(SimpleNamespace(filterable=False), values, sites)
    assert out.shape == (40, 3)
    assert (out - 5 * side[:, None]).square().mean() < 0.15 * noise.square().mean()


def test_a_texel_is_its_own_nearest():
    sites, _ = two_bundles()
    assert lightmap_filter.nearest_texels(sites, 3)[:, 0].tolist() == list(range(40))


def test_a_single_texel_keeps_its_value():
    sites = Sites(torch.tensor([7]), torch.zeros((1, 3)), torch.zeros((1, 3)), (3, 3))
    values = torch.ones((1, 3))
    assert torch.equal(lightmap_filter.filtered(SimpleNamespace(filterable=False), values, sites), values)

"""Lamps added to training environments: unit mean, concentrated, everywhere, and the same for equal seeds."""

import torch

from prt.light.cubemap import mean_radiance, texel_directions, texel_solid_angles
from prt.light.lamps import SHARE, lamp_directions, with_lamps

RESOLUTION = 32


def constant(count: int = 2) -> torch.Tensor:
    return torch.ones(count, 6, RESOLUTION, RESOLUTION, 3)


def test_every_environment_has_unit_mean_radiance():
    made = with_lamps(7 * constant(), 20, seed=0)
    torch.testing.assert_close(mean_radiance(made).mean(-1), torch.ones(20), rtol=1e-4, atol=0)


def test_a_lamp_carries_the_stated_share_of_the_light_about_one_direction():
    angle = texel_solid_angles(RESOLUTION).reshape(-1, 1)
    directions = texel_directions(RESOLUTION).reshape(-1, 3)
    for made in with_lamps(constant(), 30, seed=1):
        energy = (made.reshape(-1, 3) * angle).mean(1)
        # what lies above the constant environment is the lamp
        lamp = (energy - energy.min() / angle.min() * angle[:, 0]).clamp(min=0)
        assert SHARE[0] - 0.05 < float(lamp.sum() / energy.sum()) < SHARE[1] + 0.05
        brightest = directions[lamp.argmax()]
        near = directions @ brightest > 0.2
        assert float(lamp[near].sum() / lamp.sum()) > 0.9


def test_lamps_come_from_everywhere():
    directions = lamp_directions(4000, torch.Generator().manual_seed(0))
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(4000))
    assert directions.mean(dim=0).abs().max() < 0.05
    torch.testing.assert_close(directions.square().mean(dim=0), torch.full((3,), 1 / 3), atol=0.02, rtol=0)


def test_equal_seeds_give_equal_lights_and_none_is_none():
    assert torch.equal(with_lamps(constant(), 5, seed=3), with_lamps(constant(), 5, seed=3))
    assert not torch.equal(with_lamps(constant(), 5, seed=3), with_lamps(constant(), 5, seed=4))
    assert with_lamps(constant(), 0, seed=3).shape == (0, 6, RESOLUTION, RESOLUTION, 3)


def test_a_black_environment_gives_the_lamp_alone():
    made = with_lamps(0 * constant(), 3, seed=0)
    assert torch.isfinite(made).all() and (mean_radiance(made).mean(-1) > 0.1).all()

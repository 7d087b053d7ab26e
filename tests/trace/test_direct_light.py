"""The ray-traced truth: closed forms, energy of the lobe, and shadows."""

import math

import pytest
import torch
from surfaces import Ground

from prt.light.cubemap import texel_directions, texel_solid_angles
from prt.trace.direct_light import direct_light

UP = torch.tensor([0.0, 1.0, 0.0])


def shaded(
    lighting, diffuse=0.0, specular=0.0, exponent=20.0, reflected=UP, wall=False, many=64, samples=256
):
    one = torch.ones((many, 3))
    return direct_light(
        Ground(wall), 0 * one, UP.expand(many, 3), reflected.expand(many, 3), diffuse * one, specular * one,
        exponent * one[:, 0], lighting, samples, 0,
    ).mean(0)  # fmt: skip


def test_constant_light_gives_the_albedo():
    light = torch.ones((6, 8, 8, 3))
    torch.testing.assert_close(shaded(light, diffuse=0.7), torch.full((3,), 0.7), atol=0.01, rtol=0)
    torch.testing.assert_close(
        shaded(light, diffuse=0.7, wall=True), torch.full((3,), 0.35), atol=0.01, rtol=0
    )


def test_many_coloured_light_agrees_with_a_sum_over_texels():
    R = 16
    light = torch.rand((6, R, R, 3), generator=torch.Generator().manual_seed(0)) ** 8
    fine = light.repeat_interleave(8, 1).repeat_interleave(8, 2).reshape(-1, 3)
    d, area = texel_directions(8 * R).reshape(-1, 3), texel_solid_angles(8 * R).reshape(-1, 1)
    cosine = d[:, 1:2].clamp_min(0)
    summed = (0.5 / math.pi * cosine * area * fine).sum(0)
    torch.testing.assert_close(shaded(light, diffuse=0.5, many=256), summed, rtol=0.02, atol=0)
    reflected = torch.nn.functional.normalize(torch.tensor([1.0, 1.0, 0.5]), dim=0)
    lobe = 22 / (2 * math.pi) * (d @ reflected).clamp_min(0)[:, None] ** 20
    summed = (0.5 * lobe * cosine * area * fine).sum(0)
    found = shaded(light, specular=0.5, reflected=reflected, many=256)
    torch.testing.assert_close(found, summed, rtol=0.02, atol=0)


def test_both_lobes_add():
    light = torch.rand((6, 8, 8, 3), generator=torch.Generator().manual_seed(1))
    both = shaded(light, diffuse=0.4, specular=0.3, many=512)
    apart = shaded(light, diffuse=0.4, many=512) + shaded(light, specular=0.3, many=512)
    torch.testing.assert_close(both, apart, rtol=0.02, atol=0)


def test_one_bright_texel_and_darkness():
    light = torch.zeros((6, 8, 8, 3))
    assert shaded(light, diffuse=1.0).tolist() == [0, 0, 0]
    light[2, 4, 4] = 100.0
    d, area = texel_directions(8)[2, 4, 4], texel_solid_angles(8)[2, 4, 4]
    expected = 100 / math.pi * float(d[1]) * float(area)
    assert float(shaded(light, diffuse=1.0, many=256)[0]) == pytest.approx(expected, rel=0.03)

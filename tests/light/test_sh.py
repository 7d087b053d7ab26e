import math

import pytest
import torch

from prt.errors import PrtError
from prt.light import sh
from prt.light.cubemap import texel_directions, texel_solid_angles


def test_first_harmonics_are_the_documented_ones():
    d = torch.nn.functional.normalize(torch.tensor([[0.3, -0.5, 0.8], [1.0, 2.0, -2.0]]), dim=1)
    basis = sh.sh_basis(d, 2)
    c = math.sqrt(3 / (4 * math.pi))
    torch.testing.assert_close(basis[:, 0], torch.full((2,), math.sqrt(1 / (4 * math.pi))))
    torch.testing.assert_close(basis[:, 1:4], c * d[:, [1, 2, 0]])
    # degree 2, order 0: sqrt(5 / 16 pi) (3 z^2 - 1); order -2: sqrt(15 / 4 pi) x y
    torch.testing.assert_close(basis[:, 6], math.sqrt(5 / (16 * math.pi)) * (3 * d[:, 2] ** 2 - 1))
    torch.testing.assert_close(basis[:, 4], math.sqrt(15 / (4 * math.pi)) * d[:, 0] * d[:, 1])


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_lower_degrees_are_prefixes(degree):
    d = torch.nn.functional.normalize(torch.randn(10, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    torch.testing.assert_close(sh.sh_basis(d, degree), sh.sh_basis(d, 4)[:, : (degree + 1) ** 2])


@pytest.mark.parametrize("degree", [4, 12])
def test_orthonormal_by_cubemap_quadrature(degree):
    R = 96
    basis = sh.sh_basis(texel_directions(R, torch.float64).reshape(-1, 3), degree)
    gram = basis.T @ (basis * texel_solid_angles(R, torch.float64).reshape(-1, 1))
    torch.testing.assert_close(gram, torch.eye(len(gram), dtype=torch.float64), atol=3e-3, rtol=0)


def test_high_degrees_stay_finite_and_obey_the_addition_theorem():
    d = torch.tensor(
        [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.6, 0.0, 0.8]], dtype=torch.float64
    )
    degree = 60
    basis = sh.sh_basis(d, degree)
    for l in (1, 7, degree):
        power = basis[:, l * l : (l + 1) ** 2].square().sum(1)
        torch.testing.assert_close(power, torch.full_like(power, (2 * l + 1) / (4 * math.pi)))


def test_projection_and_evaluation_of_a_band_limited_function():
    d = texel_directions(32)
    cubemap = torch.stack([1 + d[..., 0], d[..., 1] * d[..., 2], 2 * d[..., 2] ** 2], -1)
    seen = sh.evaluate(sh.project(cubemap, 2), d.reshape(-1, 3)).reshape(cubemap.shape)
    torch.testing.assert_close(seen, cubemap, atol=5e-3, rtol=0)


def test_projection_is_batched():
    batch = torch.rand((3, 6, 4, 4, 3), generator=torch.Generator().manual_seed(0))
    assert sh.project(batch, 3).shape == (3, 16, 3)
    torch.testing.assert_close(sh.project(batch, 3)[1], sh.project(batch[1], 3))


def test_wrong_degrees_and_counts_are_errors():
    with pytest.raises(PrtError, match="degree=-1"):
        sh.sh_basis(torch.ones((1, 3)), -1)
    with pytest.raises(PrtError, match="5 spherical"):
        sh.evaluate(torch.ones((5, 3)), torch.ones((1, 3)))

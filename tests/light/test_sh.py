import math

import numpy as np
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


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_lower_degrees_are_prefixes(degree):
    d = torch.nn.functional.normalize(torch.randn(10, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    torch.testing.assert_close(sh.sh_basis(d, degree), sh.sh_basis(d, 4)[:, : (degree + 1) ** 2])


def sphere_quadrature(count: int = 24) -> tuple[torch.Tensor, torch.Tensor]:
    """Directions and weights that integrate polynomials of degree below 2 * count exactly."""
    z, weight = (torch.tensor(a, dtype=torch.float64) for a in np.polynomial.legendre.leggauss(count))
    phi = torch.arange(2 * count, dtype=torch.float64) * math.pi / count
    radius = (1 - z**2).sqrt()[:, None]
    directions = torch.stack([radius * phi.cos(), radius * phi.sin(), z[:, None].expand(-1, 2 * count)], -1)
    return directions.reshape(-1, 3), (weight[:, None] * math.pi / count).expand(-1, 2 * count).reshape(-1)


def test_orthonormal_to_rounding():
    directions, weight = sphere_quadrature()
    basis = sh.sh_basis(directions, 4)
    torch.testing.assert_close(basis.T @ (weight[:, None] * basis), torch.eye(25, dtype=torch.float64))


def test_bands_rotate_within_themselves():
    # Sums of squares over a band do not depend on the direction (Unsoeld): catches a value in the wrong band.
    generator = torch.Generator().manual_seed(0)
    directions = torch.randn(50, 3, dtype=torch.float64, generator=generator)
    basis = sh.sh_basis(torch.nn.functional.normalize(directions, dim=1), 4)
    for band in range(5):
        energy = basis[:, band**2 : (band + 1) ** 2].square().sum(1)
        torch.testing.assert_close(energy, torch.full_like(energy, (2 * band + 1) / (4 * math.pi)))


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
    with pytest.raises(PrtError, match="degree=2.5"):
        sh.sh_basis(torch.ones((1, 3)), 2.5)
    with pytest.raises(PrtError, match="5 spherical"):
        sh.evaluate(torch.ones((5, 3)), torch.ones((1, 3)))

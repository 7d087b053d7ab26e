"""Triple products, the Phong lobe and the window against numerical integration and closed forms."""

import math

import pytest
import torch

from prt.errors import PrtError
from prt.light.cubemap import texel_directions, texel_solid_angles
from prt.light.sh import sh_basis
from prt.light.sh_products import band_of, bands_of, phong_bands, product_matrix, triple_products, window

R = 64


def sphere():
    """Directions and solid angles, float64."""
    return (
        texel_directions(R, torch.float64).reshape(-1, 3),
        texel_solid_angles(R, torch.float64).reshape(-1),
    )


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_the_tensor_is_the_integral_of_three_harmonics(order):
    directions, area = sphere()
    basis = sh_basis(directions, order - 1)
    integrated = torch.einsum("n,ni,nj,nk->ijk", area, basis, basis, basis)
    index, value = triple_products(order)
    dense = torch.zeros_like(integrated)
    dense[tuple(index)] = value
    torch.testing.assert_close(dense, integrated, atol=2e-3, rtol=0)
    # symmetric in all three, and sparse
    torch.testing.assert_close(dense, dense.permute(2, 0, 1))
    torch.testing.assert_close(dense, dense.permute(1, 0, 2))
    if order == 4:
        assert len(value) == 353


def test_the_constant_function_multiplies_by_itself():
    coeffs = torch.zeros((16, 3))
    coeffs[0] = 2 * math.sqrt(4 * math.pi)
    matrix = product_matrix(coeffs)
    torch.testing.assert_close(matrix, 2 * torch.eye(16)[..., None].expand(16, 16, 3))


def test_the_product_matrix_multiplies_functions():
    # two functions of two bands have a product of three: no band is cut off
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.zeros((9, 1)) for _ in range(2))
    a[:4], b[:4] = torch.randn((2, 4, 1), generator=generator)
    product = product_matrix(a)[..., 0] @ b
    directions, _ = sphere()
    basis = sh_basis(directions.float(), 2)
    torch.testing.assert_close(basis @ product, (basis @ a) * (basis @ b), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 8.0, 50.5])
def test_the_lobe_convolves_like_its_integral(exponent):
    order = 5
    x, weight = (torch.from_numpy(part) for part in __import__("numpy").polynomial.legendre.leggauss(400))
    x, weight = (x + 1) / 2, weight / 2
    directions = torch.stack([(1 - x**2).sqrt(), torch.zeros_like(x), x], 1)
    zonal = sh_basis(directions, order - 1)
    expected = []
    for l in range(order):
        legendre = zonal[:, l * l + l] * math.sqrt(4 * math.pi / (2 * l + 1))
        expected.append(float((weight * (exponent + 2) * x**exponent * legendre).sum()))
    found = phong_bands(torch.tensor([exponent], dtype=torch.float64), order)[0]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), atol=1e-4, rtol=1e-4)


def test_a_sharp_lobe_is_a_mirror():
    torch.testing.assert_close(phong_bands(torch.tensor([1e5]), 4), torch.ones((1, 4)), atol=2e-4, rtol=0)


def test_the_window_damps_the_upper_bands_only():
    assert torch.equal(window(4, 0.0), torch.ones(16))
    damped = window(4, 0.01)
    assert damped[0] == 1 and bool((damped.diff() <= 0).all()) and damped[-1] < 0.5
    with pytest.raises(PrtError, match=r"window=-1 must be 0"):
        window(4, -1)


def test_bands():
    assert band_of(3).tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 2]
    assert bands_of(25) == 5
    with pytest.raises(PrtError, match="10 spherical harmonics"):
        bands_of(10)

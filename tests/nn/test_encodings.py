import math

import pytest
import torch

from prt.errors import PrtError
from prt.nn.encodings import log_roughness, one_blob, sh_encode


def sphere_quadrature(count: int = 24) -> tuple[torch.Tensor, torch.Tensor]:
    """Directions and weights that integrate polynomials of degree below 2 * count exactly."""
    import numpy as np

    z, weight = (torch.tensor(a, dtype=torch.float64) for a in np.polynomial.legendre.leggauss(count))
    phi = torch.arange(2 * count, dtype=torch.float64) * math.pi / count
    radius = (1 - z**2).sqrt()[:, None]
    directions = torch.stack([radius * phi.cos(), radius * phi.sin(), z[:, None].expand(-1, 2 * count)], -1)
    return directions.reshape(-1, 3), (weight[:, None] * math.pi / count).expand(-1, 2 * count).reshape(-1)


def test_sh_is_orthonormal():
    directions, weight = sphere_quadrature()
    basis = sh_encode(directions, 4)
    assert basis.shape == (len(directions), 25)
    torch.testing.assert_close(basis.T @ (weight[:, None] * basis), torch.eye(25, dtype=torch.float64))


def test_sh_bands_rotate_within_themselves():
    # Sums of squares over a band do not depend on the direction (Unsoeld): catches a value in the wrong band.
    generator = torch.Generator().manual_seed(0)
    directions = torch.randn(50, 3, dtype=torch.float64, generator=generator)
    basis = sh_encode(torch.nn.functional.normalize(directions, dim=1), 4)
    for band in range(5):
        energy = basis[:, band**2 : (band + 1) ** 2].square().sum(1)
        torch.testing.assert_close(energy, torch.full_like(energy, (2 * band + 1) / (4 * math.pi)))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_lower_degrees_are_prefixes(degree):
    directions = torch.nn.functional.normalize(torch.randn(10, 3), dim=1)
    whole = sh_encode(directions, 4)
    torch.testing.assert_close(sh_encode(directions, degree), whole[:, : (degree + 1) ** 2])


def test_sh_degree_out_of_range():
    with pytest.raises(PrtError, match="degree=5"):
        sh_encode(torch.randn(1, 3), 5)


def test_one_blob_peaks_in_its_bin():
    code = one_blob(torch.tensor([[0.1, 0.9]]), 5)
    assert code.shape == (1, 10)
    assert code[0, :5].argmax() == 0 and code[0, 5:].argmax() == 4
    assert code[0, 0] == 1 and code[0, 9] == 1  # bin centres
    torch.testing.assert_close(code[0, 1], torch.tensor(math.exp(-0.5)))


def test_log_roughness():
    values = log_roughness(torch.tensor([0.0, 0.2, 1.0]))
    torch.testing.assert_close(values, torch.tensor([0.0, math.log(6) / math.log(26), 1.0]))

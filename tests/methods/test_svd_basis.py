"""Basis and transfer on pairs with a known answer."""

import pytest
import torch

from prt.errors import PrtError
from prt.methods.svd_basis import condition, error_curve, extract, norm_of, normalised, transfer_matrix


def low_rank(count=40, texels=300, points=12, rank=3, seed=0):
    """Indirect light that is a fixed linear map of direct light, of a given rank."""
    g = torch.Generator().manual_seed(seed)
    light = torch.rand((count, rank), generator=g)
    to_direct = torch.rand((rank, points), generator=g)
    to_indirect = torch.rand((rank, texels), generator=g)
    return light @ to_direct, light @ to_indirect, to_direct, to_indirect


def test_basis_is_orthonormal_and_spans_a_low_rank_transport():
    direct, indirect, _, _ = low_rank()
    pairs = normalised(direct, indirect)
    basis = extract(pairs.indirect)
    significant = int((basis.eigenvalues > 1e-6 * basis.eigenvalues[0]).sum())
    assert significant <= 3
    vectors = basis.vectors[:significant]
    assert torch.allclose(vectors @ vectors.T, torch.eye(significant), atol=1e-4)
    again = basis.mean + basis.coefficients[:, :significant].float() @ vectors
    assert torch.allclose(again, pairs.indirect, atol=1e-5)
    # the eigenvalues are the summed squares of the coefficients, as in any principal component analysis
    assert torch.allclose(basis.coefficients.square().sum(0)[:significant], basis.eigenvalues[:significant])
    assert bool((basis.eigenvalues.diff() <= 0).all())


@pytest.mark.parametrize("kind", ["l2", "l1"])
def test_transfer_reproduces_a_linear_transport_on_unseen_light(kind):
    direct, indirect, to_direct, to_indirect = low_rank()
    pairs = normalised(direct, indirect, kind)
    basis = extract(pairs.indirect)
    transfer = transfer_matrix(pairs.direct, basis.coefficients, None).float()
    light = torch.tensor([[0.2, 3.0, 1.5]])
    d, y = light @ to_direct, light @ to_indirect
    found = norm_of(d, kind)[:, None] * basis.mean + d @ transfer @ basis.vectors
    error = float((found - y).norm() / y.norm())
    # with l2 the weight of the mean is not linear in the light: exact only up to that
    assert error < (1e-3 if kind == "l1" else 0.05)


def test_tikhonov_is_the_same_from_either_gram_matrix():
    g = torch.Generator().manual_seed(1)
    for shape in ((5, 9), (9, 5)):
        d, c = torch.rand(shape, generator=g).double(), torch.rand((shape[0], 2), generator=g).double()
        direct = torch.linalg.inv(d.T @ d + 0.1 * torch.eye(shape[1])) @ d.T @ c
        assert torch.allclose(transfer_matrix(d, c, 0.1), direct, atol=1e-10)


def test_lambda_shrinks_the_transfer_and_the_condition_number():
    g = torch.Generator().manual_seed(2)
    d = torch.rand((30, 8), generator=g)
    d[:, 1] = d[:, 0] + 1e-4 * torch.rand(30, generator=g)  # a near-duplicate measurement
    c = torch.rand((30, 3), generator=g)
    norms = [float(transfer_matrix(d, c, value).norm()) for value in (0.0, 1e-4, 1e-2, 1.0)]
    assert norms == sorted(norms, reverse=True) and norms[0] > 10 * norms[2]
    conditions = [condition(d, value) for value in (0.0, 1e-4, 1e-2)]
    assert conditions[0] > 1e6 > conditions[1] > conditions[2]


def test_error_curve_is_the_error_of_the_reconstruction():
    g = torch.Generator().manual_seed(3)
    direct, indirect = torch.rand((30, 10), generator=g), torch.rand((30, 80), generator=g)
    pairs, unseen = normalised(direct[:20], indirect[:20]), normalised(direct[20:], indirect[20:])
    basis = extract(pairs.indirect)
    transfer = transfer_matrix(pairs.direct, basis.coefficients, 0.1)
    error, bound = error_curve(basis, transfer, unseen)
    for n in (1, 4, 12):
        u = basis.vectors[: n - 1]
        y = unseen.norm[:, None] * (basis.mean + unseen.direct @ transfer[:, : n - 1].float() @ u)
        left = indirect[20:] - unseen.norm[:, None] * basis.mean
        expected = float((y - indirect[20:]).norm() / indirect[20:].norm())
        best = float((left - left @ u.T @ u).norm() / indirect[20:].norm())
        assert float(error[n - 1]) == pytest.approx(expected, rel=1e-3)
        assert float(bound[n - 1]) == pytest.approx(best, rel=1e-3)
    assert bool((bound.diff() <= 1e-9).all()) and bool((error >= bound - 1e-9).all())


def test_black_pairs_are_left_out_and_all_black_is_one_line():
    direct, indirect = torch.rand((4, 3)), torch.rand((4, 5))
    direct[1] = 0
    assert len(normalised(direct, indirect).norm) == 3
    with pytest.raises(PrtError, match="every training configuration is black") as caught:
        normalised(torch.zeros((2, 3)), torch.ones((2, 5)))
    assert "\n" not in str(caught.value)
    with pytest.raises(PrtError, match="NaN"):
        normalised(torch.full((2, 3), torch.nan), torch.ones((2, 5)))
    with pytest.raises(PrtError, match="method.regularisation=-1 must be at least 0"):
        transfer_matrix(direct, indirect, -1)

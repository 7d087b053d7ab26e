import pytest
import torch

from prt.errors import PrtError
from prt.light import haar
from prt.light.cubemap import texel_directions

GENERATOR = torch.Generator().manual_seed(0)


@pytest.mark.parametrize("R", [1, 2, 8, 32])
def test_inverse_undoes_the_transform(R):
    values = torch.randn((2, 6, R, R, 3), generator=GENERATOR)
    torch.testing.assert_close(haar.inverse_haar2d(haar.haar2d(values)), values, atol=1e-5, rtol=1e-5)


def test_orthonormal():
    R = 4
    basis = haar.inverse_haar2d(torch.eye(6 * R * R)[..., None])[..., 0]
    torch.testing.assert_close(basis @ basis.T, torch.eye(6 * R * R), atol=1e-6, rtol=0)


def test_dot_product_is_the_same_over_texels_and_wavelets():
    a, b = torch.randn((2, 6, 16, 16, 3), generator=GENERATOR)
    torch.testing.assert_close((haar.haar2d(a) * haar.haar2d(b)).sum(), (a * b).sum(), rtol=1e-4, atol=1e-3)


def test_fast_equals_readable():
    values = torch.randn((6, 16, 16, 2), generator=GENERATOR, dtype=torch.float64)
    fast = haar.haar2d(values)
    for face in range(6):
        for channel in range(2):
            torch.testing.assert_close(
                fast[face, ..., channel], haar.haar2d_readable(values[face, ..., channel])
            )


def test_flat_and_shaped_agree_and_the_input_is_left_alone():
    values = torch.randn((5, 6, 8, 8, 3), generator=GENERATOR)
    before = values.clone()
    flat = haar.haar2d(values.reshape(5, -1, 3))
    assert torch.equal(flat, haar.haar2d(values).reshape(5, -1, 3))
    assert torch.equal(values, before)


def test_constant_map_has_one_coefficient_per_face():
    coeffs = haar.haar2d(torch.full((6, 8, 8, 1), 3.0))
    assert torch.equal(coeffs[:, 0, 0], torch.full((6, 1), 24.0))
    assert coeffs.count_nonzero() == 6


def test_resolution_must_be_a_power_of_two():
    with pytest.raises(PrtError, match="power of two"):
        haar.haar2d(torch.ones((6, 12, 12, 3)))
    with pytest.raises(PrtError, match="6 R R"):
        haar.haar2d(torch.ones((100, 3)))


@pytest.mark.parametrize("R", [1, 2, 8])
def test_wavelet_at_is_the_inverse_of_a_one_hot(R):
    basis = haar.inverse_haar2d(torch.eye(6 * R * R)[..., None])[..., 0]
    index = torch.arange(6 * R * R)
    d = texel_directions(R).reshape(-1, 3)
    torch.testing.assert_close(haar.wavelet_at(index, d, R), basis.T)
    torch.testing.assert_close(haar.wavelet_at(5, d, R), basis[5])
    assert torch.equal(haar.support_size(index, R) ** 2, (basis != 0).sum(1))


def test_wavelet_at_refuses_an_index_out_of_range():
    with pytest.raises(PrtError, match="0 to 23"):
        haar.wavelet_at(24, torch.ones((1, 3)), 2)


def test_top_k_by_magnitude_is_the_best_approximation():
    lighting = torch.rand((6, 8, 8, 3), generator=GENERATOR) ** 6
    coeffs = haar.haar2d(lighting).reshape(-1, 3)
    index = haar.top_k(coeffs, 40)
    norms = coeffs.norm(dim=-1)
    assert index.unique().numel() == 40
    assert (norms[index].diff() <= 0).all()
    dropped = torch.ones(384, dtype=torch.bool)
    dropped[index] = False
    assert norms[dropped].max() <= norms[index].min()
    error = (haar.keep_only(coeffs, index) - coeffs).square().sum()
    torch.testing.assert_close(error, norms[dropped].square().sum())


def test_ties_go_to_the_lower_index_and_a_black_map_still_gives_k():
    assert haar.top_k(torch.zeros((24, 3)), 7).tolist() == list(range(7))


def test_area_weighting_prefers_large_supports():
    R = 8
    coeffs = torch.zeros((6 * R * R, 3))
    coeffs[R * R - 1] = 10.0  # finest: 2 x 2 texels
    coeffs[1] = 1.0  # coarsest detail: 8 x 8 texels
    assert haar.top_k(coeffs, 2).tolist() == [R * R - 1, 1]
    assert haar.top_k(coeffs, 2, "area").tolist() == [1, R * R - 1]


def test_transport_weighting_with_one_scale_or_one_per_channel():
    coeffs = torch.ones((24, 3))
    coeffs[3] = 2.0
    scale = torch.ones(24)
    scale[9] = 5.0
    assert haar.top_k(coeffs, 2, "transport", scale).tolist() == [9, 3]
    per_channel = torch.ones((24, 3))
    per_channel[11, 1] = 50.0
    assert haar.top_k(coeffs, 2, "transport", per_channel).tolist() == [11, 3]


def test_top_k_is_batched():
    coeffs = torch.randn((4, 24, 3), generator=GENERATOR)
    together = haar.top_k(coeffs, 5, "area")
    assert torch.equal(together, torch.stack([haar.top_k(one, 5, "area") for one in coeffs]))


@pytest.mark.parametrize(
    "change, message",
    [
        ({"k": 25}, "K=25"),
        ({"k": 0}, "K=0"),
        ({"how": "size"}, "magnitude, area, transport"),
        ({"how": "transport"}, "needs a scale"),
        ({"how": "transport", "scale": torch.ones(5)}, "got \\(5,\\)"),
    ],
)
def test_wrong_selections_are_errors(change, message):
    with pytest.raises(PrtError, match=message):
        haar.top_k(torch.ones((24, 3)), **{"k": 3, **change})

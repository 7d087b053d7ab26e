"""sigma_k on transport that is exact, and on noise, where the answers are known."""

import pytest
import torch

from prt.light import haar
from prt.scene.gbuffer import GBuffer
from prt.trace.statistics import clusters, wavelet_scale
from prt.trace.transport import Transport

RESOLUTION = 4
TEXELS = 6 * RESOLUTION**2


def points(position, wr) -> GBuffer:
    count = len(position)
    zero = torch.zeros((count, 3))
    return GBuffer(position, zero, zero, wr, zero, zero, torch.zeros((count, 1)), torch.zeros((count, 2)),
                   torch.ones(count, dtype=torch.bool))  # fmt: skip


def exact(rows: torch.Tensor) -> Transport:
    """Dense rows (N, T, 3) as a record with one sample per texel."""
    count = len(rows)
    return Transport(
        RESOLUTION, torch.arange(count + 1) * TEXELS, torch.arange(TEXELS).repeat(count).to(torch.int32),
        rows.reshape(-1, 3), torch.full((count * TEXELS,), 2, dtype=torch.uint8),
    )  # fmt: skip


def rms(rows: torch.Tensor) -> torch.Tensor:
    coefficients = haar.forward(rows.view(-1, 6, RESOLUTION, RESOLUTION, 3)).flatten(1, 3)
    return coefficients.square().mean(dim=(0, 2)).sqrt()


def corners() -> torch.Tensor:
    return torch.cartesian_prod(*[torch.tensor([0.0, 1.0])] * 3)


def test_without_noise_it_is_the_exact_root_mean_square():
    rows = torch.rand((8, TEXELS, 3), generator=torch.Generator().manual_seed(0))
    up = torch.tensor([[0.0, 1.0, 0.0]]).expand(8, 3)
    found = wavelet_scale(exact(rows), points(corners(), up))  # eight places far apart: no cluster of two
    assert torch.allclose(found, rms(rows), rtol=1e-4)


def test_clusters_of_equal_rows_and_unequal_sizes_stay_exact():
    rows = torch.rand((8, TEXELS, 3), generator=torch.Generator().manual_seed(1))
    which = torch.repeat_interleave(torch.arange(8), torch.arange(1, 9))
    up = torch.tensor([[0.0, 1.0, 0.0]]).expand(len(which), 3)
    found = wavelet_scale(exact(rows[which]), points(corners()[which], up))
    assert torch.allclose(found, rms(rows[which]), rtol=1e-4)


def test_noise_counts_for_little_and_signal_in_full():
    generator = torch.Generator().manual_seed(2)
    count, noise = 400, 0.5
    signal = torch.rand((1, TEXELS, 3), generator=generator)
    rows = signal + noise * torch.randn((count, TEXELS, 3), generator=generator)
    up = torch.tensor([[0.0, 1.0, 0.0]]).expand(count, 3)
    here = torch.full((count, 3), 0.5) + 1e-4 * torch.rand((count, 3), generator=generator)
    spread = torch.cat([here[:-8], corners()])  # the corners set the size of the cells
    found, truth, naive = wavelet_scale(exact(rows), points(spread, up)), rms(signal), rms(rows)
    assert (naive.square() - truth.square()).mean() == pytest.approx(noise**2, rel=0.1)
    assert (found.square() - truth.square()).mean() < 0.05 * noise**2  # 9 clusters of 400 rows: 9 / 400


def test_points_reflecting_into_other_directions_are_other_clusters():
    six = torch.cat([torch.eye(3), -torch.eye(3)])
    together = points(torch.zeros((6, 3)), six)
    assert len(clusters(together, 12).unique()) == 6
    assert len(clusters(points(corners(), six[:1].expand(8, 3)), 2).unique()) == 8
    near = points(1e-3 * corners().repeat(2, 1) + torch.tensor([0.0, 0.0, 0.0]), six[:1].expand(16, 3))
    assert len(clusters(near, 1).unique()) == 1


def test_wavelets_no_path_reaches_stay_positive():
    empty = Transport(RESOLUTION, torch.zeros(9, dtype=torch.int64), torch.zeros(0, dtype=torch.int32),
                      torch.zeros((0, 3)), torch.zeros(0, dtype=torch.uint8))  # fmt: skip
    found = wavelet_scale(empty, points(corners(), torch.ones((8, 3))))
    assert (found > 0).all() and found.max() < 1e-6  # it divides: never zero

"""The twin of the fused kernels gives the readable form's radiance, and compiled code gives the twin's."""

import pytest
import torch
from fused_case import FusedCase, distance

from prt.methods.wavelet_compiled import arranged, compiled_problem, shade_compiled
from prt.methods.wavelet_shading import shade_folded
from prt.methods.wavelet_tiles import padded, shade_tiles

BF16 = torch.bfloat16


@pytest.mark.parametrize("tile", [16, 64, 128])
def test_the_twin_equals_the_readable_and_the_folded_form(tile):
    case = FusedCase()
    found = shade_tiles(case.pixel.space, case.bias, case.packed(torch.float32), tile)
    assert distance(found, case.truth) < 1e-5
    assert distance(found, shade_folded(case.net, case.pixel, case.code, 32)) < 1e-5


@pytest.mark.parametrize("kind, most", [(BF16, 1e-2), (torch.float16, 2e-3)])
def test_half_precision_has_a_small_error(kind, most):
    case = FusedCase(terms=64, width=128, wavelets=8)
    found = shade_tiles(case.pixel.space, case.bias, case.packed(kind))
    assert 0 < distance(found, case.truth) < most


def test_sizes_are_filled_up_to_powers_of_two():
    assert [padded(size) for size in (1, 32, 33, 64, 100, 128)] == [32, 32, 64, 64, 128, 128]


@pytest.mark.parametrize("terms, width, wavelets, pixels", [(12, 40, 5, 70), (64, 128, 3, 32), (6, 16, 1, 1)])
@pytest.mark.parametrize("threads", [1, 2])
# bfloat16: sums in another order may round a hidden number the other way, half a unit of its last place
@pytest.mark.parametrize("kind, most", [(torch.float32, 1e-5), (BF16, 1e-3)])
def test_compiled_code_equals_the_twin(terms, width, wavelets, pixels, threads, kind, most, monkeypatch):
    if compiled_problem(kind):
        pytest.skip(compiled_problem(kind))
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)
    case = FusedCase(terms, width, wavelets, pixels)
    packed = case.packed(kind)
    twin = shade_tiles(case.pixel.space, case.bias, packed)
    assert distance(shade_compiled(case.pixel.space, case.bias, arranged(packed)), twin) < most


@pytest.mark.parametrize("kind", [torch.float32, BF16])
def test_a_nan_comes_out_as_one_and_stays_in_its_pixel(kind):
    if compiled_problem(kind):
        pytest.skip(compiled_problem(kind))
    case = FusedCase()
    case.pixel.space[7, 3] = float("nan")
    found = shade_compiled(case.pixel.space, case.bias, arranged(case.packed(kind)))
    assert found[7].isnan().all()
    assert found[torch.arange(len(found)) != 7].isfinite().all()

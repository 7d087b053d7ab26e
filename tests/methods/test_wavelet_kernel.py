"""The Triton kernels give what their twins give: in Triton's interpreter, and on a GPU where there is one."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from fused_case import FusedCase, distance

from prt.methods.wavelet_tiles import Packed, shade_tiles
from prt.nn.hashgrid import HashGrid
from prt.nn.triton_setup import triton_missing, triton_problem

HERE = Path(__file__).parent


def test_kernels_in_the_interpreter_equal_their_twins():
    if triton_missing():
        pytest.skip(triton_missing())
    paths = [str(HERE), str(HERE.parent.parent), os.environ.get("PYTHONPATH", "")]
    settings = {"TRITON_INTERPRET": "1", "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    done = subprocess.run(
        [sys.executable, str(HERE / "triton_interpreted.py")],
        env={**os.environ, **settings},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert len(found) == 12
    for name, error in found.items():
        # half precision: another order of a sum may round a hidden number the other way
        assert error < (1e-3 if "float16" in name else 1e-5), (name, error)


@pytest.mark.parametrize(
    "terms, width, wavelets, pixels", [(12, 40, 5, 70), (64, 128, 64, 5000), (6, 16, 1, 1)]
)
def test_the_kernel_on_a_gpu_equals_the_twin(terms, width, wavelets, pixels):
    if triton_problem():
        pytest.skip(f"no GPU for Triton: {triton_problem()}")
    from prt.methods.wavelet_kernel import shade_on_gpu

    case = FusedCase(terms, width, wavelets, pixels)
    packed = case.packed(torch.bfloat16)
    twin = shade_tiles(case.pixel.space, case.bias, packed)
    parts = {name: value.cuda() for name, value in vars(packed).items()}
    found = shade_on_gpu(case.pixel.space.cuda(), case.bias.cuda(), Packed(**parts)).cpu()
    assert distance(found, twin) < 2e-3
    assert distance(found, case.truth) < 2e-2


def test_the_lookup_on_a_gpu_equals_the_readable_one():
    if triton_problem():
        pytest.skip(f"no GPU for Triton: {triton_problem()}")
    from prt.nn.hashgrid_kernel import lookup_on_gpu

    grid = HashGrid(16, 2, 12, 4, 1.4, ((0.0, 0.0, 0.0), (1.0, 0.5, 1.0))).cuda()
    points = torch.rand((1000, 3), device="cuda") * 1.2 - 0.1
    with torch.no_grad():
        torch.nn.init.normal_(grid.table)
        assert distance(lookup_on_gpu(grid, points), grid.forward_readable(points)) < 1e-5

"""``method.kernel``: what it chooses, that nothing changes unasked, that fused equals readable rendering."""

import pytest
import torch
from test_wavelet_neural import RESOLUTION, make, random_gbuffer, random_lighting

from prt.errors import PrtError
from prt.methods import wavelet_fused
from prt.methods.wavelet_compiled import compiled_problem
from prt.methods.wavelet_fused import form_of


@pytest.fixture
def built(own_cache):
    torch.manual_seed(0)
    method = make()
    method.build(((-1, -1, -1), (1, 1, 1)), RESOLUTION, torch.rand(6 * RESOLUTION**2) + 0.1, "cpu")
    with torch.no_grad():
        method.net.grid.table.normal_()
        for layer in method.net.mlp.layers:
            layer.bias.normal_()
    return method


def shaded(method, **settings):
    for name, value in settings.items():
        setattr(method, name, value)
    return method.shade(random_gbuffer(300), method.light(random_lighting()))


def test_nothing_changes_on_the_cpu_unless_asked(built):
    assert form_of("auto", "cpu") == form_of("plain", "cpu") == "plain"
    assert torch.equal(shaded(built), shaded(built, kernel="plain"))


def test_fused_float32_equals_the_readable_form(built):
    if compiled_problem(torch.float32):
        pytest.skip(compiled_problem(torch.float32))
    fused = shaded(built, kernel="fused")
    readable = shaded(built, kernel="auto", folded=False)
    assert (fused - readable).norm() / readable.norm() < 1e-5


def test_fused_bfloat16_is_close(built):
    if compiled_problem(torch.bfloat16):
        pytest.skip(compiled_problem(torch.bfloat16))
    exact = shaded(built)
    assert 0 < (shaded(built, precision="bfloat16", kernel="fused") - exact).norm() / exact.norm() < 0.02
    assert shaded(built, wavelets=6 * RESOLUTION**2).isfinite().all()


def test_fused_takes_black_and_bright_lights_and_empty_views(built):
    if compiled_problem(torch.bfloat16):
        pytest.skip(compiled_problem(torch.bfloat16))
    built.precision, built.kernel = "bfloat16", "fused"
    for scale in (0.0, 1e6):
        out = built.shade(random_gbuffer(20), built.light(random_lighting() * scale))
        assert out.isfinite().all() and (scale > 0 or out.abs().max() == 0)
    assert built.shade(random_gbuffer(0), built.light(random_lighting())).shape == (0, 3)


def test_without_a_matrix_unit_fused_bfloat16_is_refused(built, monkeypatch):
    monkeypatch.setattr(wavelet_fused, "compiled_problem", lambda _: "the processor has no amx_bf16")
    with pytest.raises(PrtError, match="no amx_bf16; set method.kernel=auto"):
        shaded(built, precision="bfloat16", kernel="fused")


@pytest.mark.parametrize("problem, auto", [("Triton cannot be imported", "plain"), (None, "triton")])
def test_a_gpu_is_used_through_triton_where_it_is_there(problem, auto, monkeypatch):
    monkeypatch.setattr(wavelet_fused, "triton_problem", lambda: problem)
    assert form_of("auto", "cuda") == auto and form_of("plain", "cuda") == "plain"
    if problem is None:
        assert form_of("fused", "cuda") == "triton"
    else:
        with pytest.raises(PrtError, match="method.kernel=fused: Triton cannot be imported"):
            form_of("fused", "cuda")


@pytest.mark.parametrize(
    "change, word", [(dict(kernel="fast"), "kernel='fast'"), (dict(folded=False), "folded")]
)
def test_bad_settings_are_named(change, word):
    with pytest.raises(PrtError, match=word):
        make(**{"kernel": "fused", **change})

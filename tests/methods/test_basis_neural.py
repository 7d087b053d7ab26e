"""Neural transport in a light basis, on the real task at a tiny size."""

import pytest
import tiny
import torch

from prt.bench.build import build
from prt.bench.compose import compose
from prt.errors import PrtError
from prt.methods.basis_neural import recorded_coefficients
from prt.trace.light_basis import prior_weighted_basis


def make(maps, *more):
    settings = ["method=basis_neural", "method.training.steps=40", *more]
    return build(compose([*tiny.TASK, *tiny.lights(maps), *settings]), "method")


@pytest.fixture(scope="module")
def fitted(tiny_task, maps):
    method = make(maps)
    method.fit(tiny_task, tiny.Log(), 0, "cpu")
    return method


def test_all_terms_lose_nothing(tiny_task):
    """With as many terms as texels the dot product of coefficients and code is the relit record."""
    data, total = tiny_task.training(), 6 * tiny.RESOLUTION**2
    transport = data.transport.rows(torch.arange(300) % data.transport.pixels)
    basis = prior_weighted_basis(
        data.transport, data.gbuffer, tiny_task.train_lightings(), min(total, 3 * len(data.gbuffer))
    )
    lighting = tiny.random_cubemap()
    found = torch.einsum("nmc,mc->nc", recorded_coefficients(transport, basis), basis.project(lighting))
    truth = transport.relight(lighting.reshape(1, -1, 3))[0]
    assert (found - truth).norm() < 0.02 * truth.norm()


def test_more_terms_lose_less_and_the_kept_lighting_says_how_much(tiny_task):
    data, lighting = tiny_task.training(), tiny.random_cubemap()
    truth = data.transport.relight(lighting.reshape(1, -1, 3))[0]
    losses = []
    for terms in (1, 4, 16, 64):
        basis = prior_weighted_basis(data.transport, data.gbuffer, tiny_task.train_lightings(), terms)
        found = torch.einsum(
            "nmc,mc->nc", recorded_coefficients(data.transport, basis), basis.project(lighting)
        )
        kept = data.transport.relight(basis.kept(lighting).reshape(1, -1, 3))[0]
        assert (found - kept).norm() < 1e-3 * truth.norm()
        losses.append(float((found - truth).norm() / truth.norm()))
        assert bool((basis.energy.diff() >= -1e-5).all()) and float(basis.energy[-1]) <= 1 + 1e-4
    assert losses == sorted(losses, reverse=True) and losses[-1] < 0.5 * losses[0]


def test_transport_of_few_patterns_needs_as_few_terms(tiny_task):
    """Three texels alone send light: three terms hold it all."""
    import dataclasses

    data = tiny_task.training()
    allowed = torch.tensor([3, 100, 250], dtype=data.transport.texel.dtype)
    texel = allowed[data.transport.texel.long() % 3]
    basis = prior_weighted_basis(
        dataclasses.replace(data.transport, texel=texel), data.gbuffer, tiny_task.train_lightings(), 8
    )
    assert basis.energy[2] > 0.9999 > basis.energy[0]


def test_folding_the_last_layer_changes_nothing(fitted, tiny_task):
    item = tiny_task.tests()[0]
    code = fitted.basis.project(item.lighting)
    from prt.trace.mirrored import mirrored

    rays = mirrored(fitted.mi_scene, item.gbuffer)
    with torch.no_grad():
        slow = torch.einsum("nmc,mc->nc", fitted.net.coefficients(item.gbuffer, *rays), code)
    fast = fitted.shade(item.gbuffer, fitted.light(item.lighting))
    assert slow.norm() > 0 and (fast - slow).norm() < 1e-4 * slow.norm()


def test_it_learns_and_is_linear_in_the_lighting(fitted, tiny_task, maps):
    log = tiny.Log()
    make(maps, "method.training.steps=80").fit(tiny_task, log, 0, "cpu")
    assert sum(log.losses[-15:]) < 0.8 * sum(log.losses[:15])
    item = tiny_task.tests()[0]
    a, b = tiny.random_cubemap(1), tiny.random_cubemap(2)
    both = fitted.shade(item.gbuffer, fitted.light(a + b))
    apart = fitted.shade(item.gbuffer, fitted.light(a)) + fitted.shade(item.gbuffer, fitted.light(b))
    assert torch.allclose(both, apart, rtol=1e-3, atol=1e-4 * float(both.abs().max()))


@pytest.mark.parametrize("mirror", [0, 2])
def test_a_saved_model_renders_the_same(tiny_task, maps, tmp_path, mirror):
    method = make(maps, f"method.mirror.levels={mirror}", "method.training.steps=2")
    method.fit(tiny_task, tiny.Log(), 0, "cpu")
    method.save(tmp_path / "model.safetensors")
    other = make(maps, f"method.mirror.levels={mirror}")
    other.load(tmp_path / "model.safetensors", tiny_task, "cpu")
    item = tiny_task.tests()[0]
    images = [m.shade(item.gbuffer, m.light(item.lighting)) for m in (method, other)]
    assert torch.equal(*images)
    assert other.nbytes() == method.nbytes() > 1000


def test_empty_views_and_black_lights(fitted, tiny_task):
    item = tiny_task.tests()[0]
    none = item.gbuffer.rows(torch.zeros(0, dtype=torch.long))
    assert fitted.shade(none, fitted.light(item.lighting)).shape == (0, 3)
    assert not fitted.shade(item.gbuffer, fitted.light(0 * item.lighting)).any()


@pytest.mark.parametrize("change", ["terms=0", "width=0", "hidden_layers=none"])
def test_settings_out_of_range_are_named(maps, change):
    with pytest.raises(PrtError, match=f"method.{change.split('=')[0]}="):
        make(maps, f"method.{change}")

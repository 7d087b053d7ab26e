"""What a scene needs, on cases whose answer is known."""

import dataclasses

import tiny
import torch

from prt.light.cubemap import texel_directions
from prt.trace import scene_needs


def test_a_lighting_of_one_wavelet_and_one_of_two():
    from prt.light import haar

    coefficients = torch.zeros(2, 6 * 64, 3)
    coefficients[0, 5] = 1.0
    coefficients[1, [5, 77]] = torch.tensor([3.0, 1.0])[:, None]
    lightings = haar.inverse(coefficients).view(2, 6, 8, 8, 3)
    kept = scene_needs.wavelet_energy(lightings)
    assert torch.allclose(kept[0], torch.tensor(0.95), atol=1e-5) and torch.allclose(
        kept[1], torch.tensor(1.0)
    )
    assert scene_needs.fewest(kept, 0.06) == 1 and scene_needs.fewest(kept, 0.01) == 2


def test_a_gradient_needs_one_band():
    gradient = (1 + texel_directions(16)[..., 1:2]).expand(-1, -1, -1, 3)[None]
    kept = scene_needs.harmonic_energy(gradient)
    # the mean of (1 + y)^2 over the sphere is 1 + 1/3
    assert abs(float(kept[0]) - 0.75) < 0.01 and float(kept[1]) > 0.995


def test_transport_of_three_texels_has_rank_three(tiny_task):
    data = tiny_task.training()
    allowed = torch.tensor([3, 100, 250], dtype=data.transport.texel.dtype)
    texel = allowed[data.transport.texel.long() % 3]
    kept = scene_needs.transport_energy(
        dataclasses.replace(data.transport, texel=texel), data.gbuffer, tiny_task.train_lightings()
    )
    assert scene_needs.fewest(kept, 0.001) <= 3


def test_noise_has_no_energy(tiny_task):
    """Transport to random texels: what two halves share is the mean alone, whatever the samples are."""
    data = tiny_task.training()
    generator = torch.Generator().manual_seed(0)
    texel = torch.randint(6 * tiny.RESOLUTION**2, data.transport.texel.shape, generator=generator)
    noise = dataclasses.replace(data.transport, texel=texel.to(data.transport.texel.dtype))
    flat = torch.ones_like(tiny_task.train_lightings())
    assert scene_needs.fewest(scene_needs.transport_energy(noise, data.gbuffer, flat), 0.05) <= 6


def test_halves_add_up_to_the_record(tiny_task):
    transport = tiny_task.training().transport
    first, second = scene_needs.halves(transport, 0)
    lighting = tiny_task.train_lightings()[:1]
    mean = (first.relight(lighting) + second.relight(lighting)) / 2
    assert torch.allclose(mean, transport.relight(lighting), rtol=1e-3, atol=1e-5)
    assert first.pixels == transport.pixels and len(first.texel) + len(second.texel) == len(transport.texel)


def test_shares_and_cells(tiny_task):
    gbuffer = tiny_task.training().gbuffer
    shares = scene_needs.surface_shares(gbuffer)
    assert 0 < shares["mirror"] <= shares["glossy"] < 1 or shares["mirror"] == 0
    rough = dataclasses.replace(gbuffer, roughness=torch.ones_like(gbuffer.roughness))
    assert scene_needs.surface_shares(rough) == {"glossy": 0.0, "mirror": 0.0}
    everything = float((gbuffer.position.amax(0) - gbuffer.position.amin(0)).max()) * 2
    assert scene_needs.surface_cells(gbuffer, everything) <= 8
    assert scene_needs.surface_cells(gbuffer, 1e-4) > 0.9 * len(gbuffer)

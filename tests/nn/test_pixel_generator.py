import pytest
import torch

from prt.errors import PrtError
from prt.nn.pixel_generator import PixelGenerator
from prt.scene.gbuffer import GBuffer

BOUNDS = ((-1.0, -2.0, 0.0), (1.0, 2.0, 1.0))


def network(**changes) -> PixelGenerator:
    settings = dict(bounds=BOUNDS, variables=2, width=32, hidden_layers=3, position_frequencies=4)
    return PixelGenerator(**{**settings, **changes}, generator=torch.Generator().manual_seed(0))


def pixels(count: int = 64) -> GBuffer:
    generator = torch.Generator().manual_seed(1)

    def uniform(channels: int) -> torch.Tensor:
        return torch.rand((count, channels), generator=generator)

    low, high = torch.tensor(BOUNDS)
    normal, wo = (torch.nn.functional.normalize(uniform(3) - 0.5, dim=1) for _ in range(2))
    return GBuffer(
        position=low + (high - low) * uniform(3), normal=normal, wo=wo, wr=wo, diffuse=uniform(3),
        specular=uniform(3), roughness=uniform(1), uv=uniform(2), hit=torch.ones(count, dtype=torch.bool),
    )  # fmt: skip


@pytest.mark.parametrize("hidden_layers", [1, 3])
def test_one_state_equals_a_state_for_each_pixel(hidden_layers):
    net, gbuffer, v = network(hidden_layers=hidden_layers), pixels(), torch.tensor([0.2, 0.9])
    once = net.log_radiance(gbuffer, v)
    each = net.log_radiance(gbuffer, v.expand(len(gbuffer), 2))
    assert once.shape == (64, 3)
    torch.testing.assert_close(once, each, rtol=1e-4, atol=1e-5)


def test_layers_are_as_described():
    """Every layer behind the first also sees the input."""
    net, gbuffer, v = network(), pixels(), torch.tensor([0.2, 0.9])
    seen = torch.cat([net.features(gbuffer), (2 * v - 1).expand(64, 2)], dim=1)
    x = seen
    for layer in net.layers[:-1]:
        x = torch.cat([torch.nn.functional.leaky_relu(layer(x)), seen], dim=1)
    torch.testing.assert_close(net.layers[-1](x), net.log_radiance(gbuffer, v), rtol=1e-4, atol=1e-5)
    surface = 3 * 9 + 13
    counts = [(surface + 2) * 32 + 32, *[(32 + surface + 2) * 32 + 32] * 2, (32 + surface + 2) * 3 + 3]
    assert net.nbytes() == 4 * sum(counts)


def test_every_input_matters():
    net, gbuffer, v = network(), pixels(), torch.tensor([0.2, 0.9])
    before = net.log_radiance(gbuffer, v)
    for name in ("position", "normal", "wo", "diffuse", "specular", "roughness"):
        other = pixels()
        setattr(other, name, getattr(other, name).flip(0))
        assert not torch.allclose(net.log_radiance(other, v), before), name
    assert not torch.allclose(net.log_radiance(gbuffer, torch.tensor([0.2, 0.8])), before)


def test_radiance_is_finite_and_not_negative():
    net, gbuffer = network(scale=5.0), pixels()
    with torch.no_grad():
        net.layers[-1].weight.mul_(1e4)
    out = net(gbuffer, torch.tensor([0.2, 0.9]))
    assert torch.isfinite(out).all() and out.min() == 0 and out.max() > 1e6


def test_states_are_clamped_and_no_state_is_allowed():
    net, gbuffer = network(), pixels()
    inside, outside = torch.tensor([0.0, 1.0]), torch.tensor([-2.0, 3.0])
    assert torch.equal(net(gbuffer, inside), net(gbuffer, outside))
    assert network(variables=0)(gbuffer, torch.zeros(0)).shape == (64, 3)


def test_learns_a_function_of_surface_and_state():
    net, gbuffer = network(scale=2.0), pixels(256)
    optimiser = torch.optim.Adam(net.parameters(), lr=3e-3)
    generator = torch.Generator().manual_seed(2)

    def radiance(v: torch.Tensor) -> torch.Tensor:
        lit = gbuffer.diffuse * (0.2 + 20 * v[..., :1])
        return lit + v[..., 1:] * gbuffer.specular * gbuffer.wo[:, :1].abs()

    def error(v: torch.Tensor) -> float:
        return ((net(gbuffer, v) - radiance(v)).abs().mean() / radiance(v).mean()).item()

    held_out = torch.tensor([0.35, 0.6])
    assert error(held_out) > 0.8
    for _ in range(300):
        v = torch.rand((256, 2), generator=generator)  # a state for each pixel: less noise than one a step
        loss = (net.log_radiance(gbuffer, v) - net.compressed(radiance(v))).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert error(held_out) < 0.25


@pytest.mark.parametrize(
    ("change", "said"),
    [({"width": 0}, "width=0"), ({"hidden_layers": 0}, "hidden_layers=0"), ({"scale": 0.0}, "scale=0.0"),
     ({"position_frequencies": -1}, "position_frequencies=-1"), ({"variables": 1.5}, "variables=1.5")],
)  # fmt: skip
def test_mistakes(change, said):
    with pytest.raises(PrtError, match=said):
        network(**change)

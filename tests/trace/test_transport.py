import pytest
import torch

from prt.trace.transport import Transport


def random_transport(pixels=7, resolution=2, seed=0):
    generator = torch.Generator().manual_seed(seed)
    counts = torch.randint(0, 5, (pixels,), generator=generator)
    counts[2] = 0
    total = int(counts.sum())
    offsets = torch.cat([torch.zeros(1, dtype=torch.int64), counts.cumsum(0)])
    texel = torch.randint(0, 6 * resolution**2, (total,), generator=generator).to(torch.int32)
    weight = torch.rand((total, 3), generator=generator)
    return Transport(resolution, offsets, texel, weight, torch.arange(total).remainder(4).to(torch.uint8))


def test_relight_equals_the_dense_product():
    transport = random_transport()
    lightings = torch.rand((5, 24, 3), generator=torch.Generator().manual_seed(1))
    expected = torch.einsum("ptc,ltc->lpc", transport.dense(), lightings)
    assert torch.allclose(transport.relight(lightings), expected, atol=1e-5)
    with pytest.raises(ValueError, match="resolution 2"):
        transport.relight(torch.ones((1, 54, 3)))


def test_components_split_the_samples():
    transport = random_transport()
    dense = {name: transport.component(name).dense() for name in ("background", "direct", "indirect", "full")}
    assert torch.allclose(dense["background"] + dense["direct"] + dense["indirect"], transport.dense())
    assert torch.allclose(dense["direct"] + dense["indirect"], dense["full"])
    direct = transport.component("direct")
    assert direct.pixels == 7 and set(direct.bounces.tolist()) == {1}
    with pytest.raises(KeyError):
        transport.component("glossy")


def test_rows_in_any_order_and_twice():
    transport = random_transport()
    index = torch.tensor([6, 2, 0, 6])
    assert torch.equal(transport.rows(index).dense(), transport.dense()[index])
    assert transport.rows(torch.empty(0, dtype=torch.int64)).pixels == 0


def test_concatenate():
    a, b = random_transport(7, seed=0), random_transport(4, seed=1)
    both = Transport.concatenate([a, b])
    assert both.pixels == 11
    assert torch.equal(both.dense(), torch.cat([a.dense(), b.dense()]))

"""Encodings of reflected direction, normal and roughness: sizes, what they depend on, what they learn."""

import pytest
import torch

from prt.errors import PrtError
from prt.nn.direction_encodings import KINDS, CubemapEncoding, direction_encoding

SIZES = dict(degree=4, bins=8, levels=2, features=3, base_resolution=4, scale=2.0)
TERMS = 10


def directions(count: int, seed: int = 0) -> torch.Tensor:
    return torch.nn.functional.normalize(
        torch.randn((count, 3), generator=torch.Generator().manual_seed(seed)), dim=1
    )


def make(kind: str):
    torch.manual_seed(0)
    return direction_encoding({"kind": kind, **SIZES}, TERMS)


@pytest.mark.parametrize(
    "kind, outputs",
    [("sh", 25 + 4), ("none", 3 + 4), ("one_blob", 24 + 4), ("one_blob_all", 24 + 32), ("cubemap", 6 + 4),
     ("cubemap_factor", 4)],
)  # fmt: skip
def test_outputs_are_as_many_as_said(kind, outputs):
    encoding = make(kind)
    found = encoding(directions(7), directions(7, 1), torch.rand(7, 1))
    assert found.shape == (7, outputs) and encoding.outputs == outputs


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_sees_every_input_once(kind):
    encoding = make(kind)
    if isinstance(encoding, CubemapEncoding):
        for grid in encoding.grids:
            torch.nn.init.normal_(grid)
    given = [directions(5), directions(5, 1), torch.full((5, 1), 0.4)]
    other = [directions(5, 2), directions(5, 3), torch.full((5, 1), 0.8)]
    before = encoding(*given)
    for number in range(3):
        changed = encoding(*[other[k] if k == number else given[k] for k in range(3)])
        # as a factor the reflected direction is no input of the network
        assert torch.equal(changed, before) == (kind == "cubemap_factor" and number == 0)
    factor = encoding.factor(given[0])
    assert (factor is None) == (kind != "cubemap_factor")
    if factor is not None:
        assert factor.shape == (5, TERMS) and not torch.equal(factor, encoding.factor(other[0]))


def test_a_cubemap_is_read_bilinearly():
    """A grid whose values are u + 10 v of the face gives that everywhere on the face."""
    encoding = CubemapEncoding(1, 1, 4, 1.0)
    r = encoding.resolutions[0]
    place = torch.linspace(-1, 1, r + 1)
    with torch.no_grad():
        encoding.grids[0].copy_((place[None, :] + 10 * place[:, None]).expand(6, -1, -1).reshape(-1, 1))
    u, v = torch.tensor([0.3, -0.77]), torch.tensor([-0.51, 0.2])
    towards = torch.stack([torch.ones(2), -v, -u], dim=1)  # face +x
    assert torch.allclose(encoding.looked_up(towards)[:, 0], u + 10 * v, atol=1e-5)


def test_a_factor_starts_the_same_in_all_directions():
    factor = make("cubemap_factor").factor(directions(50)).detach()
    assert float(factor.std(dim=0).max()) < 1e-3 and torch.allclose(
        factor, torch.ones_like(factor), atol=1e-2
    )


@pytest.mark.parametrize(
    "change", [dict(kind="spherical"), dict(degree=-1), dict(kind="one_blob", bins=0),
               dict(kind="cubemap", levels=0), dict(kind="cubemap", scale=0.5)],
)  # fmt: skip
def test_settings_out_of_range_are_named(change):
    name = list(change)[-1]
    with pytest.raises(PrtError, match=f"method.directions.{name}"):
        direction_encoding({"kind": "sh", **SIZES, **change}, TERMS)

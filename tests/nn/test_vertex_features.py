"""Features on vertices: interpolation, the softplus behind it, gradients, the interface of the hash grid."""

import types

import pytest
import torch

from prt.errors import PrtError
from prt.nn.direction_encodings import direction_encoding
from prt.nn.hashgrid import Corners, HashGrid, weighted_rows
from prt.nn.vertex_features import VertexFeatures
from prt.nn.wavelet_texture import WaveletTexture
from prt.nn.wavelet_transport import WaveletTransport

CORNERS = torch.tensor([[0, 1, 2], [2, 1, 4], [4, 4, 0]], dtype=torch.int32)
WEIGHTS = torch.tensor([[0.2, 0.3, 0.5], [1.0, 0.0, 0.0], [0.25, 0.25, 0.5]])


def features(count: int = 4) -> VertexFeatures:
    net = VertexFeatures(5, count, lambda gbuffer: (CORNERS, WEIGHTS), torch.Generator().manual_seed(0))
    with torch.no_grad():
        net.table.normal_(generator=torch.Generator().manual_seed(1))
    return net


def test_values_are_the_softplus_of_what_is_interpolated():
    net = features()
    mixed = (net.table[CORNERS.long()] * WEIGHTS[..., None]).sum(1)
    torch.testing.assert_close(net(None), torch.log1p(mixed.exp()))
    assert net.out_features == 4 and net.nbytes() == 5 * 4 * 4


def test_places_known_before_give_the_same_and_any_rows_of_them():
    net = features()
    places, chosen = net.locate(None), torch.tensor([2, 0, 0])
    assert places.indices.shape == places.weights.shape == (3, 1, 3)
    assert torch.equal(net.lookup(places.rows(chosen)), net(None)[chosen])


def test_gradients_are_those_of_plain_torch():
    net = features()
    net(None).square().sum().backward()
    table = net.table.detach().clone().requires_grad_()
    mixed = (table[CORNERS.long()] * WEIGHTS[..., None]).sum(1)
    torch.nn.functional.softplus(mixed).square().sum().backward()
    torch.testing.assert_close(net.table.grad, table.grad)
    assert net.table.grad[3].abs().sum() == 0  # no point reads it


def test_no_points_have_no_features():
    nothing = Corners(torch.zeros((0, 1, 3), dtype=torch.int32), torch.zeros((0, 1, 3)))
    assert features().lookup(nothing).shape == (0, 4)
    levels = Corners(torch.zeros((0, 6, 8), dtype=torch.int32), torch.zeros((0, 6, 8)))
    assert weighted_rows(torch.zeros(5, 2), levels).shape == (0, 12)


def test_a_mesh_without_vertices_is_refused():
    with pytest.raises(PrtError, match="vertices"):
        VertexFeatures(0, 4, lambda gbuffer: (CORNERS, WEIGHTS))


@pytest.mark.parametrize("kind", ["grid", "vertices"])
def test_the_network_finds_places_by_itself_or_takes_those_it_is_given(kind):
    torch.manual_seed(0)
    grid = features() if kind == "vertices" else HashGrid(2, 2, 8, 4, 1.5, ((-1,) * 3, (1,) * 3))
    sizes = dict(degree=2, bins=8, levels=2, features=2, base_resolution=2, scale=2.0)
    directions = direction_encoding({"kind": "sh", **sizes}, grid.out_features)
    net = WaveletTransport(grid, WaveletTexture(2, grid.out_features, False), directions, 8)
    unit, colour = torch.nn.functional.normalize(torch.randn(3, 3), dim=1), torch.rand(3, 3)
    gbuffer = types.SimpleNamespace(
        position=torch.rand(3, 3),
        wr=unit,
        normal=unit,
        roughness=colour[:, :1],
        diffuse=colour,
        specular=colour,
    )
    own, given = net.inputs(gbuffer), net.inputs(gbuffer, grid.locate(gbuffer))
    assert own.space.shape == (3, 4) and own.space.abs().min() > 0
    assert torch.equal(own.space, given.space) and torch.equal(own.features, given.features)

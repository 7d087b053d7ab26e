"""Transfer against closed forms, and its one kernel against the readable rays."""

import math

import pytest
import torch
from surfaces import Ground
from trace_scenes import glossy_corner

from prt.errors import PrtError
from prt.light.sh import sh_basis
from prt.methods.irradiance_volume import cosine_bands
from prt.trace import transfer
from prt.trace.surface import MeshSurface

UP = torch.tensor([[0.0, 1.0, 0.0]])


def open_transfer(normal, order):
    """Of a place that nothing shadows: the clamped cosine over pi."""
    from prt.light.sh_products import band_of

    return cosine_bands(order)[band_of(order)] * sh_basis(normal, order - 1)


def test_open_ground_has_the_bands_of_the_cosine():
    found = transfer.bake(Ground(), torch.zeros((1, 3)), UP, 4, 1 << 14, 0)
    torch.testing.assert_close(found, open_transfer(UP, 4), atol=2e-4, rtol=0)


def test_a_wall_takes_half_of_the_light_and_no_more():
    found = transfer.bake(Ground(wall=True), torch.zeros((1, 3)), UP, 4, 1 << 14, 0)[0]
    assert float(found[0]) == pytest.approx(float(0.5 * open_transfer(UP, 4)[0, 0]), abs=2e-3)
    # y_3 is 0.4886 x: the mean of x over the half with x > 0 of a cosine lobe is 4 / (3 pi) / 2
    assert float(found[3]) == pytest.approx(0.4886025 * 2 / (3 * math.pi), abs=2e-3)


def test_more_directions_less_noise():
    points = torch.zeros((200, 3))
    noise = [
        transfer.bake(Ground(wall=True), points, UP.expand(200, 3), 3, many, 1).std(0).mean()
        for many in (16, 256)
    ]
    assert noise[1] < 0.25 * noise[0]


def test_visibility_over_the_whole_sphere():
    found = transfer.bake_visibility(Ground(), torch.zeros((1, 3)), 3, 1 << 14, 0)[0]
    # the upper half: 2 pi times y_0; pi times 0.4886 for the band along y
    assert float(found[0]) == pytest.approx(2 * math.pi * 0.2820948, abs=5e-3)
    assert float(found[1]) == pytest.approx(math.pi * 0.4886025, abs=5e-3)
    assert float(found[3].abs()) < 5e-3


def test_the_kernel_casts_the_readable_rays():
    surface = MeshSurface(glossy_corner(), 16)
    points = surface.sample(64, 0)
    origin = points.position + 1e-3 * points.normal
    shift = torch.rand((64, 2), generator=torch.Generator().manual_seed(3))
    for normal in (points.normal, None):
        one, other = (
            make(surface, origin, normal, 5, 128, shift) for make in (transfer._kernel, transfer._by_rays)
        )
        # a ray along an edge may fall to either side
        assert float((one - other).abs().mean()) < 1e-4
        assert float(one.abs().max()) > 0.1


@pytest.mark.parametrize(("order", "directions", "message"), [(0, 4, "order=0"), (11, 4, "order=11"),
                                                              (4, 0, "directions=0")])  # fmt: skip
def test_refusals(order, directions, message):
    with pytest.raises(PrtError, match=message):
        transfer.bake(Ground(), torch.zeros((1, 3)), UP, order, directions, 0)


def test_no_points_no_transfer():
    assert transfer.bake(Ground(), torch.zeros((0, 3)), UP[:0], 4, 8, 0).shape == (0, 16)

import pytest
import torch

from prt.errors import PrtError
from prt.nn.mlp import Mlp


def test_shapes_and_size():
    net = Mlp(5, 16, 2, 3)
    assert [tuple(layer.weight.shape) for layer in net.layers] == [(16, 5), (16, 16), (3, 16)]
    assert net(torch.zeros(4, 7, 5)).shape == (4, 7, 3)
    assert net.nbytes() == 4 * (5 * 16 + 16 + 16 * 16 + 16 + 16 * 3 + 3)
    assert all(layer.bias is None for layer in Mlp(5, 16, 2, 3, bias=False).layers)


def test_forward_is_layers_with_relu_between():
    net, x = Mlp(5, 16, 2, 3), torch.randn(10, 5, generator=torch.Generator().manual_seed(0))
    first, second, last = net.layers
    torch.testing.assert_close(net(x), last(torch.relu(second(torch.relu(first(x))))))


def test_initial_variance_is_kept():
    generator = torch.Generator().manual_seed(0)
    net = Mlp(256, 256, 3, 256, generator=generator)
    out = net(torch.randn(512, 256, generator=generator))
    assert 0.2 < out.var().item() < 5  # second moments pass through every ReLU


def test_wrong_settings():
    with pytest.raises(PrtError, match="width=0"):
        Mlp(3, 0, 2, 3)

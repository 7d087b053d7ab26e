"""The gain finds out which wavelets a network predicts, at transport whose answer is known."""

import torch

from prt.light import haar
from prt.methods.wavelet_gain import POINTS, wavelet_gain
from prt.trace.transport import Transport

RESOLUTION, COUNT = 2, 300
TEXELS = 6 * RESOLUTION**2


class Points:
    """A G-buffer that knows nothing but which point is which."""

    def __init__(self, index):
        self.position = index

    def __len__(self):
        return len(self.position)

    def rows(self, chosen):
        return Points(self.position[chosen])

    def to(self, device):
        return self


class Known:
    """A network that predicts half of wavelets 0 to 7, twice 8 to 15, and noise for the rest."""

    class texture:
        wavelets = TEXELS

    scale = torch.ones(TEXELS)

    def __init__(self, coefficients):
        noise = torch.randn(coefficients.shape, generator=torch.Generator().manual_seed(5))
        self.predicted = torch.cat([coefficients[:, :8] / 2, coefficients[:, 8:16] * 2, noise[:, 16:]], 1)

    def inputs(self, gbuffer):
        return gbuffer.position

    def coefficients(self, pixel, k, precision):
        return self.predicted[pixel][:, k]


class Data:
    def __init__(self, record_noise: float):
        generator = torch.Generator().manual_seed(2)
        self.truth = torch.rand((COUNT, TEXELS, 3), generator=generator) ** 4
        noise = record_noise * torch.randn(self.truth.shape, generator=generator)
        self.gbuffer = Points(torch.arange(COUNT))
        self.transport = Transport(
            RESOLUTION,
            torch.arange(COUNT + 1) * TEXELS,
            torch.arange(TEXELS).repeat(COUNT),
            (self.truth + noise).reshape(-1, 3),
            torch.full((COUNT * TEXELS,), 2, dtype=torch.uint8),
        )


def gains(record_noise: float, points: int) -> torch.Tensor:
    data = Data(record_noise)
    net = Known(haar.forward(data.truth))
    return wavelet_gain(net, data, points, torch.Generator().manual_seed(3), torch.float32)


def test_a_prediction_too_large_is_shrunk_and_one_too_small_is_not_stretched():
    found = gains(0.0, 4 * POINTS)
    torch.testing.assert_close(found[:8], torch.ones(8))
    torch.testing.assert_close(found[8:16], torch.full((8,), 0.5), rtol=1e-4, atol=0)


def test_noise_gets_next_to_nothing():
    found = gains(0.0, 8 * POINTS)[16:]
    assert found.max() < 0.1 and (found == 0).float().mean() > 0.4


def test_noise_of_the_record_averages_out():
    found = gains(0.3, 16 * POINTS)
    torch.testing.assert_close(found[8:16], torch.full((8,), 0.5), rtol=0.1, atol=0)


def test_one_block_of_points_is_enough_for_a_gain():
    assert gains(0.0, 100).shape == (TEXELS,)

"""How far each wavelet's predicted transport can be trusted, measured on the recorded transport.

A short fit sees most fine wavelets a few times only, and what it then predicts for them is noise that a sun
(all its energy in a few fine wavelets) turns into visible error. Transport is recorded, so the prediction can
be held against it wavelet by wavelet: the gain r_k that minimises the squared error of r_k T_k is the
regression of the recorded on the predicted coefficient. Noise of the record averages out in it; it is in the
dependent variable only.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.light import haar
from prt.nn.wavelet_transport import WaveletTransport

#: points at a time, wavelets at a time: bounds the memory (75 MB at R = 32)
POINTS, WAVELETS = 1024, 256
#: a gain below this many of its own standard errors is taken for noise
SIGNIFICANT = 2.0


@torch.no_grad()
def wavelet_gain(
    net: WaveletTransport, data: Any, points: int, generator: torch.Generator, precision: torch.dtype
) -> Float[Tensor, "T"]:
    """Gain from 0 (the prediction says nothing) to 1 of every wavelet.

    Args:
        data: ``task.training()``, recorded transport and G-buffer of the training points.
        points: training points it is measured on, drawn uniformly.
        precision: of the network's hidden layers.
    """
    device = net.scale.device
    chosen = torch.randint(len(data.gbuffer), (points,), generator=generator)
    products, squares = [], torch.zeros(net.texture.wavelets)
    for rows in chosen.split(POINTS):
        recorded = haar.forward(data.transport.rows(rows).dense())
        pixel = net.inputs(data.gbuffer.rows(rows).to(device))
        product = torch.zeros(net.texture.wavelets)
        for k in torch.arange(net.texture.wavelets).split(WAVELETS):
            predicted = net.coefficients(pixel, k.to(device), precision).cpu()
            product[k] = (predicted * recorded[:, k]).sum(dim=(0, 2))
            squares[k] += predicted.square().sum(dim=(0, 2))
        products.append(product)
    product = torch.stack(products)
    total = product.sum(dim=0)
    gain = (total / squares.clamp(min=1e-30)).clamp(0, 1)
    if len(products) == 1:
        return gain
    error = product.std(dim=0) * len(products) ** 0.5
    return torch.where(total > SIGNIFICANT * error, gain, 0)

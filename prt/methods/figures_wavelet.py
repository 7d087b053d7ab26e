"""Figures 2 and 6 of Raghavan 2023: where training points fall, and how transport spreads over wavelets."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.light import haar
from prt.methods.stability_wavelet import row
from prt.methods.training import STRATEGIES, PointSampler
from prt.methods.wavelet_neural import WaveletNeural
from prt.metrics.tonemap import exposure_of, to_srgb
from prt.progress import track
from prt.savefig import save_png

#: seeds of the two independent records of figure 6
SEEDS = (88_000, 88_001)
#: pixels and wavelets evaluated at a time
PIXELS, WAVELETS = 256, 512


def training_points(task: Any, folder: Path, view: int, draws: int, smooth: float) -> list[dict[str, Any]]:
    """Where each sampling strategy puts its points (figure 2).

    Writes ``points.png``: one training view, and for every strategy how often its pixels are drawn, as many
    times as uniform sampling would. ``points/smooth``: share of all points on surfaces whose roughness is
    below ``smooth``.

    Args:
        view: number of the training view that is shown.
        draws: points drawn with each strategy.
    """
    from matplotlib.figure import Figure

    data = task.training()
    mine = data.point_view == view
    is_smooth = data.gbuffer.roughness[:, 0] < smooth
    place = task.recorded(data.views[view], task.train_spp, task.seed + 1 + view)[0]
    lit = place.image(data.transport.rows(mine.nonzero()[:, 0]).relight(task.prior()[None])[0])
    panels = [("indirect light", to_srgb(lit.numpy(), exposure_of(lit.numpy())), None)]
    rows = []
    for name, strategies in {"all": STRATEGIES, **{name: (name,) for name in STRATEGIES}}.items():
        sampler = PointSampler(dict.fromkeys(strategies, 1.0), data.importance, draws)
        points = sampler.draw(torch.Generator().manual_seed(0))
        often = torch.bincount(points, minlength=len(data.gbuffer))[mine] * (len(data.gbuffer) / draws)
        panels.append((name, place.image(often[:, None])[..., 0].numpy(), "magma"))
        rows.append(row("points/smooth", float(is_smooth[points].float().mean()), f"strategy={name}", draws))
    figure = Figure(figsize=(2.1 * len(panels), 2.6), layout="constrained")
    image = None
    for axis, (title, picture, colours) in zip(figure.subplots(1, len(panels)), panels, strict=True):
        if colours is None:
            axis.imshow(picture, interpolation="nearest")
        else:
            image = axis.imshow(picture, cmap=colours, vmin=0, vmax=6, interpolation="nearest")
        axis.set_title(title.replace("_", " "), fontsize=8)
        axis.set(xticks=[], yticks=[])
    bar = figure.colorbar(image, ax=figure.axes, shrink=0.8, location="right")
    bar.set_label("times as often as uniform", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    save_png(figure, folder / "points.png", dpi=150)
    return rows


def transport_spectrum(
    task: Any, model: WaveletNeural, folder: Path, size: int, spp: int, largest: int
) -> list[dict[str, Any]]:
    """How the transport of one far view spreads over its largest wavelets (figure 6), ours and recorded.

    Every pixel's ``largest`` coefficients are put in order. ``energy/kept``: the share of their sum of
    squares that the first so many hold. Recorded coefficients are noisy, and the largest of noisy numbers
    are noise: the order comes from one record, the squares from the product with an independent other.

    Writes ``histogram_<scene>.png``: how many of the largest coefficients have which magnitude.

    Args:
        size: pixels a side of the view; spp: recorded paths a pixel of each of the two records.
    """
    view = task.scene.views("far", 1, size, train_count=task.train_view_count)[0]
    pairs = [task.recorded(view, spp, seed) for seed in SEEDS]
    gbuffer = pairs[0][0]
    hit = gbuffer.hit.nonzero()[:, 0]
    transports = [whole.component("indirect").rows(hit) for _, whole in pairs]
    squares = {"recorded": [], "predicted": []}
    blocks = torch.arange(len(gbuffer)).split(PIXELS)
    for rows in track(blocks, "transport spectrum", len(blocks)):
        first, second = (coefficients(t.rows(rows).dense()) for t in transports)
        squares["recorded"].append(in_order(first, second, largest))
        ours = predicted(model, gbuffer.rows(rows))
        squares["predicted"].append(in_order(ours, ours, largest))
    found = {name: torch.cat(parts) for name, parts in squares.items()}
    draw_histogram(found, folder / f"histogram_{task.scene.name}.png")
    rows = []
    for name, parts in found.items():
        mean = parts.double().mean(dim=0)
        kept = (mean.cumsum(0) / mean.sum()).tolist()
        for count in [2**power for power in range(largest.bit_length()) if 2**power <= largest]:
            variant = f"transport={name},kept={count}"
            rows.append(row("energy/kept", kept[count - 1], variant, len(parts)))
    return rows


def coefficients(dense: Float[Tensor, "P T 3"]) -> Float[Tensor, "P T"]:
    """Wavelet coefficients of transport, mean of the colours."""
    return haar.forward(dense.mean(dim=2, keepdim=True))[..., 0]


@torch.no_grad()
def predicted(model: WaveletNeural, gbuffer: Any) -> Float[Tensor, "P T"]:
    """The network's coefficients of all wavelets, mean of the colours."""
    pixel = model.net.inputs(gbuffer.to(model.device))
    every = torch.arange(model.net.texture.wavelets, device=model.device)
    parts = [model.net.coefficients(pixel, k).mean(dim=2).cpu() for k in every.split(WAVELETS)]
    return torch.cat(parts, dim=1)


def in_order(
    first: Float[Tensor, "P T"], second: Float[Tensor, "P T"], largest: int
) -> Float[Tensor, "P largest"]:
    """Squares of the largest coefficients of ``first``, estimated with those of ``second``."""
    index = first.abs().topk(min(largest, first.shape[1]), dim=1).indices
    return first.gather(1, index) * second.gather(1, index)


def draw_histogram(found: dict[str, Tensor], path: Path) -> None:
    """Magnitudes of the largest coefficients, counted in bins of equal ratio.

    Where the noise of a record makes a square negative, its coefficient is counted with the smallest.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 3.2), layout="constrained")
    axis = figure.subplots()
    top = max(float(part.max()) for part in found.values()) ** 0.5
    bins = np.geomspace(top * 1e-5, top, 61)
    for (name, part), colour in zip(found.items(), ("#4477aa", "#cc6677"), strict=True):
        magnitude = part.clamp(min=0).sqrt().flatten().numpy().clip(bins[0] * 1.001, None)
        axis.hist(magnitude, bins=bins.tolist(), histtype="step", linewidth=1.6, label=name, color=colour)
    axis.set(xscale="log", yscale="log", xlabel="magnitude of a coefficient", ylabel="coefficients")
    axis.set_title(f"The {next(iter(found.values())).shape[1]} largest of every pixel", fontsize=9)
    axis.legend(frameon=False, fontsize=8)
    save_png(figure, path, dpi=150)

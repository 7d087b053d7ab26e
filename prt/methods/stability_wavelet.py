"""Where wavelet-neural relighting fails (Raghavan 2023, section 6.5), measured one thing at a time.

Called by ``prt table raghavan2023/stability``, ``flicker`` and the like; Neural PRT is measured beside it.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from skimage.color import rgb2lab
from torch import Tensor

from prt.errors import PrtError
from prt.light import haar
from prt.light.cubemap import rotate, yaw
from prt.light.steady import SteadySelection
from prt.light.unlike import unlike
from prt.methods.base import Method
from prt.methods.wavelet_neural import WaveletNeural
from prt.metrics.intervals import mean_interval
from prt.metrics.registry import evaluate
from prt.metrics.tonemap import exposure_of, to_srgb
from prt.progress import track
from prt.savefig import save_png
from prt.scene.view import View

#: seeds of the two records that the truth of a moving light is read from
FLICKER_SEEDS = (77_000, 77_001)
#: wavelets of a frame and their coefficients (k,) and (k, 3)
Kept = tuple[Tensor, Tensor]
#: pixels and wavelets the network is asked for at a time
PIXELS, WAVELETS = 1024, 128
#: settings of :class:`SteadySelection` by name
STEADY = {"hysteresis": {"fade": 1}, "fading": {"leave": 1.0}, "hysteresis_and_fading": {}}


def row(metric: str, value: float, variant: str, n: int) -> dict[str, Any]:
    """A row of ``results.csv``; all is of indirect light."""
    place = {"device": "", "variant": variant, "component": "indirect"}
    return {**place, "metric": metric, "value": float(value), "lo": None, "hi": None, "n": n}


def averaged(metric: str, values: Sequence[float], variant: str) -> dict[str, Any]:
    """A row of the mean over views with its interval."""
    interval = mean_interval(values)
    return row(metric, interval.mean, variant, len(values)) | {"lo": interval.lo, "hi": interval.hi}


# ---- a light that moves


def flicker(
    task: Any, model: WaveletNeural, degrees: float, frames: int, views: int, wavelets: list[int], spp: int
) -> list[dict[str, Any]]:
    """Change from frame to frame beyond the truth's own, while an environment turns.

    All figures are over the root mean square of the truth R, means over views with their interval:

    - ``flicker/jump``: root mean square of ``D_t+1 - 2 D_t + D_t-1``, D being the method's image less its own
      under the whole lighting. Neither has noise, and what the light itself does is in both: swapped wavelets
      are what is left. The row ``selection=none`` has the second difference of the image under all of it.
    - ``flicker/share``: the jump over that of selection by magnitude with equal K.
    - ``flicker/relative``: root mean square of ``(B_t+1 - B_t) - (R_t+1 - R_t)``, all errors of the change.
    - ``flicker/truncation``: the same for the truth under the lighting that is kept: a perfect network's.

    R is relit from recorded transport. A bright texel that moves on meets other paths, so the noise of a
    record does not stand still: squares of what R has a part in are products of two independent records.

    Args:
        degrees: turned about the vertical axis a frame.
        wavelets: the numbers K that are kept.
        spp: recorded paths a pixel of each record of the truth.

    Raises:
        PrtError: for fewer than three frames, or secondary rays, which are not of the network.
    """
    if model.mirrors.on:
        raise PrtError("flicker is measured of the network: leave method.secondary.roughness at 0")
    if frames < 3:
        raise PrtError(f"benchmark.frames={frames} must be at least 3: a jump is between three frames")
    names, lightings = task.lighting.test()
    shown = task.scene.views("far", views, task.train_size, train_count=task.train_view_count)
    found: dict[tuple[str, str], list[float]] = {}
    for number, view in enumerate(track(shown, "flicker", len(shown))):
        pairs = [task.recorded(view, spp, seed) for seed in FLICKER_SEEDS]
        gbuffer = pairs[0][0]
        hit = gbuffer.hit.nonzero()[:, 0]
        records = [whole.component("indirect").rows(hit) for _, whole in pairs]
        turning = [rotate(lightings[number % len(names)], yaw(degrees * frame)) for frame in range(frames)]
        lit = torch.stack(turning).flatten(1, 3)
        truths = [transport.relight(lit) for transport in records]
        scale = independent_rms(*truths)
        keys = [(n, count) for count in wavelets for n in (*haar.SELECTIONS, *STEADY)]
        kept = {key: followed(model, turning, *key) for key in keys}
        images = shaded(model, gbuffer, kept)
        whole = shaded(model, gbuffer, {"whole": [whole_light(model, light) for light in turning]})["whole"]
        found.setdefault(("selection=none", "jump"), []).append(rms(second_difference(whole)) / scale)
        jumps = {key: rms(second_difference(image - whole)) for key, image in images.items()}
        for key in keys:
            lost = torch.stack([as_lighting(model, *pair) for pair in kept[key]]) - lit
            figures = {
                "jump": jumps[key] / scale,
                "share": jumps[key] / max(jumps["magnitude", key[1]], 1e-30),
                "relative": independent_rms(*((images[key] - truth).diff(dim=0) for truth in truths)) / scale,
                "truncation": independent_rms(*(t.relight(lost).diff(dim=0) for t in records)) / scale,
            }
            for metric, value in figures.items():
                found.setdefault((f"selection={key[0]},wavelets={key[1]}", metric), []).append(value)
    return [averaged(f"flicker/{metric}", values, variant) for (variant, metric), values in found.items()]


def rms(values: Tensor) -> float:
    """Root mean square."""
    return float(values.square().mean().sqrt())


def independent_rms(first: Tensor, second: Tensor) -> float:
    """Root mean square of what two noisy measurements share; 0 where their noise hides it."""
    return max(float((first.double() * second.double()).mean()), 0.0) ** 0.5


def second_difference(frames: Float[Tensor, "T N 3"]) -> Float[Tensor, "T-2 N 3"]:
    """How far every frame is from halfway between its neighbours, twice."""
    return frames.diff(dim=0).diff(dim=0)


def followed(model: WaveletNeural, turning: list[Tensor], name: str, count: int) -> list[Kept]:
    """What every frame keeps.

    Args:
        name: a selection, or a way to go on from the frame before with the model's own.
    """
    before = model.wavelets, model.selection
    model.wavelets, model.selection = count, name if name in haar.SELECTIONS else before[1]
    steady = SteadySelection(count, **STEADY[name]) if name in STEADY else None
    codes = [model.light(lighting, steady) for lighting in turning]
    model.wavelets, model.selection = before
    return [(code.index, code.value) for code in codes]


def whole_light(model: WaveletNeural, lighting: Float[Tensor, "6 R R 3"]) -> Kept:
    """All wavelets."""
    values = model.transformed(lighting)
    return torch.arange(len(values), device=values.device), values


@torch.no_grad()
def shaded(model: WaveletNeural, gbuffer: Any, kept: dict[Any, list[Kept]]) -> dict[Any, Tensor]:
    """The images (T, N, 3) of every list of frames: what :meth:`WaveletNeural.shade` gives one by one.

    An image is linear in the kept coefficients, and frames share most of their wavelets: the network is
    asked once for each wavelet that any frame has.
    """
    union = torch.cat([index for line in kept.values() for index, _ in line]).unique()
    weights = {}
    for key, line in kept.items():
        weights[key] = torch.zeros((3, len(line), len(union)), device=union.device)
        for frame, (index, value) in enumerate(line):
            weights[key][:, frame, torch.searchsorted(union, index)] = value.T
    images: dict[Any, list[Tensor]] = {key: [] for key in kept}
    for rows in torch.arange(len(gbuffer)).split(PIXELS):
        pixel = model.net.inputs(gbuffer.rows(rows).to(model.device))
        parts = [model.net.coefficients(pixel, k) for k in union.split(WAVELETS)]
        answer = torch.cat(parts, dim=1).permute(2, 1, 0).contiguous()  # colour, wavelet, pixel
        for key, weight in weights.items():
            images[key].append((weight @ answer).permute(1, 2, 0).cpu())
    return {key: torch.cat(parts, dim=1) for key, parts in images.items()}


def as_lighting(
    model: WaveletNeural, index: Int[Tensor, "k"], value: Float[Tensor, "k 3"]
) -> Float[Tensor, "T 3"]:
    """The lighting that is kept, per texel."""
    values = torch.zeros((len(model.measure), 3))
    values[index.cpu()] = value.cpu()
    return haar.inverse(values) / model.measure.cpu()


# ---- lights unlike training


def unlike_lights(
    task: Any, model: Method, name: str, kinds: list[str], views: int, folder: Path
) -> list[dict[str, Any]]:
    """Error under lightings of kinds that training had none of (figure 4: a red environment).

    ``psnr``, ``chroma/shift`` (how far the mean hue moves: a tone shift) and ``error/relative`` (root mean
    square error over the root mean square of the reference). Black gives no reference to divide by: its row
    is the largest radiance, ``error/black``, which has to be 0. Light transport is linear: under a multiple
    of a test lighting ``error/scaled`` is how far the image, divided by the factor, is from that under the
    lighting itself.

    Writes ``lights_<scene>_<name>.png``: reference and prediction of the first view under every kind.

    Args:
        model: any fitted method of the task; ``name``: its own.
        kinds: of :func:`prt.light.unlike.unlike`.
    """
    names, lightings = task.lighting.test()
    shown = task.scene.views("far", views, task.test_size, train_count=task.train_view_count)
    rows, pictures = [], []
    for kind in track(kinds, "lights unlike training", len(kinds)):
        found: dict[str, list[float]] = {"psnr": [], "chroma/shift": [], "error/relative": []}
        for number, view in enumerate(shown):
            usual = lightings[number % len(names)]
            lighting = unlike(usual, kind)
            title = f"{names[number % len(names)]} {kind}"
            item = task.test_item("unlike", f"far{number:02d}", view, title, lighting)
            reference = item.references["indirect"]
            image = item.gbuffer.image(model.shade(item.gbuffer, model.light(lighting)))
            if kind == "black":
                rows.append(row("error/black", float(image.abs().max()), f"lighting={kind}", 1))
                break
            found["psnr"].append(evaluate(image, reference, ["psnr"])["psnr"])
            found["chroma/shift"].append(chroma_shift(image, reference))
            found["error/relative"].append(float((image - reference).norm() / reference.norm()))
            factor = float(lighting.sum() / usual.sum())
            if torch.allclose(lighting, factor * usual, rtol=1e-4, atol=0):
                plain = item.gbuffer.image(model.shade(item.gbuffer, model.light(usual)))
                scaled = float((image / factor - plain).norm() / plain.norm())
                found.setdefault("error/scaled", []).append(scaled)
            if number == 0:
                pictures.append((kind, reference, image))
        if kind != "black":
            rows += [averaged(metric, values, f"lighting={kind}") for metric, values in found.items()]
    draw_lights(pictures, name, folder / f"lights_{task.scene.name}_{name}.png")
    return rows


def chroma_shift(image: Float[Tensor, "H W 3"], reference: Float[Tensor, "H W 3"]) -> float:
    """Distance of the mean CIE a*, b* of an image from that of its reference, in its exposure."""
    exposure = exposure_of(reference.numpy())
    a, b = (rgb2lab(to_srgb(part.numpy(), exposure))[..., 1:].mean((0, 1)) for part in (image, reference))
    return float(np.linalg.norm(a - b))


def draw_lights(pictures: list[tuple[str, Tensor, Tensor]], name: str, path: Path) -> None:
    """A column a lighting: the reference above the prediction, both in the reference's exposure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.9 * len(pictures), 4.1), layout="constrained")
    axes = figure.subplots(2, len(pictures), squeeze=False)
    for column, (kind, reference, image) in enumerate(pictures):
        exposure = exposure_of(reference.numpy())
        for line, (title, part) in enumerate((("reference", reference), (name, image))):
            axes[line][column].imshow(to_srgb(np.nan_to_num(part.numpy()), exposure), interpolation="nearest")
            axes[line][column].set(xticks=[], yticks=[])
            if column == 0:
                axes[line][column].set_ylabel(title.replace("_", " "), fontsize=8)
        axes[0][column].set_title(kind, fontsize=8)
    save_png(figure, path, dpi=150)


# ---- views


def views_outside(task: Any, model: Method, distances: list[float], views: int) -> list[dict[str, Any]]:
    """Error with the cameras of the far views moved in or out: ``distance`` times as far from their target.

    Training cameras stand at distance 1. A camera that no longer sees the scene, or stands in a wall, is
    left out; where none is left the row is missing.
    """
    names, lightings = task.lighting.test()
    shown = task.scene.views("far", views, task.test_size, train_count=task.train_view_count)
    rows = []
    for distance in track(distances, "views outside", len(distances)):
        values = []
        for number, view in enumerate(shown):
            moved, which = at_distance(view, distance), number % len(names)
            item = task.test_item(
                "outside", f"{distance:g}_{number:02d}", moved, names[which], lightings[which]
            )
            reference = item.references["indirect"]
            if len(item.gbuffer) == 0 or not reference.any():
                continue
            image = item.gbuffer.image(model.shade(item.gbuffer, model.light(item.lighting)))
            values.append(evaluate(image, reference, ["psnr"])["psnr"])
        if values:
            rows.append(averaged("psnr", values, f"distance={distance:g}"))
    return rows


def at_distance(view: View, factor: float) -> View:
    """The view from ``factor`` times as far from its target.

    Raises:
        PrtError: for a factor that is not positive.
    """
    if not factor > 0:
        raise PrtError(f"benchmark.distances={factor} must be positive")
    origin = tuple(t + factor * (o - t) for o, t in zip(view.origin, view.target, strict=True))
    return dataclasses.replace(view, origin=origin)

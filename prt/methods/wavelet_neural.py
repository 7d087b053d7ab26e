"""Neural free-viewpoint relighting for glossy indirect illumination (Raghavan et al. 2023).

Light is projected to Haar wavelets on a cubemap, the largest K coefficients are kept, and a network predicts
the transport coefficient T_k of each at every pixel; radiance is their dot product (Eq. 3, Algorithm 1).
The network is :class:`prt.nn.wavelet_transport.WaveletTransport`.

Every choice of the paper is a setting. Three choices differ from the paper at the smaller budgets, because
the transport is recorded here (docs/decisions/0002-recorded-transport-sets-the-scales.md): outputs are scaled
by the recorded transport's root mean square per wavelet (``scale_outputs``), wavelets are selected and drawn
by it (``selection``, ``draw``), and a step trains several lightings cut to the very wavelets it evaluates
(``target``), which removes the truncation error from the training target.
"""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.light import haar
from prt.methods.base import Component, FitLog, check_resolution
from prt.methods.training import PointSampler, fit_network, image_loss, radiance
from prt.methods.wavelet_gain import wavelet_gain
from prt.nn.hashgrid import HashGrid
from prt.nn.wavelet_texture import WaveletTexture
from prt.nn.wavelet_transport import WaveletTransport
from prt.scene.gbuffer import GBuffer
from prt.trace.statistics import wavelet_scale

SELECTIONS = ("magnitude", "area", "transport")


@dataclasses.dataclass
class WaveletCode:
    """A lighting as the K wavelets that are kept, with the first layer of the network folded for them."""

    index: Int[Tensor, "K"]
    value: Float[Tensor, "K 3"]
    folded: Float[Tensor, "M KH"]
    #: lighting coefficient times output scale, what multiplies the last hidden layer
    weight: Float[Tensor, "K 3"]


class WaveletNeural:
    """The method; settings as in ``conf/method/wavelet_neural.yaml``.

    Args:
        wavelets: K, lighting coefficients kept when rendering.
        selection: how K are chosen: by ``magnitude`` |L_k|, by ``area`` (Ng 2003), or by ``transport``
            |L_k| sigma_k.
        grid: levels, features, log2_table, base_resolution, scale of S (Mueller 2022); with ``finest_pixels``
            the growth per level is not ``scale`` but follows from the finest cell's width in training pixels.
        width: neurons in each of the two hidden layers of f.
        sh_degree: largest SH band of the reflected direction.
        scale_outputs: predict T_k / sigma_k instead of T_k.
        texture: W, one vector a wavelet (``independent``, the paper's) or partly ``shared`` by neighbours.
        training: steps, pixels, wavelets, largest_share, draw, lightings, target, loss, mu, epsilon, rates
            and decay (grid, wavelet, mlp; the latter decoupled weight decay), average, gain_points (training
            points that every wavelet's output is calibrated on after fitting, 0 for none:
            ``prt.methods.wavelet_gain``), strategies.
        precision: arithmetic of ``shade``: ``float32`` or ``bfloat16`` (the latter for the hidden layers).
        folded: shade through the folded form; the readable one (Algorithm 1 as printed) is the reference.
        chunk: pixels shaded at a time; bounds memory and keeps activations in cache.
    """

    component = Component.INDIRECT
    tasks = frozenset({"relight_indirect"})

    def __init__(
        self,
        wavelets: int,
        selection: Literal["magnitude", "area", "transport"],
        grid: dict[str, Any],
        width: int,
        sh_degree: int,
        scale_outputs: bool,
        texture: Literal["shared", "independent"],
        training: dict[str, Any],
        precision: Literal["float32", "bfloat16"] = "float32",
        folded: bool = True,
        chunk: int = 128,
    ):
        if selection not in SELECTIONS:
            raise PrtError(f"method.selection={selection!r} is not one of {', '.join(SELECTIONS)}")
        if precision not in ("float32", "bfloat16"):
            raise PrtError(f"method.precision={precision!r} is not one of float32, bfloat16")
        if training["draw"] not in ("uniform", "transport"):
            raise PrtError(f"method.training.draw={training['draw']!r} is not one of uniform, transport")
        if training["target"] not in ("full", "truncated"):
            raise PrtError(f"method.training.target={training['target']!r} is not one of full, truncated")
        if not isinstance(training["gain_points"], int) or training["gain_points"] < 0:
            raise PrtError(
                f"method.training.gain_points={training['gain_points']!r} must be an integer of at least 0"
            )
        if texture not in ("shared", "independent"):
            raise PrtError(f"method.texture={texture!r} is not one of shared, independent")
        if wavelets < 1:
            raise PrtError(f"method.wavelets={wavelets} must be at least 1")
        grid = dict(grid)
        self.finest_pixels = grid.pop("finest_pixels", None)
        number = isinstance(self.finest_pixels, int | float)
        if self.finest_pixels is not None and not (number and self.finest_pixels > 0):
            raise PrtError(
                f"method.grid.finest_pixels={self.finest_pixels} must be a number above 0, or null"
            )
        self.wavelets, self.selection, self.grid_settings = wavelets, selection, grid
        self.width, self.sh_degree, self.scale_outputs = width, sh_degree, scale_outputs
        self.texture = texture
        self.training, self.precision, self.folded, self.chunk = training, precision, folded, chunk
        self.device = "cpu"

    # ---- fitting

    def build(self, bounds, resolution: int, sigma: Tensor, device: str) -> None:
        """Make an untrained network for a box of space and a cubemap resolution."""
        grid = HashGrid(**self.grid_settings, bounds=bounds)
        scale = sigma if self.scale_outputs else None
        texture = WaveletTexture(resolution, grid.out_features, self.texture == "shared")
        self.net = WaveletTransport(grid, texture, self.width, self.sh_degree, scale).to(device)
        self.bounds, self.draw_weights = bounds, sigma.cpu()
        self.sigma, self.resolution, self.device = sigma.to(device), resolution, device

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Optimise Eq. 8 on points of the training views under training lightings."""
        data, settings = task.training(), self.training
        torch.manual_seed(seed)
        generator = torch.Generator().manual_seed(seed)
        sigma = wavelet_scale(data.transport, data.gbuffer)
        if self.finest_pixels is not None:
            width = self.finest_pixels * data.pixel_size
            self.grid_settings["scale"] = level_growth(self.grid_settings, data.bounds, width)
        self.build(data.bounds, task.resolution, sigma, device)
        net = self.net
        parameters = {
            "grid": net.grid.parameters(),
            "wavelet": net.texture.parameters(),
            "mlp": [net.feature, *net.mlp.parameters()],
        }
        groups = [
            {"params": part, "lr": settings["rates"][name], "weight_decay": settings["decay"][name]}
            for name, part in parameters.items()
        ]
        optimiser = torch.optim.AdamW(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)
        points = PointSampler(settings["strategies"], data.importance, settings["pixels"])
        lightings = task.train_lightings()
        coefficients = haar.forward(lightings.view(-1, 6, self.resolution, self.resolution, 3)).flatten(1, 3)
        # the share of the image that a wavelet is expected to carry, over lightings and places
        self.draw_weights = coefficients.square().mean(dim=(0, 2)).sqrt() * sigma
        precision = torch.bfloat16 if settings["precision"] == "bfloat16" else torch.float32
        surface = net.features(data.gbuffer)
        positions = data.gbuffer.position.to(device)
        # on the CPU the corners of a point cost more than the look-up; on a GPU they cost memory only
        corners = net.grid.corners(positions) if device == "cpu" else None

        def step() -> Tensor:
            chosen = points.draw(generator)
            which = torch.randint(len(lightings), (settings["lightings"],), generator=generator)
            k = self.draw_wavelets(coefficients[which], generator)
            kept = coefficients[which][:, k]
            if settings["target"] == "truncated":
                seen = haar.inverse(haar.keep_only(coefficients[which], k.expand(len(which), -1)))
            else:
                seen = lightings[which]
            target = radiance(data.transport, chosen, seen).to(device)
            space = net.grid(positions[chosen]) if corners is None else net.grid.lookup(corners.rows(chosen))
            predicted = net.coefficients(space, surface[chosen].to(device), k.to(device), precision)
            image = torch.einsum("pkc,lkc->lpc", predicted, kept.to(device))
            return image_loss(image, target, settings["loss"], settings["mu"], settings["epsilon"])

        fit_network(log, "wavelet_neural", net, settings, generator, step, optimiser)
        if settings["gain_points"]:
            gain = wavelet_gain(net, data, settings["gain_points"], generator, precision).to(device)
            net.scale = net.scale * gain  # not in place: it may be the same tensor as sigma
            self.sigma = self.sigma * gain

    def draw_wavelets(
        self, coefficients: Float[Tensor, "L T 3"], generator: torch.Generator
    ) -> Int[Tensor, "K"]:
        """A step's wavelets: a share of the largest of its lightings, the rest at random (section 5)."""
        count, total = self.training["wavelets"], coefficients.shape[1]
        largest = round(count * self.training["largest_share"])
        strength = coefficients.square().sum(dim=2)
        if self.selection == "transport":
            strength = strength * self.sigma.cpu().square()
        mine = largest // len(coefficients) + 1
        chosen = torch.unique(strength.topk(min(mine, total), dim=1).indices)[:largest]
        weights = self.draw_weights.clone() if self.training["draw"] == "transport" else torch.ones(total)
        weights[chosen] = 0
        rest = torch.multinomial(weights, count - len(chosen), generator=generator)
        return torch.cat([chosen, rest])

    # ---- rendering

    @torch.no_grad()
    def light(self, lighting: Float[Tensor, "6 R R 3"]) -> WaveletCode:
        """Wavelet transform, selection of K, folding of the first layer (Algorithm 1, lines 2 and 3)."""
        check_resolution(lighting, self.resolution)
        values, index = self.select(lighting)
        kept = values[index]
        folded = self.net.fold(index)
        if self.precision == "bfloat16":
            folded = folded.bfloat16()
        return WaveletCode(index, kept, folded, kept * self.net.scale[index][:, None])

    def select(self, lighting: Float[Tensor, "6 R R 3"]) -> tuple[Float[Tensor, "T 3"], Int[Tensor, "K"]]:
        """All coefficients of a lighting, and which of them are kept."""
        values = haar.forward(lighting.to(self.device)).reshape(-1, 3)
        return values, haar.top_k(values, min(self.wavelets, len(values)), self.selection, self.sigma)

    def truncated(self, lighting: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "6 R R 3"]:
        """The lighting that :meth:`light` keeps, for the error split."""
        values, index = self.select(lighting)
        return haar.inverse(haar.keep_only(values, index)).view(lighting.shape).to(lighting.device)

    @torch.no_grad()
    def shade(self, gbuffer: GBuffer, code: WaveletCode, v: Tensor | None = None) -> Float[Tensor, "N 3"]:
        """Indirect radiance (Algorithm 1, lines 4 to 9)."""
        gbuffer = gbuffer.to(self.device)
        render = self.shade_folded if self.folded else self.shade_readable
        return render(gbuffer.position, self.net.features(gbuffer), code).cpu()

    def shade_readable(
        self, position: Float[Tensor, "N 3"], features: Float[Tensor, "N F"], code: WaveletCode
    ) -> Float[Tensor, "N 3"]:
        """B = sum_k L_k T_k with T_k evaluated as printed."""
        out = position.new_zeros((len(position), 3))
        for rows in self.chunks(len(position)):
            coefficients = self.net.coefficients_readable(position[rows], features[rows], code.index)
            out[rows] = torch.einsum("nkc,kc->nc", coefficients, code.value)
        return out

    def shade_folded(
        self, position: Float[Tensor, "N 3"], features: Float[Tensor, "N F"], code: WaveletCode
    ) -> Float[Tensor, "N 3"]:
        """The same with the first layer folded per light and the last layer applied after the sum over k.

        Of both hidden layers only ``max(z, -b)`` is computed, z the pre-activation without its bias b: since
        ``relu(z + b) = max(z, -b) + b`` and b is the same for all wavelets of a pixel, what is left out
        passes through the next layer once per pixel. The two large products run in the precision of the code,
        into two buffers that every chunk of pixels reuses: they stay in cache and are never allocated anew.
        """
        net, (_, second, last) = self.net, self.net.mlp.layers
        kind, wavelets, width = code.folded.dtype, len(code.index), net.width
        space = net.grid(position).to(kind)
        bias = net.per_pixel(features)
        next_bias = torch.addmm(second.bias, bias, second.weight.T)
        floor, next_floor = (-part.to(kind)[:, None, :] for part in (bias, next_bias))
        weight, light = second.weight.T.to(kind), code.weight.T.to(kind)
        first, hidden = space.new_empty((2, min(self.chunk, len(position)) * wavelets, width))
        summed = space.new_empty((len(position), 3, width))
        for rows in self.chunks(len(position)):
            pixels = len(space[rows])
            a, b = (buffer[: pixels * wavelets] for buffer in (first, hidden))
            per_wavelet = (pixels, wavelets, width)
            torch.mm(space[rows], code.folded, out=a.view(pixels, -1))
            torch.maximum(a.view(per_wavelet), floor[rows], out=a.view(per_wavelet))
            torch.mm(a, weight, out=b)
            torch.maximum(b.view(per_wavelet), next_floor[rows], out=b.view(per_wavelet))
            torch.matmul(light, b.view(per_wavelet), out=summed[rows])
        total = code.weight.sum(dim=0)
        out = torch.einsum("nch,ch->nc", summed.float(), last.weight)
        return out + total * (next_bias @ last.weight.T + last.bias)

    def chunks(self, pixels: int) -> Iterator[slice]:
        """The pixels of a frame in parts of ``chunk``."""
        return (slice(start, start + self.chunk) for start in range(0, pixels, self.chunk))

    # ---- storage

    def nbytes(self) -> int:
        """Grid, W, U and f; sigma is needed for selection and is counted."""
        return sum(value.numel() * value.element_size() for value in self.net.state_dict().values())

    def save(self, path: Path) -> None:
        state = {name: value.detach().cpu().contiguous() for name, value in self.net.state_dict().items()}
        save_file(
            {**state, "sigma": self.sigma.cpu().clone()},
            path,
            metadata={
                "resolution": str(self.resolution),
                "bounds": json.dumps(self.bounds),
                "scale": json.dumps(self.grid_settings["scale"]),
            },
        )

    def load(self, path: Path, task: Any, device: str) -> None:
        with safe_open(path, "pt") as file:
            stored = file.metadata()
        resolution, bounds = int(stored["resolution"]), json.loads(stored["bounds"])
        if "scale" in stored:  # models stored before finest_pixels have the configured one
            self.grid_settings["scale"] = json.loads(stored["scale"])
        state = load_file(path)
        self.build(bounds, resolution, state.pop("sigma"), device)
        self.net.load_state_dict(state)


def level_growth(grid: dict[str, Any], bounds: tuple[list[float], list[float]], width: float) -> float:
    """Growth per level with which the finest cells of a hash grid are ``width`` wide (world units).

    Never below 1: where even the coarsest cells are narrower, all levels are as coarse as the coarsest.
    """
    extent = max(high - low for low, high in zip(*bounds, strict=True))
    ratio = extent / (width * grid["base_resolution"])
    return max(1.0, ratio) ** (1 / max(1, grid["levels"] - 1))

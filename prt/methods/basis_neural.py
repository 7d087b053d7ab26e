"""Neural transport in a light basis of the scene's own: one evaluation a pixel, for any number of terms.

This project's own method (docs/decisions/0010-basis-neural.md). Raghavan 2023 asks a network once for each of
K wavelets; here the lighting is projected to the M principal components of recorded transport, weighted by
what lightings are like (:mod:`prt.trace.light_basis`), and one network predicts all M coefficients of a pixel
at once. The last layer is summed over the terms once per lighting: a frame costs the same for any M.

It is trained on the coefficients themselves, which recorded transport gives without any lighting: under the
prior they have unit variance, so that the squared error of coefficients is that of images.
"""

import json
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import Component, FitLog, check_lighting
from prt.methods.training import PointSampler, fit_network, mu_law_slope
from prt.methods.wavelet_neural import level_growth
from prt.nn.basis_network import BasisNetwork
from prt.nn.hashgrid import HashGrid
from prt.scene.gbuffer import GBuffer
from prt.trace.light_basis import LightBasis, prior_weighted_basis
from prt.trace.mirrored import mirrored

#: points whose coefficients are read from the record at a time: bounds the memory
BLOCK = 1 << 15


class BasisNeural:
    """The method; settings as in ``conf/method/basis_neural.yaml``.

    Args:
        terms: M, patterns of the light basis.
        grid: of the place; levels, features, log2_table, base_resolution and finest_pixels, the width of the
            finest cells in training pixels.
        mirror: the same of the place that the mirror ray meets; levels 0: no mirror rays.
        width, hidden_layers: of both parts of the network.
        sh_degree: largest SH band of the reflected direction.
        training: steps, pixels, mu, epsilon, rates and decay (grid, mlp), average, strategies.
        chunk: pixels shaded at a time.
    """

    component = Component.INDIRECT
    tasks = frozenset({"relight_indirect"})
    rendering = frozenset({"chunk"})

    def __init__(
        self, terms: int, grid: dict[str, Any], mirror: dict[str, Any], width: int, hidden_layers: int,
        sh_degree: int, training: dict[str, Any], chunk: int = 4096,
    ):  # fmt: skip
        for name, value in {"terms": terms, "width": width, "hidden_layers": hidden_layers}.items():
            if not isinstance(value, int) or value < 1:
                raise PrtError(f"method.{name}={value!r} must be an integer of at least 1")
        self.terms, self.grid, self.mirror = terms, dict(grid), dict(mirror)
        self.width, self.hidden_layers, self.sh_degree = width, hidden_layers, sh_degree
        self.training, self.chunk, self.device = training, chunk, "cpu"
        self.mi_scene: Any = None

    # ---- fitting

    def build(
        self, bounds, basis: LightBasis, scale: Float[Tensor, "M"], growth: dict[str, float], device: str
    ) -> None:
        """Make an untrained network."""
        grid = {key: value for key, value in self.grid.items() if key != "finest_pixels"}
        second = {key: value for key, value in self.mirror.items() if key != "finest_pixels"}
        place = HashGrid(**grid, scale=growth["grid"], bounds=bounds)
        met = HashGrid(**second, scale=growth["mirror"], bounds=bounds) if self.mirror["levels"] else None
        net = BasisNetwork(place, met, self.width, self.hidden_layers, self.sh_degree, scale)
        self.net, self.basis, self.device = net.to(device), basis, device
        self.bounds, self.growth = bounds, growth
        self.resolution = round((basis.patterns.shape[1] / 6) ** 0.5)

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Regress the recorded coefficients of the training points."""
        data, settings = task.training(), self.training
        torch.manual_seed(seed)
        generator = torch.Generator().manual_seed(seed)
        basis = prior_weighted_basis(data.transport, data.gbuffer, task.train_lightings(), self.terms)
        target = recorded_coefficients(data.transport, basis)
        scale = target.square().mean(dim=(0, 2)).sqrt().clamp(min=1e-12)
        growth = {
            name: level_growth(part, data.bounds, part["finest_pixels"] * data.pixel_size)
            if part["levels"]
            else 1.0
            for name, part in (("grid", self.grid), ("mirror", self.mirror))
        }
        self.build(data.bounds, basis, scale, growth, device)
        self.mi_scene = task.mitsuba_scene
        net, gbuffer = self.net, data.gbuffer
        rays = mirrored(self.mi_scene, gbuffer) if net.mirrored is not None else ()
        prior = data.transport.relight(task.prior()[None])[0].mean(dim=1)
        slope = mu_law_slope(prior, settings["mu"], settings["epsilon"])
        points = PointSampler(settings["strategies"], data.importance, settings["pixels"])
        grids = [net.grid, *([net.mirrored] if net.mirrored is not None else [])]
        parameters = {
            "grid": [p for grid in grids for p in grid.parameters()],
            "mlp": [*net.diffuse.parameters(), *net.specular.parameters()],
        }
        groups = [
            {"params": part, "lr": settings["rates"][name], "weight_decay": settings["decay"][name]}
            for name, part in parameters.items()
        ]
        optimiser = torch.optim.AdamW(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)

        def step() -> Tensor:
            chosen = points.draw(generator)
            part = [each[chosen].to(device) for each in rays]
            found = net.coefficients(gbuffer.rows(chosen).to(device), *part)
            error = (found - target[chosen].to(device)).square().sum(dim=(1, 2)) / 3
            return (error * slope[chosen].to(device).square()).mean()

        fit_network(log, "basis_neural", net, settings, generator, step, optimiser)

    # ---- rendering

    @torch.no_grad()
    def light(self, lighting: Float[Tensor, "6 R R 3"]) -> list:
        """Projection to the basis, and the last layers summed over its terms."""
        check_lighting(lighting, self.resolution)
        return self.net.fold(self.basis.project(lighting.cpu()).to(self.device))

    def truncated(self, lighting: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "6 R R 3"]:
        """The lighting that the basis sees, for the error split."""
        return self.basis.kept(lighting.cpu()).to(lighting.device)

    @torch.no_grad()
    def shade(self, gbuffer: GBuffer, code: list, v: Tensor | None = None) -> Float[Tensor, "N 3"]:
        """Indirect radiance; mirror rays are traced first, where the network sees them."""
        rays = mirrored(self.mi_scene, gbuffer) if self.net.mirrored is not None else ()
        out = torch.zeros((len(gbuffer), 3))
        for rows in torch.arange(len(gbuffer)).split(self.chunk):
            part = [each[rows].to(self.device) for each in rays]
            out[rows] = self.net.radiance(gbuffer.rows(rows).to(self.device), code, *part).cpu()
        return out

    # ---- storage

    def nbytes(self) -> int:
        """The network, and the projection of lightings."""
        state = sum(value.numel() * value.element_size() for value in self.net.state_dict().values())
        return state + self.basis.projection.numel() * self.basis.projection.element_size()

    def save(self, path: Path) -> None:
        state = {
            f"net.{name}": value.detach().cpu().contiguous() for name, value in self.net.state_dict().items()
        }
        state |= {name: getattr(self.basis, name).clone() for name in ("patterns", "projection", "energy")}
        save_file(
            state, path, metadata={"bounds": json.dumps(self.bounds), "growth": json.dumps(self.growth)}
        )

    def load(self, path: Path, task: Any, device: str) -> None:
        with safe_open(path, "pt") as file:
            stored = file.metadata()
        state = load_file(path)
        basis = LightBasis(*(state.pop(name) for name in ("patterns", "projection", "energy")))
        net = {name.removeprefix("net."): value for name, value in state.items()}
        self.build(json.loads(stored["bounds"]), basis, net["scale"], json.loads(stored["growth"]), device)
        self.net.load_state_dict(net)
        if self.net.mirrored is not None:
            self.mi_scene = task.mitsuba_scene


def recorded_coefficients(transport: Any, basis: LightBasis) -> Float[Tensor, "N M 3"]:
    """a of every recorded point: its transport relit by the patterns of the basis."""
    patterns = basis.patterns[:, :, None].expand(-1, -1, 3)
    found = [transport.rows(rows).relight(patterns) for rows in blocks(transport.pixels)]
    return torch.cat(found, dim=1).permute(1, 0, 2).contiguous()


def blocks(count: int) -> tuple[Int[Tensor, "B"], ...]:
    return torch.arange(count).split(BLOCK)

"""Neural Precomputed Radiance Transfer (Rainer et al. 2022), the diffuse-specular separation.

The best of that paper's four architectures and the baseline of Raghavan 2023, Table 1. A convolutional
encoder turns the environment into a diffuse and a specular light code. Per pixel, one network turns position
and normal into a diffuse transport code, another turns position, normal, reflected direction and roughness
into a specular one. Each transport code is concatenated with its light code and decoded to a colour; the
colours are multiplied by the diffuse and the specular reflectance of the pixel and summed:

    B = k_d D_d(T_d(x, n), E_d(L)) + k_s D_s(T_s(x, n, w_r, sigma), E_s(L))

What the publications leave open is decided here: the encoder sees log(1 + L / mean L) on cubemap faces, the
decoders end in softplus (radiance is not negative), and everything is multiplied by mean L, so that a
lighting twice as bright gives twice the radiance. Layer sizes are settings; at ``budget=paper`` they sum to
about half a million parameters. The training data, loss and pixel sampling are those of wavelet_neural.
"""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.light.sh import sh_basis
from prt.methods.base import Component, FitLog, check_lighting
from prt.methods.training import BatchSampler, fit_network, image_loss
from prt.nn.encodings import log_roughness, one_blob
from prt.nn.mlp import Mlp
from prt.scene.gbuffer import GBuffer

#: texels a side at which the encoder stops halving the faces
LAST_SIDE = 4
#: keeps a black lighting finite: its code is that of a constant zero and its radiance is zero
DARKEST = 1e-20


class LightEncoder(torch.nn.Module):
    """Cubemap to a diffuse and a specular light code.

    Faces share 3 x 3 convolutions of stride 2 down to 4 x 4 texels; a 1 x 1 convolution narrows them before
    one linear layer sees all six faces, which is where their places on the sphere come in.
    """

    def __init__(self, resolution: int, channels: int, narrow: int, code: int):
        super().__init__()
        stages = round(math.log2(resolution / LAST_SIDE)) if resolution >= LAST_SIDE else 0
        if resolution != LAST_SIDE << stages:
            raise PrtError(
                f"neural_prt needs a cubemap {LAST_SIDE} times a power of 2 wide, not {resolution}: "
                "set task.resolution to 8, 16, 32 or 64"
            )
        widths = [3] + [min(channels << stage, 4 * channels) for stage in range(stages)]
        self.convolutions = torch.nn.ModuleList(
            torch.nn.Conv2d(a, b, 3, stride=2, padding=1)
            for a, b in zip(widths[:-1], widths[1:], strict=True)
        )
        self.narrow = torch.nn.Conv2d(widths[-1], narrow, 1)
        self.linear = torch.nn.Linear(6 * narrow * LAST_SIDE**2, 2 * code)

    def forward(
        self, lightings: Float[Tensor, "L 6 R R 3"]
    ) -> tuple[Float[Tensor, "L C"], Float[Tensor, "L C"]]:
        """Codes of lightings of unit mean."""
        faces = torch.log1p(lightings).flatten(0, 1).permute(0, 3, 1, 2)
        for convolution in self.convolutions:
            faces = torch.relu(convolution(faces))
        faces = torch.relu(self.narrow(faces)).reshape(len(lightings), -1)
        diffuse, specular = self.linear(faces).chunk(2, dim=1)
        return diffuse, specular


class Branch(torch.nn.Module):
    """Transport network and decoder of one of the two kinds of reflection."""

    def __init__(self, inputs: int, width: int, hidden_layers: int, code: int):
        super().__init__()
        self.transport = Mlp(inputs, width, hidden_layers, code)
        self.decoder = Mlp(2 * code, width, hidden_layers, 3)

    def forward(self, features: Float[Tensor, "P I"], light: Float[Tensor, "L C"]) -> Float[Tensor, "L P 3"]:
        """Colour before the reflectance, for every point under every light code."""
        first, *_ = self.decoder.layers
        transport = torch.relu(self.transport(features))
        # The first layer acts on [transport, light]: its halves are applied once per point, once per light.
        per_point = torch.nn.functional.linear(transport, first.weight[:, : transport.shape[1]], first.bias)
        per_light = light @ first.weight[:, transport.shape[1] :].T
        hidden = torch.relu(per_point + per_light[:, None])
        for layer in self.decoder.layers[1:-1]:
            hidden = torch.relu(layer(hidden))
        return torch.nn.functional.softplus(self.decoder.layers[-1](hidden))


class NeuralPrtNet(torch.nn.Module):
    """Encoder and both branches.

    Args:
        bounds: corners of the scene, mapped to [-1, 1].
        position_bins: bins of the one-blob encoding of the position that is appended to it; 0 for none.
        sh_degree: largest SH band of the reflected direction; 0 for the direction itself.
    """

    def __init__(
        self,
        bounds,
        resolution: int,
        width: int,
        hidden_layers: int,
        code: int,
        channels: int,
        narrow: int,
        position_bins: int,
        sh_degree: int,
    ):
        super().__init__()
        low, high = (torch.tensor(corner, dtype=torch.float32) for corner in bounds)
        self.register_buffer("middle", (low + high) / 2, persistent=False)
        self.register_buffer("radius", ((high - low) / 2).clamp(min=1e-6), persistent=False)
        self.position_bins, self.sh_degree = position_bins, sh_degree
        surface = 3 + 3 * position_bins + 3
        direction = (sh_degree + 1) ** 2 if sh_degree else 3
        self.encoder = LightEncoder(resolution, channels, narrow, code)
        self.diffuse = Branch(surface, width, hidden_layers, code)
        self.specular = Branch(surface + direction + 1, width, hidden_layers, code)

    def features(self, gbuffer: GBuffer) -> tuple[Float[Tensor, "N D"], Float[Tensor, "N S"]]:
        """Inputs of the diffuse and the specular transport network."""
        place = ((gbuffer.position - self.middle) / self.radius).clamp(-1, 1)
        surface = [place, gbuffer.normal]
        if self.position_bins:
            surface.append(one_blob(place / 2 + 0.5, self.position_bins))
        direction = sh_basis(gbuffer.wr, self.sh_degree) if self.sh_degree else gbuffer.wr
        return torch.cat(surface, 1), torch.cat([*surface, direction, log_roughness(gbuffer.roughness)], 1)

    def decode(
        self,
        gbuffer_colours: tuple[Tensor, Tensor],
        features: tuple[Tensor, Tensor],
        codes: tuple[Tensor, Tensor],
    ) -> Float[Tensor, "L P 3"]:
        """Radiance under lightings of unit mean."""
        (k_d, k_s), (diffuse, specular) = gbuffer_colours, features
        return k_d * self.diffuse(diffuse, codes[0]) + k_s * self.specular(specular, codes[1])


@dataclasses.dataclass
class LightCode:
    """A lighting as its two codes and its mean radiance."""

    diffuse: Float[Tensor, "1 C"]
    specular: Float[Tensor, "1 C"]
    mean: Float[Tensor, ""]


class NeuralPrt:
    """The method; settings as in ``conf/method/neural_prt.yaml``.

    Args:
        width, hidden_layers: of each of the four networks (two of transport, two decoders).
        code: values in a light code and in a transport code.
        channels, narrow: of the light encoder's first convolution and before its linear layer.
        position_bins, sh_degree: input encodings, 0 for none.
        training: steps, pixels, lightings, loss, mu, epsilon, rate, average, strategies.
        chunk: pixels shaded at a time.
    """

    component = Component.INDIRECT
    tasks = frozenset({"relight_indirect"})

    def __init__(
        self,
        width: int,
        hidden_layers: int,
        code: int,
        channels: int,
        narrow: int,
        position_bins: int,
        sh_degree: int,
        training: dict[str, Any],
        chunk: int = 4096,
    ):
        for name, value, least in (
            ("width", width, 1),
            ("hidden_layers", hidden_layers, 1),
            ("code", code, 1),
            ("channels", channels, 1),
            ("narrow", narrow, 1),
            ("chunk", chunk, 1),
            ("position_bins", position_bins, 0),
            ("sh_degree", sh_degree, 0),
        ):
            if not isinstance(value, int) or value < least:
                raise PrtError(f"method.{name}={value!r} must be an integer of at least {least}")
        self.sizes = {
            "width": width, "hidden_layers": hidden_layers, "code": code, "channels": channels,
            "narrow": narrow, "position_bins": position_bins, "sh_degree": sh_degree,
        }  # fmt: skip
        self.training, self.chunk, self.device = training, chunk, "cpu"

    # ---- fitting

    def build(self, bounds, resolution: int, device: str) -> None:
        """Make an untrained network for a box of space and a cubemap resolution."""
        self.net = NeuralPrtNet(bounds, resolution, **self.sizes).to(device)
        self.resolution, self.device, self.bounds = resolution, device, bounds

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Train encoder, transport and decoders end to end on points of the training views."""
        data, settings = task.training(), self.training
        torch.manual_seed(seed)
        generator = torch.Generator().manual_seed(seed)
        self.build(data.bounds, task.resolution, device)
        net, surface = self.net, data.gbuffer.to(device)
        lightings = task.train_lightings()
        unit, mean = normalise(lightings.view(-1, 6, self.resolution, self.resolution, 3).to(device))
        sampler = BatchSampler(
            data, lightings, settings["pixels"], settings["lightings"], settings["strategies"], device
        )
        optimiser = torch.optim.Adam(net.parameters(), lr=settings["rate"], betas=(0.9, 0.99), fused=True)

        def step() -> Tensor:
            batch = sampler.draw(generator)
            points, which = surface.rows(batch.points.to(device)), batch.lighting_index.to(device)
            image = net.decode(
                (points.diffuse, points.specular), net.features(points), net.encoder(unit[which])
            )
            image = image * mean[which][:, None, None]
            return image_loss(image, batch.target, settings["loss"], settings["mu"], settings["epsilon"])

        fit_network(log, "neural_prt", net, settings, generator, step, optimiser)

    # ---- rendering

    @torch.no_grad()
    def light(self, lighting: Float[Tensor, "6 R R 3"]) -> LightCode:
        """Encode the lighting once."""
        check_lighting(lighting, self.resolution)
        unit, mean = normalise(lighting[None].to(self.device))
        diffuse, specular = self.net.encoder(unit)
        return LightCode(diffuse, specular, mean[0])

    @torch.no_grad()
    def shade(self, gbuffer: GBuffer, code: LightCode, v: Tensor | None = None) -> Float[Tensor, "N 3"]:
        """Indirect radiance of every point."""
        gbuffer, codes = gbuffer.to(self.device), (code.diffuse, code.specular)
        parts = [torch.zeros((0, 3))]
        for start in range(0, len(gbuffer), self.chunk):
            points = gbuffer.rows(slice(start, start + self.chunk))
            image = self.net.decode((points.diffuse, points.specular), self.net.features(points), codes)
            parts.append((image[0] * code.mean).cpu())
        return torch.cat(parts)

    # ---- storage

    def nbytes(self) -> int:
        """All weights, the light encoder's included."""
        return sum(value.numel() * value.element_size() for value in self.net.parameters())

    def save(self, path: Path) -> None:
        state = {name: value.detach().cpu().contiguous() for name, value in self.net.state_dict().items()}
        save_file(
            state, path, metadata={"resolution": str(self.resolution), "bounds": json.dumps(self.bounds)}
        )

    def load(self, path: Path, task: Any, device: str) -> None:
        """Raises PrtError where the file was written with other sizes."""
        with safe_open(path, "pt") as file:
            resolution, bounds = int(file.metadata()["resolution"]), json.loads(file.metadata()["bounds"])
        self.build(bounds, resolution, device)
        try:
            self.net.load_state_dict(load_file(path))
        except RuntimeError as error:
            raise PrtError(
                f"{path} was written with other layer sizes than method={self.sizes}; "
                "use the run's own config.yaml"
            ) from error


def normalise(lightings: Float[Tensor, "L 6 R R 3"]) -> tuple[Float[Tensor, "L 6 R R 3"], Float[Tensor, "L"]]:
    """Lightings of unit mean over texels and colours, and their means."""
    mean = lightings.flatten(1).mean(dim=1)
    return lightings / mean.clamp(min=DARKEST)[:, None, None, None, None], mean

"""Neural free-viewpoint relighting for glossy indirect illumination (Raghavan et al. 2023).

Light is projected to Haar wavelets on a cubemap, the largest K coefficients are kept, and a network predicts
the transport coefficient T_k of each at every pixel; radiance is their dot product (Eq. 3, Algorithm 1).
The network is :class:`prt.nn.wavelet_transport.WaveletTransport`, its training
:class:`prt.methods.wavelet_training.WaveletTraining`, Algorithm 1 :mod:`prt.methods.wavelet_shading`.

Every choice of the paper is a setting. Three choices differ from the paper at the smaller budgets, because
the transport is recorded here (docs/decisions/0002-recorded-transport-sets-the-scales.md): outputs are scaled
by the recorded transport's root mean square per wavelet (``scale_outputs``), wavelets are selected and drawn
by it (``selection``, ``draw``), and a step trains several lightings cut to the very wavelets it evaluates
(``target``), which removes the truncation error from the training target.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.light import haar
from prt.light.cubemap import texel_solid_angles
from prt.light.steady import SteadySelection
from prt.methods.base import Component, FitLog, check_lighting
from prt.methods.mirrored_training import with_mirrored
from prt.methods.training import fit_network
from prt.methods.wavelet_fused import Form, check_kernel, encode, form_of, shade_as
from prt.methods.wavelet_gain import wavelet_gain
from prt.methods.wavelet_mirrors import Mirrors, sigma_setting
from prt.methods.wavelet_shading import WaveletCode
from prt.methods.wavelet_training import WaveletTraining, check_training
from prt.nn.direction_encodings import direction_encoding
from prt.nn.hashgrid import HashGrid
from prt.nn.vertex_features import VertexFeatures
from prt.nn.wavelet_texture import WaveletTexture
from prt.nn.wavelet_transport import WaveletTransport
from prt.scene.gbuffer import GBuffer
from prt.scene.mesh_places import MeshPlaces
from prt.scene.subdivide import fine_mesh
from prt.trace.statistics import wavelet_scale

FEATURES = ("hashgrid", "vertices")


class WaveletNeural:
    """The method; settings as in ``conf/method/wavelet_neural.yaml``.

    Args:
        wavelets: K, lighting coefficients kept when rendering.
        selection: how K are chosen: by ``magnitude`` |L_k|, by ``area`` (Ng 2003), or by ``transport``
            |L_k| sigma_k.
        grid: levels, features, log2_table, base_resolution, scale of S (Mueller 2022); with ``finest_pixels``
            the growth per level is not ``scale`` but follows from the finest cell's width in training pixels.
        features: where S is stored: in the ``hashgrid``, or on the ``vertices`` of the scene's meshes with a
            softplus behind (section 6.4). M is ``grid.levels`` times ``grid.features`` either way.
        vertices: edge_pixels, the longest edge in training pixels that a mesh may have (longer ones are
            halved: what lies between the corners of a large triangle is not stored anywhere), and most, the
            vertices that are allowed.
        width: neurons in each of the two hidden layers of f.
        directions: kind of the encoding of reflected direction, normal and roughness, and its sizes
            (``prt.nn.direction_encodings``).
        solid_angle: transform radiance times solid angle instead of radiance, which the paper found worse.
        scale_outputs: predict T_k / sigma_k instead of T_k.
        texture: W, one vector a wavelet (``independent``, the paper's) or partly ``shared`` by neighbours.
        training: steps, pixels, wavelets, largest_share, draw, lightings, lightings_per_view, supervision,
            target, loss, mu, epsilon, rates and decay (grid, wavelet, mlp; decay is decoupled),
            average, gain_points (training points that every wavelet's output is calibrated on after fitting,
            0 for none: ``prt.methods.wavelet_gain``), strategies.
        precision: arithmetic of ``shade``: ``float32`` or ``bfloat16`` (the latter for the hidden layers).
        folded: shade through the folded form; the readable one (Algorithm 1 as printed) is the reference.
        chunk: pixels shaded at a time; bounds memory and keeps activations in cache.
        kernel: the folded form in ``plain`` torch, or ``fused``: Triton on a GPU, compiled C++ on the CPU
            (``prt.methods.wavelet_fused``). ``auto``: fused on a GPU where Triton is installed, else plain.
        secondary: rays traced at near-mirrors instead (``prt.methods.wavelet_mirrors.Mirrors``); None: never.
        mirrored: pixels of surfaces of a sigma below this also train what they show, which secondary rays ask
            for (``prt.methods.mirrored_training``); 0: none.
    """

    component = Component.INDIRECT
    tasks = frozenset({"relight_indirect"})
    #: settings that a fitted model does not depend on
    rendering = frozenset({"wavelets", "precision", "folded", "chunk", "kernel", "secondary"})

    def __init__(
        self,
        wavelets: int,
        selection: Literal["magnitude", "area", "transport"],
        grid: dict[str, Any],
        width: int,
        directions: dict[str, Any],
        scale_outputs: bool,
        texture: Literal["shared", "independent"],
        training: dict[str, Any],
        features: Literal["hashgrid", "vertices"] = "hashgrid",
        vertices: dict[str, Any] | None = None,
        solid_angle: bool = False,
        precision: Literal["float32", "bfloat16"] = "float32",
        folded: bool = True,
        chunk: int = 128,
        secondary: dict[str, Any] | None = None,
        mirrored: float = 0.0,
        kernel: Literal["auto", "plain", "fused"] = "auto",
    ):
        if selection not in haar.SELECTIONS:
            raise PrtError(f"method.selection={selection!r} is not one of {', '.join(haar.SELECTIONS)}")
        if precision not in ("float32", "bfloat16"):
            raise PrtError(f"method.precision={precision!r} is not one of float32, bfloat16")
        if features not in FEATURES:
            raise PrtError(f"method.features={features!r} is not one of {', '.join(FEATURES)}")
        if features == "vertices":
            check_vertices(vertices or {})
        check_training(training)
        check_kernel(kernel, folded)
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
        self.features, self.vertices = features, dict(vertices or {})
        self.longest_edge: float | None = None
        self.width, self.directions, self.scale_outputs = width, directions, scale_outputs
        self.texture, self.solid_angle = texture, bool(solid_angle)
        self.training, self.precision, self.folded, self.chunk = training, precision, folded, chunk
        self.kernel = kernel
        self.mirrors, self.mirrored = Mirrors(secondary), sigma_setting("mirrored", mirrored)
        if self.mirrored and training["lightings_per_view"] is not None:
            raise PrtError(
                f"method.mirrored={mirrored} trains points that no view has; it does not go with "
                "method.training.lightings_per_view, set one of them to its default"
            )
        self.device = "cpu"

    # ---- fitting

    def build(self, bounds, resolution: int, sigma: Tensor, device: str, scene: Any = None) -> None:
        """Make an untrained network for a box of space and a cubemap resolution.

        ``scene``: whose vertices hold the features, where they do.
        """
        if self.longest_edge is None:
            grid = HashGrid(**self.grid_settings, bounds=bounds)
        else:
            grid = self.on_vertices(scene, self.longest_edge)
        scale = sigma if self.scale_outputs else None
        texture = WaveletTexture(resolution, grid.out_features, self.texture == "shared")
        directions = direction_encoding(self.directions, grid.out_features)
        self.net = WaveletTransport(grid, texture, directions, self.width, scale).to(device)
        self.bounds, self.sigma = bounds, sigma.to(device)
        self.resolution, self.device = resolution, device
        self.measure = measure(resolution, self.solid_angle)

    def on_vertices(self, scene: Any, longest: float) -> VertexFeatures:
        """S on the vertices of a scene's meshes."""
        mesh = fine_mesh(scene, longest, self.vertices["most"], "method.vertices")
        terms = self.grid_settings["levels"] * self.grid_settings["features"]
        return VertexFeatures(len(mesh.position), terms, MeshPlaces(mesh))

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Optimise Eq. 8 on points of the training views under training lightings."""
        data, settings = task.training(), self.training
        if self.mirrored:
            data = with_mirrored(data, task.mitsuba_scene, self.mirrored)
        torch.manual_seed(seed)
        generator = torch.Generator().manual_seed(seed)
        if self.solid_angle:
            transport = data.transport
            weight = transport.weight / measure(task.resolution, True)[transport.texel.long()]
            data = dataclasses.replace(data, transport=dataclasses.replace(transport, weight=weight))
        sigma = wavelet_scale(data.transport, data.gbuffer)
        if self.finest_pixels is not None:
            width = self.finest_pixels * data.pixel_size
            self.grid_settings["scale"] = level_growth(self.grid_settings, data.bounds, width)
        if self.features == "vertices":
            self.longest_edge = self.vertices["edge_pixels"] * data.pixel_size
        self.build(data.bounds, task.resolution, sigma, device, task.scene)
        net, by_transport = self.net, self.selection == "transport"
        lightings = task.train_lightings() * self.measure
        training = WaveletTraining(net, data, lightings, sigma, by_transport, settings, generator, device)
        parameters = {
            "grid": [*net.grid.parameters(), *net.directions.parameters()],
            "wavelet": net.texture.parameters(),
            "mlp": [net.feature, *net.mlp.parameters()],
        }
        groups = [
            {"params": part, "lr": settings["rates"][name], "weight_decay": settings["decay"][name]}
            for name, part in parameters.items()
        ]
        optimiser = torch.optim.AdamW(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)
        fit_network(log, "wavelet_neural", net, settings, generator, training.loss, optimiser)
        if settings["gain_points"]:
            gain = wavelet_gain(net, data, settings["gain_points"], generator, training.precision).to(device)
            net.scale = net.scale * gain  # not in place: it may be the same tensor as sigma
            self.sigma = self.sigma * gain
        self.mirrors.use(getattr(task, "scene", None))

    # ---- rendering

    @torch.no_grad()
    def light(self, lighting: Float[Tensor, "6 R R 3"], steady: SteadySelection | None = None) -> WaveletCode:
        """Wavelet transform, selection of K, folding of the first layer (Algorithm 1, lines 2 and 3).

        ``steady``: of a light that moves, the selection that goes on from the frame before.
        """
        check_lighting(lighting, self.resolution)
        if steady is None:
            values, index = self.select(lighting)
            kept = values[index]
        else:
            values = self.transformed(lighting)
            index, level = (part.to(values.device) for part in steady.next(self.rank(values)))
            kept = values[index] * level[:, None]
        code = encode(self.form, self.net, index, kept, self.precision)
        return self.mirrors.coded(code, lighting)

    @property
    def form(self) -> Form:
        """What shades on this device."""
        return form_of(self.kernel, self.device)

    def select(self, lighting: Float[Tensor, "6 R R 3"]) -> tuple[Float[Tensor, "T 3"], Int[Tensor, "K"]]:
        """All coefficients of a lighting, and which of them are kept."""
        values = self.transformed(lighting)
        return values, haar.top_k(values, min(self.wavelets, len(values)), self.selection, self.sigma)

    def transformed(self, lighting: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "T 3"]:
        """All wavelet coefficients of a lighting."""
        flat = lighting.reshape(-1, 3) * self.measure.to(lighting.device)
        return haar.forward(flat.to(self.device))

    def rank(self, values: Float[Tensor, "T 3"]) -> Float[Tensor, "T"]:
        """What coefficients are selected by."""
        return haar.importance(values, self.selection, self.sigma)

    @property
    def traces_lighting(self) -> bool:
        """Whether rays meet the whole lighting, not only the wavelets of it that are kept."""
        return self.mirrors.on

    def truncated(self, lighting: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "6 R R 3"]:
        """The lighting that :meth:`light` keeps, for the error split."""
        values, index = self.select(lighting)
        kept = haar.inverse(haar.keep_only(values, index)).to(lighting.device)
        return (kept / self.measure.to(kept)).view(lighting.shape)

    @torch.no_grad()
    def shade(self, gbuffer: GBuffer, code: WaveletCode, v: Tensor | None = None) -> Float[Tensor, "N 3"]:
        """Indirect radiance (Algorithm 1, lines 4 to 9), at mirrors by secondary rays where they are on."""
        values = self.predicted(gbuffer, code)
        return self.mirrors.mended(values, gbuffer, code, lambda points: self.predicted(points, code))

    def predicted(self, gbuffer: GBuffer, code: WaveletCode) -> Float[Tensor, "N 3"]:
        """The network's own indirect radiance, on the CPU."""
        return self.radiance(gbuffer, code).cpu()

    @torch.no_grad()
    def radiance(self, gbuffer: GBuffer, code: WaveletCode) -> Float[Tensor, "N 3"]:
        """The same where the network is."""
        return shade_as(self.form, self.net, gbuffer.to(self.device), code, self.folded, self.chunk)

    def timed_parts(self, lighting: Float[Tensor, "6 R R 3"], gbuffer: GBuffer) -> dict[str, Any]:
        """Secondary rays, and the network at all points, where such rays are on."""
        code = self.light(lighting)
        return self.mirrors.timed_parts(gbuffer, code, lambda points: self.predicted(points, code))

    # ---- storage

    def nbytes(self) -> int:
        """Grid or vertices, W, U and f; sigma is needed for selection and is counted.

        The meshes are the scene's and are not counted.
        """
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
                "longest_edge": json.dumps(self.longest_edge),
            },
        )

    def load(self, path: Path, task: Any, device: str) -> None:
        with safe_open(path, "pt") as file:
            stored = file.metadata()
        resolution, bounds = int(stored["resolution"]), json.loads(stored["bounds"])
        if "scale" in stored:  # models stored before finest_pixels have the configured one
            self.grid_settings["scale"] = json.loads(stored["scale"])
        self.longest_edge = json.loads(stored.get("longest_edge", "null"))
        if (self.longest_edge is None) != (self.features == "hashgrid"):
            right = FEATURES[self.longest_edge is not None]
            raise PrtError(f"the model has method.features={right}, not {self.features}; set it so")
        state = load_file(path)
        self.build(bounds, resolution, state.pop("sigma"), device, getattr(task, "scene", None))
        mine, stored_rows = len(self.net.grid.table), len(state["grid.table"])
        if mine != stored_rows:
            raise PrtError(
                f"the model has {stored_rows} rows of features, this scene {mine}; "
                "set scene and method.grid to what the model was fitted to"
            )
        self.net.load_state_dict(state)
        self.mirrors.use(getattr(task, "scene", None))


def check_vertices(settings: dict[str, Any]) -> None:
    """Refuse settings of ``method.vertices`` out of range.

    Raises:
        PrtError: naming the setting, its value and what is allowed.
    """
    edge, most = settings.get("edge_pixels"), settings.get("most")
    if isinstance(edge, bool) or not isinstance(edge, int | float) or not edge > 0:
        raise PrtError(f"method.vertices.edge_pixels={edge!r} must be a number above 0; 2 is a good start")
    if isinstance(most, bool) or not isinstance(most, int) or most < 1:
        raise PrtError(f"method.vertices.most={most!r} must be a whole number of at least 1")


def level_growth(grid: dict[str, Any], bounds: tuple[list[float], list[float]], width: float) -> float:
    """Growth per level with which the finest cells of a hash grid are ``width`` wide (world units).

    Never below 1: where even the coarsest cells are narrower, all levels are as coarse as the coarsest.
    """
    extent = max(high - low for low, high in zip(*bounds, strict=True))
    ratio = extent / (width * grid["base_resolution"])
    return max(1.0, ratio) ** (1 / max(1, grid["levels"] - 1))


def measure(resolution: int, solid_angle: bool) -> Float[Tensor, "T 1"]:
    """What lightings are multiplied by, and transport divided by, before the wavelet transform, mean 1."""
    angles = texel_solid_angles(resolution).reshape(-1, 1)
    return angles / angles.mean() if solid_angle else torch.ones_like(angles)

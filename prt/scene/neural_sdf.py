"""A signed distance that a small network has learnt from a mesh (after Davies et al. 2021).

"On the Effectiveness of Weight-Encoded Neural Implicit 3D Shapes" overfits one multilayer perceptron to one
mesh. Dhawal 2022, section 5.2, renders a bunny of that kind with 2 layers of 32 or 64 neurons. At these sizes
(leaky) ReLU leaves a faceted surface, its normals 20 to 50 degrees off; the sine of Sitzmann et al. 2020
is smooth and as cheap in a shader, so it is what is used here.
"""

import dataclasses
import functools
import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.cache import cached
from prt.errors import PrtError
from prt.paths import data_file
from prt.progress import track
from prt.scene.closing import capped, mesh_data
from prt.scene.mesh_distance import MeshDistance
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import file_digest
from prt.scene.shapes import MeshData
from prt.scene.standing_mesh import standing_mesh

Weights = list[tuple[Float[Tensor, "o i"], Float[Tensor, "o"]]]
Corner = tuple[float, float, float]

#: of the code that makes points and of the code that trains
VERSION = 1
#: the mesh's longest side, and how far the box goes beyond the mesh
SIZE, MARGIN = 1.8, 0.1
#: points on the mesh that training draws from; half as many near, about and far from it each
POINTS = 160_000
#: standard deviations of the points near and about the mesh
SPREAD = (0.01, 0.06)
#: an error of the distance counts in proportion to 1 / (NEAR + distance), one of the gradient this much
NEAR, GRADIENT = 0.02, 0.2
#: positions at a time, where nothing has to be kept: thrice as fast as 2^18, whose layers leave the cache
CPU_CHUNK = 1 << 11
#: what the largest gradient found is raised by, for what was not found
SAFETY = 1.05


class NeuralSdf:
    """A network from position to signed distance, scaled so that its gradient is nowhere longer than 1.

    With the ``(W, b)`` of :meth:`layers`, all of it is, in any language::

        h = p                       # world position, 3 numbers
        h = sin(W h + b)            # for each layer but the last; W is (outputs, inputs), row-major
        d = W h + b                 # the last layer, 1 number

    Nothing else is to be multiplied: the scale :attr:`step` is in the last layer's ``W`` and ``b``.

    Args:
        weights: of the network as it was trained, float32.
        bounds: corners of the box it holds in; outside it the values mean nothing.
        step: 1 over the largest length of the trained network's gradient, at most 1. The network is no exact
            distance; what it gives is multiplied by this, so sphere tracing never steps through the surface
            and takes about ``1 / step`` times the steps of an exact distance.
        settings: plain JSON that determines the weights.

    Attributes:
        activation, parameter, octaves: the formula in the words of :mod:`prt.methods.network_glsl`.
    """

    activation, parameter, octaves = "sine", 1.0, 0

    def __init__(
        self, weights: Weights, bounds: tuple[Corner, Corner], step: float, settings: dict[str, Any]
    ):
        self.bounds, self.step, self.settings = bounds, step, settings
        (last, offset) = weights[-1]
        self._layers = [*weights[:-1], (last * step, offset * step)]
        self._on: dict[torch.device, Weights] = {torch.device("cpu"): self._layers}

    def layers(self) -> Weights:
        """Weights (outputs, inputs) and biases from input to output, on the CPU; :attr:`step` is within."""
        return self._layers

    def distance(self, position: Float[Tensor, "N 3"]) -> Float[Tensor, "N"]:
        """Signed distance times :attr:`step`, negative inside; on the device of ``position``."""
        if position.device not in self._on:
            self._on[position.device] = [
                (w.to(position.device), b.to(position.device)) for w, b in self._layers
            ]
        weights = self._on[position.device]
        if position.device.type != "cpu" or (torch.is_grad_enabled() and position.requires_grad):
            return _value(weights, position)
        return torch.cat([_value(weights, part) for part in position.split(CPU_CHUNK)])

    def fingerprint(self) -> dict[str, Any]:
        """Plain JSON: all that determines the weights."""
        return self.settings


def _value(weights: Weights, position: Float[Tensor, "N 3"]) -> Float[Tensor, "N"]:
    h = position
    *hidden, (weight, bias) = weights
    for w, b in hidden:
        h = torch.addmm(b, h, w.T).sin_()
    return torch.addmm(bias, h, weight.T)[:, 0]


def with_gradient(
    weights: Weights, position: Float[Tensor, "N 3"]
) -> tuple[Float[Tensor, "N"], Float[Tensor, "N 3"]]:
    """The network's value and its gradient by position, carried forward side by side.

    Cheaper to train on than the gradient of a gradient, as three inputs are few.
    """
    h, slope = position, None
    for number, (weight, bias) in enumerate(weights):
        z = torch.addmm(bias, h, weight.T)
        # by x, y, z: (3, N, outputs)
        slope = weight.T[:, None].expand(3, len(position), -1) if slope is None else slope @ weight.T
        if number < len(weights) - 1:
            h, slope = z.sin(), slope * z.cos()
    return z[:, 0], slope[:, :, 0].T  # type: ignore[index]


@dataclasses.dataclass(frozen=True)
class Fit:
    """How a network is trained.

    Attributes:
        neurons, layers: of each hidden layer; hidden layers.
        frequency: the first layer's weights lie within this at the start, radians a unit of length. Greater
            is finer, and steeper between the training points.
        iterations, batch, rate: of Adam; the rate rises, then falls to nothing (one cycle).
        seed: of weights and batches.
    """

    neurons: int = 32
    layers: int = 2
    frequency: float = 8.0
    iterations: int = 20_000
    batch: int = 1024
    rate: float = 0.01
    seed: int = 0

    def __post_init__(self):
        ranges = {"neurons": (4, 1024), "layers": (1, 16), "iterations": (1, 10**7), "batch": (1, 10**6)}
        for name, (least, most) in ranges.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
                raise PrtError(f"scene.sdf_{name}={value!r} must be an integer from {least} to {most}")
        if not 0 < self.rate < 1:
            raise PrtError(f"scene.rate={self.rate!r} must lie between 0 and 1 (Adam's learning rate)")
        if not 0 < self.frequency < 1000:
            raise PrtError(f"scene.frequency={self.frequency!r} must lie between 0 and 1000 (radians a unit)")


def train(
    position: Float[Tensor, "N 3"],
    distance: Float[Tensor, "N"],
    gradient: Float[Tensor, "N 3"],
    fit: Fit,
    label: str = "",
) -> Weights:
    """Weights of a network with these distances and gradients (Czarnecki et al. 2017, Sobolev training).

    On one thread: the products are too small to share out, and threads that wait for each other on a busy
    machine took twenty times as long.

    Args:
        label: of the progress bar; none without.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return _train(position, distance, gradient, fit, label)
    finally:
        torch.set_num_threads(threads)


def _train(position: Tensor, distance: Tensor, gradient: Tensor, fit: Fit, label: str) -> Weights:
    generator = torch.Generator().manual_seed(fit.seed)

    def uniform(limit: float, *shape: int) -> Tensor:
        return (limit * (2 * torch.rand(shape, generator=generator) - 1)).requires_grad_()

    sizes = [3, *[fit.neurons] * fit.layers, 1]
    weights = []
    for number, (before, after) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        limit = fit.frequency if number == 0 else math.sqrt(6 / before)  # Sitzmann 2020, section 3.2
        last = number == fit.layers
        weights.append((uniform(limit, after, before), uniform(0.0 if last else math.pi, after)))
    parameters = [part for layer in weights for part in layer]
    optimiser = torch.optim.Adam(parameters, lr=fit.rate, betas=(0.9, 0.99))
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, fit.rate, total_steps=fit.iterations + 1, pct_start=0.1
    )
    numbers = range(fit.iterations)
    for _ in track(numbers, label, fit.iterations) if label else numbers:
        rows = torch.randint(len(position), (fit.batch,), generator=generator)
        value, slope = with_gradient(weights, position[rows])
        true = distance[rows]
        off = (value - true).abs() / (NEAR + true.abs())
        askew = ((slope - gradient[rows]).square().sum(1) + 1e-6).sqrt()
        loss = off.mean() + GRADIENT * askew.mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return [(weight.detach(), bias.detach()) for weight, bias in weights]


def steepest(weights: Weights, bounds: tuple[Corner, Corner], count: int = 1 << 18) -> float:
    """The greatest length of the network's gradient in a box: of random points, the best of which climb.

    A lower bound of the true one, hence :data:`SAFETY`. (The product of the layers' norms is an upper one,
    but many times too high to step by.)
    """
    generator = torch.Generator().manual_seed(0)
    low, high = (torch.tensor(corner) for corner in bounds)
    place = low + (high - low) * torch.rand((count, 3), generator=generator)
    with torch.no_grad():
        length = torch.cat([with_gradient(weights, part)[1].norm(dim=1) for part in place.split(1 << 14)])
    best = place[length.topk(min(256, count)).indices].clone().requires_grad_()
    found = float(length.max())
    climb = torch.optim.Adam([best], lr=2e-3)
    for _ in range(60):
        slope = with_gradient(weights, best)[1].norm(dim=1)
        found = max(found, float(slope.detach().max()))
        climb.zero_grad()
        (-slope.sum()).backward()
        climb.step()
        with torch.no_grad():
            best.copy_(torch.minimum(torch.maximum(best, low), high))
    return found


def training_points(
    mesh: MeshDistance, bounds: tuple[Corner, Corner], count: int = POINTS, seed: int = 0
) -> tuple[Float[Tensor, "M 3"], Float[Tensor, "M"], Float[Tensor, "M 3"]]:
    """Positions, true signed distances and their gradients.

    ``count`` on the mesh, half as many near it, about it (:data:`SPREAD`), and anywhere in the box.
    """
    generator = torch.Generator().manual_seed(seed)
    on, face = mesh.sample(count, generator)
    half = count // 2
    low, high = (torch.tensor(corner, dtype=torch.float64) for corner in bounds)
    # the samples are in the order of faces: shuffled, so that each half is all over the mesh
    order = torch.randperm(count, generator=generator)
    off = [
        on[order[k * half : (k + 1) * half]]
        + spread * torch.randn((half, 3), generator=generator, dtype=torch.float64)
        for k, spread in enumerate(SPREAD)
    ]
    off = [part.clamp(low, high) for part in off]
    off.append(low + (high - low) * torch.rand((half, 3), generator=generator, dtype=torch.float64))
    away = torch.cat(off)
    distance, gradient = mesh(away)
    return (
        torch.cat([on, away]).float(),
        torch.cat([torch.zeros(count), distance.float()]),
        torch.cat([mesh.normal[face], gradient]).float(),
    )


def box_of(mesh: MeshData) -> tuple[Corner, Corner]:
    """The mesh's box and :data:`MARGIN` around it."""
    low, high = mesh.position.min(0) - MARGIN, mesh.position.max(0) + MARGIN
    corners = [(float(x), float(y), float(z)) for x, y, z in (low, high)]
    return corners[0], corners[1]


def fitted(mesh: MeshData, settings: dict[str, Any], fit: Fit, points: int = POINTS) -> NeuralSdf:
    """A network trained on a mesh that encloses a volume; points and weights are kept in the cache.

    Args:
        mesh: within about a unit of the origin.
        settings: plain JSON that determines ``mesh``.
        points: on the mesh, as in :func:`training_points`.

    Raises:
        PrtError: if the cache cannot be written.
    """
    bounds = box_of(mesh)

    def make_points() -> dict[str, Tensor]:
        names = ("position", "distance", "gradient")
        return dict(zip(names, training_points(MeshDistance(mesh), bounds, points), strict=True))

    def make_weights() -> dict[str, Tensor]:
        made = cached("neural_sdf_points", VERSION, {**settings, "points": points}, make_points)
        label = f"neural SDF {fit.neurons} x {fit.layers}"
        weights = train(made["position"], made["distance"], made["gradient"], fit, label)
        step = min(1.0, 1.0 / (SAFETY * steepest(weights, bounds)))
        named = {
            f"{what}{k}": v for k, pair in enumerate(weights) for what, v in zip("wb", pair, strict=True)
        }
        return {**named, "step": torch.tensor([step])}

    everything = {**settings, "points": points, "fit": dataclasses.asdict(fit)}
    found = cached("neural_sdf", VERSION, everything, make_weights)
    weights = [(found[f"w{k}"], found[f"b{k}"]) for k in range(fit.layers + 1)]
    everything["neural_sdf"] = VERSION
    return NeuralSdf(weights, bounds, float(found["step"]), everything)


@functools.cache
def bunny_mesh() -> MeshData:
    """The Stanford bunny with lids on its holes, centred at the origin, its longest side :data:`SIZE`.

    Raises:
        PrtError: if ``meshes/bunny.ply`` is missing, or no such mesh.
    """
    path = data_file("meshes/bunny.ply")
    shape = mitsuba().load_dict(standing_mesh(path, 1.0, (0.0, 0.0), 0.0, {"type": "diffuse"}))
    mesh = capped(mesh_data(shape), f"mesh {path}")
    low, high = mesh.position.min(0), mesh.position.max(0)
    scaled = (mesh.position - (low + high) / 2) * (SIZE / np.max(high - low))
    return dataclasses.replace(mesh, position=scaled)


def neural_bunny(neurons: int = 32, layers: int = 2, **fit: Any) -> NeuralSdf:
    """The Stanford bunny as a network, trained when it is first asked for.

    Args:
        neurons, layers: of each hidden layer; hidden layers. Dhawal 2022 has 32 or 64, and 2.
        fit: further fields of :class:`Fit`.

    Raises:
        PrtError: for settings out of range; without the mesh.
    """
    fit_settings = Fit(neurons, layers, **fit)
    digest = file_digest(data_file("meshes/bunny.ply"))
    return fitted(bunny_mesh(), {"mesh": digest, "size": SIZE, "margin": MARGIN}, fit_settings)


def surface_error(
    network: NeuralSdf, mesh: MeshDistance, count: int = 50_000, seed: int = 1
) -> dict[str, float]:
    """How far the network is from its mesh, by evenly spread points of the mesh.

    Returns:
        ``distance`` and ``distance_99``, mean and 99th percentile of the absolute distance that the network
        finds there, in world units, :attr:`NeuralSdf.step` taken out; ``degrees``, the mean angle between
        its gradient and the face normals.
    """
    position, face = mesh.sample(count, torch.Generator().manual_seed(seed))
    value, slope = with_gradient(network.layers(), position.float())
    cosine = (torch.nn.functional.normalize(slope, dim=1) * mesh.normal[face].float()).sum(1).clamp(-1, 1)
    off = value.abs() / network.step
    return {
        "distance": float(off.mean()),
        "distance_99": float(off.quantile(0.99)),
        "degrees": float(cosine.acos().mean().rad2deg()),
    }

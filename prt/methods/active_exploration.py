"""Active exploration (Diolatzis et al. 2022): a network that makes pixels from surface points and the state,
fitted to path-traced images whose states are chosen by a Markov chain toward where it is wrong.

As in the comparison of Su 2024 (section 6.1), specular surfaces are followed by rays. What that paper leaves
open of its rival is decided here: an image is traced at every state that the chain proposes and all are kept,
so that equal time means equal effort; the chain decides where it goes from there.
"""

import dataclasses
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import FitLog
from prt.methods.radiance_field import RadianceField, pixel_rays
from prt.methods.state_chain import StateChain
from prt.methods.training import Average, fit_loop, warm_up_then_cosine
from prt.nn.pixel_generator import LARGEST, PixelGenerator
from prt.nn.radiance_network import RadiancePoints
from prt.progress import track
from prt.scene.gbuffer import GBuffer
from prt.trace.radiance_rays import Answers, follow

#: seeds of training images, apart from those of references
FIRST_SEED = 5_000_000
#: radiance as low as this, over the network's scale, may be found in training: its logarithm is still finite
LEAST = -0.9


@dataclasses.dataclass
class Example:
    """One training image: its state, what its rays met, and its path-traced pixels."""

    v: Float[Tensor, "n"]
    answers: Answers
    target: Float[Tensor, "P 3"]


class ActiveExploration(RadianceField):
    """The method; settings as in ``conf/method/active_exploration.yaml``.

    Args:
        width, hidden_layers, position_frequencies: of the pixel generator.
        training: steps, images (in all), size (pixels a side), spp, batch (images a step), rate, average,
            small_step and large_steps (of the chain), uniform (true: no chain, uniform states).
        pixel_samples, fxaa, right_hand: as in :class:`~prt.methods.radiance_field.RadianceField`.
    """

    net: PixelGenerator

    def __init__(
        self,
        width: int,
        hidden_layers: int,
        position_frequencies: int,
        training: dict[str, Any],
        pixel_samples: int = 1,
        fxaa: bool = True,
        right_hand: int = 0,
    ):
        super().__init__(pixel_samples, fxaa, right_hand)
        for name in ("steps", "images", "size", "spp", "batch"):
            if not isinstance(training[name], int) or training[name] < 1:
                raise PrtError(f"method.training.{name}={training[name]!r} must be an integer of at least 1")
        self.sizes = {
            "width": width, "hidden_layers": hidden_layers, "position_frequencies": position_frequencies,
        }  # fmt: skip
        self.training = training

    def build(self, task: Any, device: str) -> None:
        self.stage = task.stage
        self.net = PixelGenerator(task.bounds, task.dimension, **self.sizes).to(device)
        self.device = device

    def at(self, v: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        return v

    def values(self, points: RadiancePoints, state: Float[Tensor, "n"]) -> Float[Tensor, "N 3"]:
        return self.net(surface(points), state)

    # ---- fitting

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Alternate between tracing an image where the chain goes and steps on all images so far."""
        torch.manual_seed(seed)
        self.build(task, device)
        settings = self.training
        generator = torch.Generator().manual_seed(seed)
        explorer = Explorer(self, task, generator)
        average = Average(self.net, settings["average"]) if settings["average"] else None
        optimiser = torch.optim.Adam(self.net.parameters(), lr=settings["rate"], fused=True)
        modules = {"net": self.net, "explorer": explorer}
        fit_loop(
            log, "active_exploration", settings["steps"], generator, modules, explorer.loss, optimiser,
            warm_up_then_cosine(), average,
        )  # fmt: skip


def surface(points: RadiancePoints) -> GBuffer:
    """Points as the pixel generator knows them; what is specular was followed by rays."""
    count = len(points)
    none = torch.zeros((count, 3), device=points.position.device)
    return GBuffer(
        points.position, points.normal, points.wo, points.reflected, points.albedo, none,
        torch.ones_like(none[:, :1]), none[:, :2], torch.ones(count, dtype=torch.bool),
    )  # fmt: skip


class Explorer:
    """The images so far and the chain that adds to them; part of what a checkpoint keeps."""

    def __init__(self, method: ActiveExploration, task: Any, generator: torch.Generator):
        self.method, self.task, self.generator = method, task, generator
        settings = method.training
        self.chain = StateChain(
            task.dimension + 1, generator, settings["small_step"], settings["large_steps"]
        )
        self.views = task.training_views(64, settings["size"])
        self.places: list[list[float]] = []
        self.examples: list[Example] = []
        self.step = 0
        #: number of the image where the chain is
        self.at = 0

    # resumed by tracing the same images again: their states and seeds say all

    def state_dict(self) -> dict[str, Any]:
        places = torch.tensor(self.places).reshape(len(self.places), self.task.dimension + 1)
        return {"step": self.step, "places": places, "at": self.at, "chain": self.chain.state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.step, self.at = int(state["step"]), int(state["at"])
        self.chain.restore(state["chain"])
        self.places = state["places"].tolist()
        self.examples = [
            self._traced(torch.tensor(u), number)
            for number, u in enumerate(track(self.places, "training images", len(self.places)))
        ]

    def loss(self) -> Tensor:
        self.step += 1
        settings = self.method.training
        due = 1 + (settings["images"] - 1) * (self.step - 1) // settings["steps"]
        while len(self.examples) < due:
            self._explore()
        which = torch.randint(len(self.examples), (settings["batch"],), generator=self.generator)
        # the newest image takes part in every step until the next one comes
        which[0] = len(self.examples) - 1
        return torch.stack([self._error(self.examples[int(i)]).mean() for i in which]).mean()

    def _explore(self) -> None:
        settings = self.method.training
        if settings["uniform"]:
            u = torch.rand(self.task.dimension + 1, generator=self.generator)
        else:
            if self.examples:  # it has been trained on since
                with torch.no_grad():
                    self.chain.refresh(float(self._error(self.examples[self.at]).mean()))
            u = self.chain.propose()
        example = self._traced(u, len(self.examples))
        if not self.examples:  # the logarithm bends where the scene's light is, or dark rooms would not count
            self.method.net.scale.fill_(max(float(example.target.median()), 1e-6))
        self.examples.append(example)
        self.places.append(u.tolist())
        if not settings["uniform"]:
            with torch.no_grad():
                if self.chain.accept(u, float(self._error(example).mean())):
                    self.at = len(self.examples) - 1

    @torch.no_grad()
    def _traced(self, u: Float[Tensor, "m"], number: int) -> Example:
        settings = self.method.training
        v, view = u[:-1], self.views[min(int(u[-1] * len(self.views)), len(self.views) - 1)]
        target = self.task.render(v, view, settings["spp"], FIRST_SEED + number)
        count = view.width * view.height
        answers = follow(self.method.stage.mi_scene, pixel_rays(view, 1), count, number)
        return Example(v, answers, target.reshape(-1, 3))

    def _error(self, example: Example) -> Float[Tensor, "P 3"]:
        """Squared difference in log(1 + radiance): lamps and highlights would drown all else."""
        net, device = self.method.net, self.method.device
        answers = example.answers.to(device)
        # not cut off at 0, as the network's own radiance is: there would be no way back from below
        log_values = net.log_radiance(surface(answers.points), example.v.to(device)).clamp(max=LARGEST)
        image = answers.total(torch.expm1(log_values) * net.scale)
        found = torch.log1p((image / net.scale).clamp(min=LEAST))
        return (found - net.compressed(example.target.to(device))).square()

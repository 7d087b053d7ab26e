"""Dynamic neural radiosity (Su et al. 2024): a network that solves the rendering equation for all states.

Trained without images: on random surface points in random states, what the network says of a point (the
left-hand side) has to equal what the rendering equation makes of what the network says of the surfaces around
it (the right-hand side). The encodings that it is compared with (K-planes, a 4D hash grid, the state as mere
input, no state at all) are settings of the same method: all else is equal then.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import FitLog
from prt.methods.radiance_field import CHUNK, RadianceField
from prt.methods.training import Average, fit_loop
from prt.nn.hashgrid import HashGrid
from prt.nn.hashgrid_4d import HashGrid4d
from prt.nn.kplanes import KPlanes
from prt.nn.radiance_network import RadianceNetwork, RadiancePoints, StateCode
from prt.nn.scene_planes import PlainState, ScenePlanes, StateNetwork
from prt.scene.capture import rows_of
from prt.scene.gbuffer import GBuffer
from prt.trace.radiance_rays import reflectance, right_hand_side
from prt.trace.surface_states import SurfaceStates

ENCODINGS = ("decomposed", "conditioned", "kplanes", "hashgrid_4d", "static")
LOSSES = ("plain", "relative")
#: radiance this many times what the scene's own lights reflect once: no scene has it, the fit runs away
DIVERGED = 1e3
#: share of the steps in which rates grow from nearly nothing: the first errors are far larger than later ones
WARM_UP = 0.02
#: points whose mean light counts as one sample of the scene's usual brightness
GROUP = 64
#: parts of the fit after each of which the right-hand side gets twice the directions (section 4.3)
FIFTHS = 5


class Grid(torch.nn.Module):
    """f_X, a 3D grid at several resolutions that knows nothing of the state (equation 4)."""

    def __init__(self, settings: dict[str, Any], bounds, generator: torch.Generator):
        super().__init__()
        self.grid = HashGrid(**settings, bounds=bounds, generator=generator)
        self.outputs = self.grid.out_features

    def forward(self, position: Float[Tensor, "N 3"]) -> Float[Tensor, "N C"]:
        return self.grid(position)


class DynamicRadiosity(RadianceField):
    """The method; settings as in ``conf/method/dynamic_radiosity.yaml``.

    Args:
        encoding: ``decomposed`` (f_X, f_XV and f_V), ``conditioned`` (f_X, and v as an input), ``kplanes``,
            ``hashgrid_4d`` (one variable), or ``static``: f_X, fitted to the one state ``static_state``.
        grid: of f_X; levels, features, log2_table, base_resolution, scale.
        planes: of f_XV, and of kplanes; levels (0 for none), features, base_resolution, scale.
        state: of f_V; width, hidden_layers, octaves. Width 0 for none.
        direction_degree, normal_degree, albedo_bins, width, hidden_layers: of the network.
        training: steps, batch, samples, per_state, adaptive, loss, detach, epsilon, rate, grid_rate, decay,
            average, sampling, emitters.
        static_state: of ``static``, one value a variable; null for 0.5 each.
        demodulate: whether a part of the output is multiplied by the albedo (ours; see
            :class:`~prt.nn.radiance_network.RadianceNetwork`).
        ignored: names of variables that the network is not told, for they change nothing (``prt needs`` finds
            them): no planes, no input.
        pixel_samples, fxaa, right_hand: as in :class:`~prt.methods.radiance_field.RadianceField`.

    Raises:
        PrtError: for a setting out of range.
    """

    net: RadianceNetwork
    rendering = frozenset({"pixel_samples", "fxaa", "right_hand"})

    def __init__(
        self,
        grid: dict[str, Any],
        planes: dict[str, Any],
        state: dict[str, Any],
        direction_degree: int,
        normal_degree: int,
        albedo_bins: int,
        width: int,
        hidden_layers: int,
        training: dict[str, Any],
        encoding: str = "decomposed",
        pixel_samples: int = 1,
        fxaa: bool = True,
        right_hand: int = 0,
        static_state: list[float] | None = None,
        demodulate: bool = True,
        ignored: Sequence[str] = (),
    ):
        super().__init__(pixel_samples, fxaa, right_hand)
        if encoding not in ENCODINGS:
            raise PrtError(f"method.encoding={encoding!r} is not one of {', '.join(ENCODINGS)}")
        if training["loss"] not in LOSSES:
            raise PrtError(f"method.training.loss={training['loss']!r} is not one of {', '.join(LOSSES)}")
        for name in ("steps", "batch", "samples", "per_state"):
            if not isinstance(training[name], int) or training[name] < 1:
                raise PrtError(f"method.training.{name}={training[name]!r} must be an integer of at least 1")
        self.encoding, self.grid, self.planes, self.state = encoding, grid, planes, state
        self.sizes = {
            "direction_degree": direction_degree, "normal_degree": normal_degree, "albedo_bins": albedo_bins,
            "width": width, "hidden_layers": hidden_layers, "demodulate": bool(demodulate),
        }  # fmt: skip
        self.training, self.static_state, self.ignored = training, static_state, list(ignored)

    # ---- the network

    def build(self, task: Any, device: str, seed: int = 0) -> None:
        self.stage = task.stage
        self.net = self.network(task.bounds, task.dimension, seed, self.seen(task)).to(device)
        self.device = device

    def seen(self, task: Any) -> list[int] | None:
        """Numbers of the variables that are not ignored; None for all.

        Raises:
            PrtError: for a name that the scene's animation has not.
        """
        if not self.ignored:
            return None
        names = list(task.stage.animation.names)
        for name in self.ignored:
            if name not in names:
                raise PrtError(
                    f"method.ignored: the scene has no variable {name!r}; it has {', '.join(names) or 'none'}"
                )
        return [number for number, name in enumerate(names) if name not in self.ignored]

    def network(
        self, bounds, dimension: int, seed: int = 0, seen: list[int] | None = None
    ) -> RadianceNetwork:
        """The untrained network of a box and a number of variables, of which it may be told some.

        Raises:
            PrtError: for sizes out of range, or an encoding that cannot do that many variables.
        """
        generator = torch.Generator().manual_seed(seed)
        dimension = dimension if seen is None else len(seen)
        settings = {"bounds": bounds, "generator": generator}
        encodings: list[torch.nn.Module] = []
        if self.encoding == "hashgrid_4d":
            encodings.append(HashGrid4d(dimension, **self.grid, **settings))
        elif self.encoding != "kplanes":
            encodings.append(Grid(self.grid, **settings))
        state = None
        if dimension and self.encoding == "kplanes":
            encodings.append(KPlanes(dimension, **self.planes, **settings))
        elif dimension and self.encoding == "decomposed":
            if self.planes["levels"]:
                encodings.append(ScenePlanes(dimension, **self.planes, **settings))
            if self.state["width"]:
                state = StateNetwork(dimension, **self.state, generator=generator)
        elif dimension and self.encoding == "conditioned":
            state = PlainState(dimension)
        return RadianceNetwork(encodings, state, **self.sizes, generator=generator, seen=seen)

    def at(self, v: Float[Tensor, "n"]) -> StateCode:
        return self.net.at(v)

    def values(self, points: RadiancePoints, state: StateCode) -> Float[Tensor, "N 3"]:
        return self.net(points, state)

    def timed_parts(self, lighting: Tensor, gbuffer: GBuffer) -> dict[str, Callable[[], Any]]:
        """As every field's; of the network also features of the place, state, and decoder (table 1)."""
        found = super().timed_parts(lighting, gbuffer)
        if not found:
            return found
        code = self.light(lighting)
        with torch.no_grad():
            points = self.trace(gbuffer.view).points.to(self.device)
            places = [points.position[k : k + CHUNK] for k in range(0, len(points), CHUNK)]
            features = self.net.features(points, code.state)

        @torch.no_grad()
        def features_of_places() -> None:
            parts = self.net.lines(code.v.to(self.device))
            for place in places:
                self.net.places(place, parts)

        @torch.no_grad()
        def decode() -> None:
            for start in range(0, len(features), CHUNK):
                part = slice(start, start + CHUNK)
                self.net.decode(features[part], code.state, points.albedo[part])

        return {
            **found,
            "features": features_of_places,
            "variables": torch.no_grad()(lambda: self.net.bias(code.v.to(self.device))),
            "decoder": decode,
        }

    def sized_parts(self) -> dict[str, int]:
        """Bytes of the features of the place (f_X, f_XV), of f_V, and of the decoder (table 1)."""

        def size(module: torch.nn.Module | None) -> int:
            return sum(p.numel() * p.element_size() for p in module.parameters()) if module else 0

        return {
            "features": size(self.net.encodings), "variables": size(self.net.state),
            "decoder": size(self.net.decoder),
        }  # fmt: skip

    # ---- fitting

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Minimise the residual of the rendering equation over states, points and directions.

        Raises:
            PrtError: where the radiance grows without bound; the last checkpoint is kept.
        """
        torch.manual_seed(seed)
        self.build(task, device, seed)
        settings, net = self.training, self.net
        generator = torch.Generator().manual_seed(seed)
        surface = SurfaceStates(self.stage.mi_scene, task.walk_views())
        residual = Residual(self, surface, task.dimension, generator)
        net.scale.fill_(residual.scale())
        optimiser = self.optimiser()
        average = Average(net, settings["average"]) if settings["average"] else None
        fit_loop(
            log, "dynamic_radiosity", settings["steps"], generator, {"net": net, "residual": residual},
            residual.loss, optimiser,
            lambda progress: min(1.0, (progress + 1e-3) / WARM_UP) * settings["decay"] ** int(3 * progress),
            average,
        )  # fmt: skip

    def optimiser(self, factor: float = 1.0) -> torch.optim.Optimizer:
        """Adam with a rate for grids and planes and one for the rest, both times ``factor``.

        Where planes are multiplied, all of them step at once: with the rate of a sum, a product of 325
        (K-planes of 23 variables) grows without bound. More factors than the three of space share their rate.
        """
        groups, known = [], set()
        for encoding in self.net.encodings:
            features = list(encoding.parameters())
            known |= {id(p) for p in features}
            rate = factor * self.training["grid_rate"] * min(1.0, 3 / getattr(encoding, "factors", 1))
            groups.append({"params": features, "lr": rate})
        rest = [p for p in self.net.parameters() if id(p) not in known]
        groups.append({"params": rest, "lr": factor * self.training["rate"]})
        return torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)


class Residual:
    """The loss of one step: a random state, points, directions (equations 9 to 11)."""

    def __init__(
        self, method: DynamicRadiosity, surface: SurfaceStates, dimension: int, generator: torch.Generator
    ):
        self.method, self.surface, self.dimension = method, surface, dimension
        self.generator, self.step = generator, 0
        self.v = torch.zeros(0)
        self.brightest = math.inf

    def state_dict(self) -> dict[str, Any]:
        """What a resumed fit goes on from; random numbers come from the generator."""
        return {"step": self.step, "v": self.v}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.step, self.v = int(state["step"]), state["v"].clone()

    def state(self) -> Float[Tensor, "n"]:
        """A uniform state, or the one that a static network is for."""
        if self.method.encoding == "static":
            given = self.method.static_state
            if given is not None and len(given) != self.dimension:
                raise PrtError(
                    f"method.static_state has {len(given)} values, the scene {self.dimension} variables"
                )
            return torch.tensor(given) if given else torch.full((self.dimension,), 0.5)
        return torch.rand(self.dimension, generator=self.generator)

    def seed(self) -> int:
        return int(torch.randint(1 << 31, (1,), generator=self.generator))

    def samples(self) -> int:
        """M of this step; beyond the last as there."""
        settings = self.method.training
        fifth = FIFTHS * (self.step - 1) // settings["steps"] if settings["adaptive"] else 0
        fifth = min(fifth, FIFTHS - 1)
        return settings["samples"] * 2**fifth

    def scale(self) -> float:
        """What is usually reflected straight from the scene's emitters: the median over means of 64 points.

        The mean would be that of a few places in the sun, and the median over points that of places which
        find no light in 32 directions, or nearly none: a network that begins ten times too dark is driven
        far past what is right by the first bright samples, and comes back slowly. Sets ``brightest``, the
        mean, which the watch for divergence starts from.
        """
        found = []
        generator_state = self.generator.get_state()
        for _ in range(8):
            v = self.state()
            self.method.stage.set(v)
            si, count = self.surface.sample(512, self.seed())
            found.append(
                right_hand_side(self.method.stage.mi_scene, si, count, 32, self.seed()).known.mean(1)
            )
        self.generator.set_state(generator_state)
        light = torch.cat(found)
        if not light.isfinite().all() or not (light > 0).any():
            raise PrtError(
                "no light of the scene reaches its surfaces; task=animate needs a scene with emitters"
            )
        self.brightest = float(light.mean())
        shuffled = light[torch.randperm(len(light), generator=torch.Generator().manual_seed(0))]
        usual = float(shuffled[: len(light) // GROUP * GROUP].view(-1, GROUP).mean(1).median())
        return usual if usual > 0 else self.brightest

    def loss(self) -> Tensor:
        """Of the next step."""
        self.step += 1
        method, settings = self.method, self.method.training
        net, device = method.net, method.device
        # a large room takes longer to move than to trace: such a state may serve for several steps
        if (self.step - 1) % settings["per_state"] == 0 or len(self.v) != self.dimension:
            self.v = self.state()
        v = self.v
        method.stage.set(v)
        si, count = self.surface.sample(settings["batch"], self.seed())
        left_points = points_of(si, count).to(device)
        answers = right_hand_side(
            method.stage.mi_scene, si, count, self.samples(), self.seed(), settings["sampling"],
            settings["emitters"],
        ).to(device)  # fmt: skip
        code = net.at(v.to(device))
        left = net(left_points, code)
        if settings["detach"]:
            with torch.no_grad():
                values = method.chunked(answers.points, code)
        else:
            values = net(answers.points, code)
        right = answers.total(values)
        self._watch(left)
        difference = (left - right).square()
        if settings["loss"] == "relative":
            # by the left-hand side alone: divided by what the noisy right-hand side has a part in, bright
            # samples count little, and a room whose light is found rarely is learnt as black
            own = left.detach().mean(1, keepdim=True)
            difference = difference / (own.square() + (settings["epsilon"] * net.scale) ** 2)
        else:
            difference = difference / net.scale.square()
        return difference.mean()

    @torch.no_grad()
    def _watch(self, left: Tensor) -> None:
        mean, most = float(left.mean()), DIVERGED * self.brightest
        if mean > most:
            raise PrtError(
                f"dynamic_radiosity diverged at step {self.step}: mean radiance {mean:.3g}, "
                f"{mean / self.brightest:.3g} times what the lights reflect once; the last "
                "checkpoint is kept. Lower method.training.rate, or albedos near 1"
            )


def points_of(si: Any, count: int) -> RadiancePoints:
    """Interactions as points of the network, seen from ``wi``."""
    import drjit as dr

    wo = si.to_world(si.wi)
    normal = si.sh_frame.n
    normal = dr.select(dr.dot(normal, wo) < 0, -normal, normal)
    albedo = reflectance(si, si.bsdf())
    dr.eval(wo, normal, albedo)
    one = torch.ones((count, 3))
    return RadiancePoints(
        *(rows_of(values, count) for values in (si.p, normal, wo, albedo)), one, torch.arange(count)
    )

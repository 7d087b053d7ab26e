"""How the wavelet-neural network learns: what a step draws, and what it is held against (section 5).

Every choice of the paper is a setting, and so is what recorded transport allows instead: several lightings a
step, cut to the very wavelets it evaluates, or rows of the transport themselves with no lighting at all.
"""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.light import haar
from prt.methods.training import PointSampler, image_loss, mu_law_slope, radiance
from prt.nn.wavelet_transport import WaveletTransport

SUPERVISIONS = ("images", "rows")
DRAWS = ("uniform", "transport")
TARGETS = ("full", "truncated")


def check_training(settings: dict[str, Any]) -> None:
    """Refuse settings out of range, before any scene is loaded.

    Raises:
        PrtError: naming the setting, its value and what is allowed.
    """
    for name, allowed in (("supervision", SUPERVISIONS), ("draw", DRAWS), ("target", TARGETS)):
        if settings[name] not in allowed:
            raise PrtError(f"method.training.{name}={settings[name]!r} is not one of {', '.join(allowed)}")
    if not isinstance(settings["gain_points"], int) or settings["gain_points"] < 0:
        raise PrtError(
            f"method.training.gain_points={settings['gain_points']!r} must be an integer of at least 0"
        )
    few = settings["lightings_per_view"]
    if few is not None and (not isinstance(few, int) or few < 1):
        raise PrtError(
            f"method.training.lightings_per_view={few!r} must be an integer of at least 1, or null for all"
        )


class WaveletTraining:
    """The loss of one step after another.

    Args:
        net: the network.
        data: ``task.training()``; its transport in the measure that the coefficients are of.
        lightings: training lightings, flat, in the same measure.
        sigma: root mean square of the recorded transport per wavelet.
        by_transport: whether a step's largest wavelets are those of |L_k| sigma_k, or of |L_k|.
        settings: ``method.training``.
        generator: all that is drawn is drawn from it.
    """

    def __init__(
        self,
        net: WaveletTransport,
        data: Any,
        lightings: Float[Tensor, "n T 3"],
        sigma: Float[Tensor, "T"],
        by_transport: bool,
        settings: dict[str, Any],
        generator: torch.Generator,
        device: str,
    ):
        self.net, self.data, self.lightings, self.settings = net, data, lightings, settings
        self.generator, self.device = generator, device
        self.points = PointSampler(settings["strategies"], data.importance, settings["pixels"])
        self.coefficients = haar.forward(lightings)
        self.precision = torch.bfloat16 if settings["precision"] == "bfloat16" else torch.float32
        # on the CPU the corners of a point cost more than the look-up; on a GPU they may cost memory only
        known = device == "cpu" or net.grid.keeps_places
        self.places = net.grid.locate(data.gbuffer) if known else None
        power = self.coefficients.square().mean(dim=(0, 2)).sqrt()
        #: the share of the image that a wavelet is expected to carry, over lightings and places
        self.expected = power * sigma
        self.rank = sigma if by_transport else torch.ones_like(sigma)
        if settings["supervision"] == "rows":
            self.prior_power = power
            prior = data.transport.relight(lightings.mean(dim=0)[None])[0]
            # an error counts as in an image under the mean lighting after the tone map
            self.slope = mu_law_slope(prior.mean(dim=1), settings["mu"], settings["epsilon"])
        few = settings["lightings_per_view"]
        self.lightings_of_view = None
        if few is not None:
            counts = torch.bincount(data.point_view)
            ends = counts.cumsum(0)
            #: the points of every view that has any, and its lightings
            self.views = [range(int(e - n), int(e)) for e, n in zip(ends, counts, strict=True) if n]
            order = torch.rand((len(self.views), len(lightings)), generator=generator).argsort(dim=1)
            self.lightings_of_view = order[:, : min(few, len(lightings))]
            share = max(settings["pixels"] // settings["lightings"], len(settings["strategies"]))
            self.points_of_pair = PointSampler(settings["strategies"], data.importance, share)

    def loss(self) -> Tensor:
        """Of the next step."""
        if self.settings["supervision"] == "rows":
            return self.row_loss()
        return self.shared_lighting_loss() if self.lightings_of_view is None else self.own_lighting_loss()

    def shared_lighting_loss(self) -> Tensor:
        """Images of all points under all of the step's lightings: recorded transport gives them for free."""
        chosen = self.points.draw(self.generator)
        which = self.draw_lightings()
        k = self.draw_wavelets(which)
        kept = self.coefficients[which][:, k]
        target = radiance(self.data.transport, chosen, self.seen(which, k))
        predicted = self.predict(chosen, k)
        return self.compare(torch.einsum("pkc,lkc->lpc", predicted, kept.to(self.device)), target)

    def own_lighting_loss(self) -> Tensor:
        """Images of points under one of the few lightings that their view was rendered with, as in the paper.

        Each of the step's lightings comes with a view that has it and that view's share of the points.
        """
        assert self.lightings_of_view is not None
        pairs = torch.randint(len(self.views), (self.settings["lightings"],), generator=self.generator)
        slots = torch.randint(self.lightings_of_view.shape[1], (len(pairs),), generator=self.generator)
        which = self.lightings_of_view[pairs, slots]
        k = self.draw_wavelets(which)
        parts = [self.points_of_pair.draw(self.generator, self.views[number]) for number in pairs.tolist()]
        seen = self.seen(which, k)
        targets = [radiance(self.data.transport, p, seen[i : i + 1])[0] for i, p in enumerate(parts)]
        owner = torch.repeat_interleave(torch.arange(len(parts)), torch.tensor([len(p) for p in parts]))
        kept = self.coefficients[which][:, k].to(self.device)
        image = torch.einsum("pkc,pkc->pc", self.predict(torch.cat(parts), k), kept[owner])
        return self.compare(image[None], torch.cat(targets)[None])

    def row_loss(self) -> Tensor:
        """Recorded transport itself: coefficients weighted by what the lighting prior makes of them.

        Wavelets are drawn in proportion to their share of the image, and each square is divided by how
        likely it was drawn: what is minimised is the expected error of an image whose coefficients are
        independent.
        """
        chosen = self.points.draw(self.generator)
        weights = self.expected if self.settings["draw"] == "transport" else torch.ones_like(self.expected)
        k = torch.multinomial(weights, self.settings["wavelets"], True, generator=self.generator)
        recorded = haar.forward(self.data.transport.rows(chosen).dense())[:, k].to(self.device)
        error = (self.predict(chosen, k) - recorded) * self.prior_power[k].to(self.device)[:, None]
        error = error * self.slope[chosen].to(self.device)[:, None, None]
        chance = (weights[k] / weights.sum()).to(self.device)
        return (error.square().sum(dim=2) / (chance * len(k))).sum(dim=1).mean() / 3

    # ---- what a step draws

    def draw_lightings(self) -> Int[Tensor, "L"]:
        return torch.randint(len(self.lightings), (self.settings["lightings"],), generator=self.generator)

    def draw_wavelets(self, which: Int[Tensor, "L"]) -> Int[Tensor, "K"]:
        """A step's wavelets: a share of the largest of its lightings, the rest at random (section 5)."""
        coefficients = self.coefficients[which]
        count, total = self.settings["wavelets"], coefficients.shape[1]
        largest = round(count * self.settings["largest_share"])
        strength = coefficients.square().sum(dim=2) * self.rank.square()
        best = strength.topk(min(largest, total), dim=1).indices
        # the largest of every lighting before the second largest of any; each wavelet once
        chosen = torch.tensor(list(dict.fromkeys(best.T.flatten().tolist()))[:largest], dtype=torch.long)
        weights = self.expected.clone() if self.settings["draw"] == "transport" else torch.ones(total)
        weights[chosen] = 0
        if len(chosen) == count:
            return chosen
        rest = torch.multinomial(weights, count - len(chosen), generator=self.generator)
        return torch.cat([chosen, rest])

    def seen(self, which: Int[Tensor, "L"], k: Int[Tensor, "K"]) -> Float[Tensor, "L T 3"]:
        """The lightings that targets are computed under: whole, or cut to the step's wavelets."""
        if self.settings["target"] == "full":
            return self.lightings[which]
        coefficients = self.coefficients[which]
        return haar.inverse(haar.keep_only(coefficients, k.expand(len(which), -1)))

    # ---- what is held against what

    def predict(self, chosen: Int[Tensor, "P"], k: Int[Tensor, "K"]) -> Float[Tensor, "P K 3"]:
        """The network's coefficients of some training points."""
        places = None if self.places is None else self.places.rows(chosen).to(self.device)
        pixel = self.net.inputs(self.data.gbuffer.rows(chosen).to(self.device), places)
        return self.net.coefficients(pixel, k.to(self.device), self.precision)

    def compare(self, image: Float[Tensor, "L P 3"], target: Float[Tensor, "L P 3"]) -> Tensor:
        settings = self.settings
        return image_loss(
            image, target.to(self.device), settings["loss"], settings["mu"], settings["epsilon"]
        )

"""What a scene and its lights ask of a model, measured in minutes without training anything.

Every figure is one :class:`Need`; what follows from them stands in :mod:`prt.methods.advice`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.progress import track
from prt.scene.gbuffer import GBuffer
from prt.tasks.variable_effects import effects
from prt.trace import band_error, scene_needs
from prt.trace.scene_needs import fewest
from prt.trace.statistics import wavelet_scale
from prt.trace.transport import Transport

#: raised when equal settings give other figures
VERSION = 1
#: what may be lost of energy: of the lighting, and in two steps of the transport
LOSS, FINE_LOSS = 0.01, 0.001
#: views that are recorded, their pixels a side and paths a pixel
VIEWS, SIZE, SPP = 8, 48, 128
RECORD_SEED = 70_000
#: configurations baked for the rank of lightmaps, and their paths a texel
CONFIGURATIONS, BAKE_SPP = 24, 32
#: states of the other variables, paths and pixels a side of an image that shows what a variable does
STATES, STATE_SPP, STATE_SIZE = 2, 64, 48


@dataclasses.dataclass(frozen=True)
class Need:
    """One measured figure.

    Attributes:
        name: as ``lighting/wavelets``.
        value: None where no size that was tried is enough.
        about: what it is, in words.
        most: the largest that was tried, where ``value`` may be None.
    """

    name: str
    value: float | None
    about: str
    most: float | None = None

    @property
    def shown(self) -> str:
        """The figure for people."""
        if self.value is None:
            return f"> {self.most:g}"
        return f"{self.value:.1%}" if self.name.startswith("share/") else f"{self.value:.4g}"


def measure(task: Any) -> list[Need]:
    """All figures of a task's scene and lighting; views and lights are those of training, none of a test."""
    return MEASURES[task.name](task)


def of_lighting(lightings: Float[Tensor, "n 6 R R 3"]) -> list[Need]:
    """Wavelets and bands of harmonics that keep the energy of the training lightings."""
    percent = f"{1 - LOSS:.0%} of the energy of a training lighting, in the mean"
    wavelets = scene_needs.wavelet_energy(lightings)
    bands = scene_needs.harmonic_energy(lightings)
    most = scene_needs.HIGHEST_DEGREE + 1
    return [
        Need(
            "lighting/wavelets",
            fewest(wavelets, LOSS),
            f"largest wavelets that hold {percent}",
            len(wavelets),
        ),
        Need(
            "lighting/bands", fewest(bands, LOSS), f"bands of spherical harmonics that hold {percent}", most
        ),
    ]


def of_relighting(task: Any) -> list[Need]:
    """Of ``relight_indirect``: lighting, rank of transport, shares of light and of surfaces, cells."""
    views = task.scene.views("train", VIEWS, SIZE)
    label = f"record transport, {task.scene.name}"
    records = [
        task.recorded(view, SPP, RECORD_SEED + i) for i, view in enumerate(track(views, label, len(views)))
    ]
    gbuffer = GBuffer.concatenate([g for g, _ in records])
    whole = Transport.concatenate([t.rows(g.hit.nonzero()[:, 0]) for g, t in records])
    indirect = whole.component("indirect")
    prior = task.prior()[None]
    light = {name: float(whole.component(name).relight(prior).mean()) for name in ("direct", "indirect")}
    lightings = task.train_lightings()
    cubemaps = lightings.view(-1, 6, task.resolution, task.resolution, 3)
    kept = scene_needs.transport_energy(indirect, gbuffer, lightings)
    moved = scene_needs.wavelet_energy(cubemaps, wavelet_scale(indirect, gbuffer))
    shares = scene_needs.surface_shares(gbuffer)
    return [
        *of_lighting(cubemaps),
        Need(
            "transport/wavelets",
            fewest(moved, LOSS),
            f"wavelets that hold {1 - LOSS:.0%} of what transport makes of a training lighting",
            len(moved),
        ),
        Need(
            "transport/rank", fewest(kept, LOSS),
            f"patterns of light that hold {1 - LOSS:.0%} of indirect transport under such lights", len(kept),
        ),
        Need(
            "transport/rank_fine", fewest(kept, FINE_LOSS),
            f"patterns of light that hold {1 - FINE_LOSS:.1%} of it", len(kept),
        ),
        Need(
            "share/indirect", light["indirect"] / max(light["direct"] + light["indirect"], 1e-30),
            "of reflected light that has more than one bounce",
        ),
        Need("share/glossy", shares["glossy"], f"of visible points below roughness {scene_needs.GLOSSY:g}"),
        Need("share/mirror", shares["mirror"], f"of visible points below roughness {scene_needs.MIRROR:g}"),
        Need(
            "surface/cells", scene_needs.surface_cells(gbuffer, task.pixel_size),
            f"cells as wide as a training pixel that {VIEWS} views of {SIZE} x {SIZE} meet",
        ),
    ]  # fmt: skip


def of_direct(task: Any) -> list[Need]:
    """Of ``relight_direct``: bands of the lighting alone, and of shaded light against the traced truth."""
    errors = task.band_errors()
    _, lightings = task.lighting.train()
    return [
        *of_lighting(lightings),
        Need(
            "transfer/bands", band_error.fewest(errors, task.order_target),
            f"bands whose shaded light is within {task.order_target:g} of the traced one", max(errors),
        ),
    ]  # fmt: skip


def of_lightmaps(task: Any) -> list[Need]:
    """Of ``local_lights``: rank of lightmaps baked under configurations of the scenario."""
    _, rigs = task.rigs("train", CONFIGURATIONS)
    label = f"bake lightmaps, {task.scene.name}"
    pairs = [
        task.baked_twice(rig, BAKE_SPP, RECORD_SEED + i)
        for i, rig in enumerate(track(rigs, label, len(rigs)))
    ]
    kept = scene_needs.shared_energy(*(torch.stack([p[k] for p in pairs]).flatten(1) for k in (0, 1)))
    about = "patterns that hold {} of " + f"{CONFIGURATIONS} baked lightmaps"
    return [
        Need("lightmaps/rank", fewest(kept, LOSS), about.format(f"{1 - LOSS:.0%}"), CONFIGURATIONS),
        Need(
            "lightmaps/rank_fine",
            fewest(kept, FINE_LOSS),
            about.format(f"{1 - FINE_LOSS:.1%}"),
            CONFIGURATIONS,
        ),
    ]


def of_animation(task: Any) -> list[Need]:
    """Of ``animate``: what each variable changes."""
    return [
        Need(f"variable/{name}", change, "root mean square change of the image, over the mean radiance")
        for name, change in effects(task, STATES, STATE_SPP, STATE_SIZE).items()
    ]


MEASURES: dict[str, Callable[[Any], list[Need]]] = {
    "relight_indirect": of_relighting,
    "relight_direct": of_direct,
    "local_lights": of_lightmaps,
    "animate": of_animation,
}

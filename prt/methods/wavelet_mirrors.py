"""Secondary rays for wavelet-neural: at near-mirrors the network is asked for what they mirror.

After Su et al. 2024, section 5, "Specular Surfaces", who trace on until a surface is not specular.

The network's error at a mirror is one of resolution: it holds no reflection sharper than its encoding of the
reflected direction. What a mirror shows is mostly diffuse, and of that the network knows the indirect light.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.methods.wavelet_shading import WaveletCode
from prt.scene.gbuffer import GBuffer

#: rays traced at a time: bounds the memory
WAVEFRONT = 1 << 20
#: of the rays' random numbers; one for all frames, so that nothing flickers in a picture that stands still
SEED = 1
MOST = 1024
DEFAULTS = {"roughness": 0.0, "rays": 4, "light_samples": 8, "bounces": 4}


@dataclasses.dataclass
class MirrorCode(WaveletCode):
    """A lighting's code, and the whole lighting, which secondary rays need."""

    lighting: Float[Tensor, "6 R R 3"] | None = None


class Mirrors:
    """Replaces a network's indirect light at the pixels of near-mirrors.

    Args:
        settings: ``roughness``: surfaces of a lower sigma are mirrors, 0 for none; ``rays`` a pixel;
            ``light_samples`` at every surface the rays meet; ``bounces``: mirrors followed in a row.
            None, or what is left out: never, 4, 8, 4.

    Raises:
        PrtError: for an unknown setting or one out of range.
    """

    def __init__(self, settings: Mapping[str, Any] | None):
        given = {**DEFAULTS, **(settings or {})}
        for name, value in given.items():
            if name not in DEFAULTS:
                raise PrtError(f"method.secondary.{name} is no setting; allowed are {', '.join(DEFAULTS)}")
            whole = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST
            if name != "roughness" and not whole:
                raise PrtError(f"method.secondary.{name}={value!r} must be a whole number from 1 to {MOST}")
        self.roughness = sigma_setting("secondary.roughness", given.pop("roughness"))
        self.settings: dict[str, int] = given
        self.scene: Any = None
        self.mi_scene: Any = None
        self.shown: Tensor | None = None  # the lighting that mi_scene has

    @property
    def on(self) -> bool:
        return self.roughness > 0

    def use(self, scene: Any) -> None:
        """Take the scene that rays are traced in; it is loaded with the first lighting."""
        if scene is not self.scene:
            self.scene, self.mi_scene, self.shown = scene, None, None

    def coded(self, code: WaveletCode, lighting: Float[Tensor, "6 R R 3"]) -> WaveletCode:
        """The code with what secondary rays need of the lighting, and the scene lit by it.

        Raises:
            PrtError: if there is no scene, or the lighting is not finite or negative somewhere.
        """
        if not self.on:
            return code
        parts = {field.name: getattr(code, field.name) for field in dataclasses.fields(code)}
        kept = lighting.detach().float().cpu().clone()
        self.show(kept)
        return MirrorCode(**parts, lighting=kept)

    def show(self, lighting: Float[Tensor, "6 R R 3"]) -> None:
        """Light the scene, where it is not lit so already."""
        from prt.trace.cubemap_emitter import scene_with_lighting, set_lighting

        if self.scene is None:
            raise PrtError(
                f"method.secondary.roughness={self.roughness} traces rays and needs a scene; fit or load the "
                "method with a task, or set it to 0"
            )
        if self.mi_scene is None:
            self.mi_scene = scene_with_lighting(self.scene, lighting)
        elif self.shown is not lighting:
            set_lighting(self.mi_scene, lighting)
        self.shown = lighting

    def rows(self, gbuffer: GBuffer) -> Int[Tensor, "A"]:
        """The points that are mirrors."""
        if not self.on:
            return torch.zeros(0, dtype=torch.long)
        return (gbuffer.roughness[:, 0] < self.roughness).nonzero()[:, 0].cpu()

    def mended(
        self,
        values: Float[Tensor, "N 3"],
        gbuffer: GBuffer,
        code: WaveletCode,
        ask: Callable[[GBuffer], Float[Tensor, "M 3"]],
    ) -> Float[Tensor, "N 3"]:
        """``values`` with those of mirrors replaced; where a ray does not find the surface again they stay.

        Args:
            values: indirect radiance at the points of the G-buffer, on the CPU.
            code: from :meth:`coded`.
            ask: indirect radiance at other points, on the CPU.
        """
        rows = self.rows(gbuffer)
        if len(rows) == 0:
            return values
        values = values.clone()
        for part, found in self.traced(gbuffer, rows, code):
            total = found.total(ask(found.points))
            values[part] = torch.where(found.found[:, None], total, values[part])
        return values

    def traced(self, gbuffer: GBuffer, rows: Int[Tensor, "A"], code: WaveletCode) -> list:
        """``(rows, reflections)`` of some of the points, so many at a time."""
        from prt.trace.secondary import reflections

        lighting = getattr(code, "lighting", None)
        if lighting is None:
            raise PrtError("this lighting's code is from before method.secondary was on: call light() again")
        self.show(lighting)
        # by the place in the image: a mirror's noise stands still when something else moves
        names = gbuffer.hit.cpu().nonzero()[:, 0] if gbuffer.view is not None else torch.arange(len(gbuffer))
        parts = []
        for part in rows.split(max(1, WAVEFRONT // self.settings["rays"])):
            points = gbuffer.rows(part.to(gbuffer.position.device)).to("cpu")
            found = reflections(
                self.mi_scene, points, names[part], gbuffer.view, self.roughness, **self.settings, seed=SEED
            )
            parts.append((part, found))
        return parts

    def timed_parts(
        self, gbuffer: GBuffer, code: WaveletCode, ask: Callable[[GBuffer], Float[Tensor, "M 3"]]
    ) -> dict[str, Callable[[], Any]]:
        """The rays, and the network at all points it is asked for, each by itself; none where it is off."""
        if not self.on:
            return {}
        rows = self.rows(gbuffer)
        points = [found.points for _, found in self.traced(gbuffer, rows, code)]
        return {
            "trace": lambda: self.traced(gbuffer, rows, code),
            "network": lambda: [ask(part) for part in (gbuffer, *points)],
        }


def sigma_setting(name: str, value: Any) -> float:
    """A setting that says which surfaces are mirrors.

    Raises:
        PrtError: if it is no number from 0 to 1.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
        raise PrtError(
            f"method.{name}={value!r} must be a number from 0 to 1: surfaces of lower sigma are mirrors, "
            "with 0 none are"
        )
    return float(value)

"""What all methods share that hold the radiance of a moving scene: rays to surfaces, values, an image."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import Component, FitLog
from prt.metrics.tonemap import exposure_of
from prt.nn.radiance_network import RadiancePoints
from prt.scene.capture import camera_frame
from prt.scene.gbuffer import GBuffer
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace.fxaa import fxaa
from prt.trace.radiance_rays import Answers, follow, make_sampler, right_hand_side

#: points whose values are computed at a time
CHUNK = 1 << 12
#: rays of a right-hand side at a time
WAVEFRONT = 1 << 19


@dataclasses.dataclass
class FieldCode:
    """A state, and what the network made of it."""

    v: Float[Tensor, "n"]
    state: Any


class RadianceField:
    """Base of the methods; a subclass fits, and gives values at points.

    Args:
        pixel_samples: rays a pixel; 1 goes through its centre, more are spread over it and averaged.
        fxaa: whether the image is smoothed along its edges (section 5, "Antialiasing").
        right_hand: directions sampled where a pixel's ray arrives, whose radiance is asked instead of its
            own (section 6.2, "RHS Rendering"); 0 for the left-hand side.
    """

    component = Component.FULL
    tasks = frozenset({"animate"})
    stage: Any

    def __init__(self, pixel_samples: int, fxaa: bool, right_hand: int):
        for name, value, least in (("pixel_samples", pixel_samples, 1), ("right_hand", right_hand, 0)):
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise PrtError(f"method.{name}={value!r} must be an integer of at least {least}")
        self.pixel_samples, self.fxaa, self.right_hand = pixel_samples, bool(fxaa), right_hand
        self.device = "cpu"

    # ---- for subclasses

    def build(self, task: Any, device: str) -> None:
        """Make ``self.net``, untrained, for the task's scene."""
        raise NotImplementedError

    def at(self, v: Float[Tensor, "n"]) -> Any:
        """What depends on the state alone."""
        raise NotImplementedError

    def values(self, points: RadiancePoints, state: Any) -> Float[Tensor, "N 3"]:
        """Smoothly reflected radiance."""
        raise NotImplementedError

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        raise NotImplementedError

    # ---- rendering

    @torch.no_grad()
    def light(self, lighting: Float[Tensor, "n"]) -> FieldCode:
        """Move the scene to a state and prepare the network for it.

        Raises:
            PrtError: for a state of another length than the scene has variables.
        """
        v = lighting.detach().float().cpu()
        self.stage.set(v)
        return FieldCode(v, self.at(v.to(self.device)))

    @torch.no_grad()
    def shade(self, gbuffer: GBuffer, code: FieldCode, v: Tensor | None = None) -> Float[Tensor, "N 3"]:
        """Full radiance of the pixels of the G-buffer's view.

        Raises:
            PrtError: for a G-buffer that belongs to no image.
        """
        view = gbuffer.view
        if view is None:
            raise PrtError(
                "task=animate renders whole images: give the G-buffer of a view, not single points"
            )
        self.stage.set(code.v)
        image = self.compose(self.trace(view), code).reshape(view.height, view.width, 3)
        if self.fxaa:
            # its own exposure, for no reference is at hand
            image = fxaa(image, exposure=exposure_of(image.numpy()))
        return image.reshape(-1, 3)[gbuffer.hit.cpu()]

    def trace(self, view: View) -> Answers:
        """The rays of all pixels, to where the network is asked."""
        count = view.width * view.height * self.pixel_samples
        return follow(
            self.stage.mi_scene, pixel_rays(view, self.pixel_samples), count, 1, keep=self.right_hand > 0
        )

    def compose(self, answers: Answers, code: FieldCode) -> Float[Tensor, "P 3"]:
        """Values at all points, and the pixels they sum to."""
        if self.right_hand:
            values = self.gathered(answers, code)
        else:
            values = self.valued(answers.points, code)
        return answers.total(values).reshape(-1, self.pixel_samples, 3).mean(1)

    def valued(self, points: RadiancePoints, code: FieldCode) -> Float[Tensor, "N 3"]:
        """:meth:`values` of points that may lie elsewhere, on the CPU."""
        return self.chunked(points.to(self.device), code.state).cpu()

    def chunked(self, points: RadiancePoints, state: Any) -> Float[Tensor, "N 3"]:
        """:meth:`values` of a part of the points after another: what they need stays in cache."""
        starts = range(0, len(points), CHUNK)
        parts = [self.values(points.rows(slice(k, k + CHUNK)), state) for k in starts]
        return torch.cat([points.position.new_zeros((0, 3)), *parts])

    def gathered(self, answers: Answers, code: FieldCode) -> Float[Tensor, "N 3"]:
        """The right-hand side at all points: radiance of what lies in ``right_hand`` directions."""
        import drjit as dr

        mi = mitsuba()
        out, most = [torch.zeros((0, 3))], max(1, WAVEFRONT // self.right_hand)
        for number, si in enumerate(answers.interactions):
            count = dr.width(si)
            for start in range(0, count, most):
                many = min(most, count - start)
                part = dr.gather(mi.SurfaceInteraction3f, si, dr.arange(mi.UInt32, many) + mi.UInt32(start))
                seed = 7919 * (number + 1) + start
                right = right_hand_side(self.stage.mi_scene, part, many, self.right_hand, seed)
                out.append(right.total(self.valued(right.points, code)))
        return torch.cat(out)

    def timed_parts(self, lighting: Tensor, gbuffer: GBuffer) -> dict[str, Callable[[], Any]]:
        """Moving the scene, rays, and the network, each by itself."""
        v, view = lighting.detach().float().cpu(), gbuffer.view
        if view is None:
            return {}
        code, other = self.light(v), 1.0 - v
        answers = self.trace(view)

        def move() -> None:
            self.stage.set(other)
            self.stage.set(v)

        # there and back: two changes of the state
        return {
            "move_twice": move,
            "trace": lambda: self.trace(view),
            "network": lambda: self.compose(answers, code),
            "state": lambda: self.at(v.to(self.device)),
        }

    # ---- storage

    net: torch.nn.Module

    def nbytes(self) -> int:
        """All weights."""
        return sum(p.numel() * p.element_size() for p in self.net.parameters())

    def save(self, path: Path) -> None:
        state = {name: value.detach().cpu().contiguous() for name, value in self.net.state_dict().items()}
        save_file(state, path)

    def load(self, path: Path, task: Any, device: str) -> None:
        """Raises PrtError where the file was written with other sizes."""
        self.build(task, device)
        try:
            self.net.load_state_dict(load_file(path))
        except RuntimeError as error:
            raise PrtError(
                f"{path} was written with other sizes than the method has now; use the run's own config.yaml"
            ) from error
        self.net.eval()


def pixel_rays(view: View, samples: int):
    """``mi.Ray3f``, ``samples`` a pixel next to each other: through its centre, or jittered within it."""
    import drjit as dr

    mi = mitsuba()
    count = view.width * view.height * samples
    right, up, forward = (mi.Vector3f(*map(float, row)) for row in camera_frame(view))
    number = dr.arange(mi.UInt32, count) // samples
    dr.make_opaque(right, up, forward)
    offset = make_sampler(1, count).next_2d() if samples > 1 else mi.Point2f(0.5)
    width, height = dr.opaque(mi.Float, view.width), dr.opaque(mi.Float, view.height)
    column = mi.Float(number % view.width) + offset.x
    row = mi.Float(number // view.width) + offset.y
    half = dr.opaque(mi.Float, float(view.half_width))
    x, y = (2 * column / width - 1) * half, (1 - 2 * row / height) * half * height / width
    direction = dr.normalize(x * right + y * up + forward)
    origin = mi.Point3f(*(dr.opaque(mi.Float, float(c)) for c in view.origin))
    near = 1e-3 / dr.dot(direction, forward)
    return mi.Ray3f(origin + near * direction, direction)

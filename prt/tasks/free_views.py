"""Any view under any light of a task's scene, for films and the viewer: what tests never ask for.

:func:`free_view` gives a task's :class:`FreeView`; a task that is not known here cannot be played.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.cubemap import rotate, yaw
from prt.scene.capture import capture
from prt.scene.gbuffer import GBuffer
from prt.scene.view import View
from prt.trace.reference import render

#: rigs along the way of a moving light
STEPS = 100


@dataclasses.dataclass(frozen=True)
class FreeView:
    """A task's scene, free to look at.

    Attributes:
        lightings: what a method's ``light`` takes, by name: the task's test lightings.
        variables: names of the scene's variables; then a lighting is a state, one value each in [0, 1].
        moving: the lighting at a share in [0, 1) of a relighting sequence that begins with the given one and
            comes back to it: an environment turns about the vertical, a lamp goes to and fro, variables move.
        look: G-buffer of a view.
        trace: a path-traced image of a view, by component; arguments view, lighting, spp, seed.
    """

    lightings: dict[str, Any]
    variables: list[str]
    moving: Callable[[Any, float], Any]
    look: Callable[[View, Any], GBuffer]
    trace: Callable[[View, Any, int, int], dict[str, Tensor]]


def free_view(task: Any) -> FreeView:
    """The free view of a task.

    Raises:
        PrtError: for a task of the user's own.
    """
    if task.name not in MAKERS:
        raise PrtError(f"runs of task {task.name} cannot be played; those of {', '.join(MAKERS)} can")
    return MAKERS[task.name](task)


def turned(lighting: Float[Tensor, "6 R R 3"], share: float) -> Float[Tensor, "6 R R 3"]:
    """An environment turned about the vertical by a share of a full turn."""
    return rotate(lighting, yaw(360 * share)).to(lighting.dtype) if share % 1 else lighting


def of_indirect(task: Any) -> FreeView:
    def trace(view: View, lighting: Tensor, spp: int, seed: int) -> dict[str, Tensor]:
        return render(task.scene, view, lighting, spp, task.scene.max_depth, seed)

    names, lightings = task.lighting.test()
    return FreeView(
        dict(zip(names, lightings, strict=True)), [], turned,
        lambda view, _: capture(task.mitsuba_scene, view), trace,
    )  # fmt: skip


def of_direct(task: Any) -> FreeView:
    material = task.materials[0]

    def look(view: View, _: Any) -> GBuffer:
        return task.dressed(task.surface.capture(view), material)

    def trace(view: View, lighting: Tensor, spp: int, seed: int) -> dict[str, Tensor]:
        gbuffer = look(view, lighting)
        return {"direct": gbuffer.image(task.truth(gbuffer, lighting, spp, seed))}

    names, lightings = task.lighting.test()
    return FreeView(dict(zip(names, lightings, strict=True)), [], turned, look, trace)


def of_lights(task: Any) -> FreeView:
    names, rigs = task.rigs("same", task.test_count)

    def moving(rig: Any, share: float) -> Any:
        if rig.environment is not None:
            return dataclasses.replace(rig, environment=turned(rig.environment, share))
        _, path = task.rigs("path", STEPS)
        there_and_back = 1 - abs(2 * (share % 1) - 1)
        return path[round(there_and_back * (STEPS - 1))]

    return FreeView(
        dict(zip(names, rigs, strict=True)), [], moving,
        lambda view, rig: task.asset.capture(task.lit(rig.pose).dark, view, rig.pose),
        lambda view, rig, spp, seed: task.lit(rig.pose).render(rig, view, spp, seed),
    )  # fmt: skip


def of_states(task: Any) -> FreeView:
    names = list(task.stage.animation.names)

    def moving(v: Tensor, share: float) -> Tensor:
        """Every variable swings about its value, as far as the cube lets it, each a little later."""
        late = torch.arange(len(v)) / max(len(v), 1)
        swing = torch.sin(2 * math.pi * (share + late)) - torch.sin(2 * math.pi * late)
        return (v + 0.5 * swing).clamp(0, 1)

    def look(view: View, v: Tensor) -> GBuffer:
        task.stage.set(v.tolist())
        return capture(task.stage.mi_scene, view)

    def trace(view: View, v: Tensor, spp: int, seed: int) -> dict[str, Tensor]:
        image, gbuffer = task.render(v, view, spp, seed), look(view, v)
        return {"full": image * gbuffer.hit.reshape(view.height, view.width, 1)}

    states = {name: torch.tensor(v, dtype=torch.float32) for _, name, v in task.test_states()}
    return FreeView(states, names, moving, look, trace)


MAKERS: dict[str, Callable[[Any], FreeView]] = {
    "relight_indirect": of_indirect,
    "relight_direct": of_direct,
    "local_lights": of_lights,
    "animate": of_states,
}

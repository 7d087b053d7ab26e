"""What a fitted method makes of lightings and states that none can be, and of the extremes of those that can.

Called by ``prt table stability/inputs``.
"""

import dataclasses
import math
from typing import Any

from torch import Tensor

from prt.errors import PrtError
from prt.light.local import LightRig
from prt.tasks.free_views import free_view

#: inputs that must be refused, and inputs that must be answered
WRONG = ("nan", "infinite", "negative")
EXTREME = ("black", "one", "huge")


def bad_inputs(task: Any, model: Any, size: int = 32) -> list[dict[str, Any]]:
    """One row an input, and the worst of them: ``input/broken`` is 1 where it does harm in silence, else 0.

    A NaN, infinite or negative value has to be refused with a :class:`PrtError`. No light at all, one texel
    with all light, and light times 1e6 have to be answered with finite radiance, and no light with no light.
    States of a scene that moves have no such extremes: those beyond the cube are judged by error, elsewhere.

    Args:
        model: fitted.
        size: pixels a side of the image.
    """
    free = free_view(task)
    good = next(iter(free.lightings.values()))
    view = task.scene.views("far", 1, size)[0]
    gbuffer = free.look(view, good)
    found = {}
    for kind in (*WRONG, *(EXTREME if not free.variables else ())):
        refused, image = False, None
        try:
            image = model.shade(gbuffer, model.light(spoilt(good, kind))).detach().float().cpu()
        except PrtError:
            refused = True
        if kind in WRONG:
            broken = not refused
        else:
            broken = image is None or not image.isfinite().all()
            broken = broken or (kind == "black" and float(image.abs().max()) > 1e-6)  # pyright: ignore
        found[kind] = float(broken)
    found["any"] = max(found.values())
    return [
        {"variant": f"input={kind}", "component": model.component.value, "metric": "input/broken",
         "value": value, "n": 1}
        for kind, value in found.items()
    ]  # fmt: skip


def spoilt(lighting: Any, kind: str) -> Any:
    """A lighting, rig or state made wrong or extreme in one way."""
    bad = {"nan": math.nan, "infinite": math.inf, "negative": -1.0}
    if isinstance(lighting, LightRig):
        if kind in bad or kind == "huge":
            value = bad.get(kind, 1e6)
            light = dataclasses.replace(lighting.lights[0], color=(value, value, value))
            return dataclasses.replace(lighting, lights=(light, *lighting.lights[1:]))
        return dataclasses.replace(lighting, lights=lighting.lights[:1] if kind == "one" else ())
    assert isinstance(lighting, Tensor)
    changed = lighting.clone()
    flat = changed.view(-1, 3) if changed.ndim == 4 else changed
    if kind in bad:
        flat[len(flat) // 2] = bad[kind] if changed.ndim == 4 or kind != "negative" else -math.inf
    elif kind == "huge":
        changed *= 1e6
    else:
        changed.zero_()
        if kind == "one":
            flat[len(flat) // 3] = 1000.0
    return changed

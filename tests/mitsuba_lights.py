"""Light rigs in Mitsuba's own words, to compare with."""

from prt.light.local import LocalLight
from prt.scene.mitsuba_setup import mitsuba


def mitsuba_light(light: LocalLight) -> dict:
    """The same light as Mitsuba's own emitter."""
    mi = mitsuba()
    color = {"type": "rgb", "value": list(light.color)}
    if light.kind == "point":
        return {"type": "point", "position": list(light.position), "intensity": color}
    if light.kind == "directional":
        return {"type": "directional", "direction": list(light.direction), "irradiance": color}
    end = [p + d for p, d in zip(light.position, light.direction, strict=True)]
    up = [0.0, 1.0, 0.0] if abs(light.direction[1]) < 0.9 else [1.0, 0.0, 0.0]
    to_world = mi.ScalarTransform4f().look_at(list(light.position), end, up)
    return {"type": "spot", "to_world": to_world, "intensity": color, "cutoff_angle": light.cutoff,
            "beam_width": light.beam}  # fmt: skip

"""Lightings unlike any training environment, made from one: what a method does when it meets them."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.cubemap import direction_to_texel, mean_radiance, texel_solid_angles

KINDS = ("same", "sun", "texel", "red", "bright", "dim", "black")
#: share of all light that the added sun brings; factor on green and blue of the saturated environment
SUN_SHARE, SATURATION = 0.8, 0.05
BRIGHT, DIM = 1e3, 1e-3
#: where the sun and the bright texel stand: 40 degrees above the horizon, to the left of +z
SUN_DIRECTION = (-0.5, 0.64, 0.58)


def unlike(environment: Float[Tensor, "6 R R 3"], kind: str) -> Float[Tensor, "6 R R 3"]:
    """``environment`` changed to one of ``KINDS``.

    ``same``: unchanged. ``sun``: one texel added that brings 80 % of all light (an outdoor sun; it casts hard
    shadows). ``texel``: nothing but one texel with all the light. ``red``: green and blue at a twentieth
    (figure 4 of Raghavan 2023). ``bright``, ``dim``: times 1000 and 0.001. ``black``.

    Raises:
        PrtError: for an unknown kind.
    """
    if kind not in KINDS:
        raise PrtError(f"lighting kind {kind!r} is not one of {', '.join(KINDS)}")
    if kind in ("sun", "texel"):
        share = 1.0 if kind == "texel" else SUN_SHARE
        R = environment.shape[1]
        place = int(direction_to_texel(torch.tensor([SUN_DIRECTION]), R)[0])
        power = mean_radiance(environment).mean() * 4 * math.pi
        out = (1 - share) * environment.reshape(-1, 3)
        out[place] += share * power / texel_solid_angles(R).reshape(-1)[place]
        return out.reshape(environment.shape)
    tint = torch.tensor([1.0, SATURATION, SATURATION]) if kind == "red" else torch.ones(3)
    return environment * tint * {"bright": BRIGHT, "dim": DIM, "black": 0.0}.get(kind, 1.0)

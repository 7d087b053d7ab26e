"""What lighting and transfer in few bands cost, whatever stores them: against the ray-traced truth."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from prt.scene.gbuffer import GBuffer
from prt.trace import sh_shading
from prt.trace.direct_light import direct_light
from prt.trace.surface import Surface
from prt.trace.transfer import bake


def band_errors(
    surface: Surface, views: Sequence[tuple[GBuffer, Float[Tensor, "6 R R 3"]]], orders: Sequence[int],
    directions: int, samples: int, windowing: float, seed: int,
) -> dict[int, float]:  # fmt: skip
    """Root mean square error of radiance over the root mean square of the truth, for each number of bands.

    Transfer is cast for every point once, in the most bands asked for; fewer are its first coefficients.

    Args:
        views: G-buffers with the materials that are shaded, and what lights each.
        directions: rays of a transfer vector.
        samples: directions a point of the truth.
    """
    wrong, size = dict.fromkeys(orders, 0.0), 0.0
    for gbuffer, lighting in views:
        transfer = bake(surface, gbuffer.position, gbuffer.normal, max(orders), directions, seed)
        truth = direct_light(
            surface, gbuffer.position, gbuffer.normal, gbuffer.wr, gbuffer.diffuse, gbuffer.specular,
            sh_shading.exponent_of(gbuffer.roughness), lighting, samples, seed,
        )  # fmt: skip
        size += float(truth.double().square().sum())
        for order in orders:
            code = sh_shading.encode(lighting, order, windowing)
            image = sh_shading.shade(transfer[:, : order**2].contiguous(), gbuffer, code)
            wrong[order] += float((image - truth).double().square().sum())
    return {order: (value / max(size, 1e-30)) ** 0.5 for order, value in wrong.items()}


def fewest(errors: dict[int, float], target: float) -> int | None:
    """The smallest number of bands whose error is within the target; None where there is none."""
    return min((order for order, error in errors.items() if error <= target), default=None)

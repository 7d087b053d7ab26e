"""The Stanford bunny as a neural signed distance field: a scene with no triangles."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.scene.neural_sdf import Corner, Fit, NeuralSdf, neural_bunny
from prt.scene.scene import Scene, Trajectory

#: cells a side of the grid that is searched for a zero set, and points evaluated together
PROBE, CHUNK = 64, 1 << 16


class NeuralSdfScene(Scene):
    """One opaque, diffuse object of one colour; the network is trained when it is first needed.

    Args:
        cameras, name, max_depth, record: as in :class:`~prt.scene.scene.Scene`.
        sdf_neurons, sdf_layers: of each hidden layer; hidden layers.
        albedo: linear RGB in [0, 1].

    Raises:
        PrtError: if a setting is out of range; where the mesh is missing (when it is first needed).
    """

    #: no expression: the distance is a torch function
    sdf = None

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "neural_bunny",
        max_depth: int = 2,
        record: Literal["bsdf", "nee"] = "bsdf",
        sdf_neurons: int = 32,
        sdf_layers: int = 2,
        albedo: Sequence[float] = (0.8, 0.8, 0.8),
    ):
        super().__init__(name, cameras, max_depth, record)
        Fit(sdf_neurons, sdf_layers)  # refused now, not when it is trained
        self.sdf_neurons, self.sdf_layers = sdf_neurons, sdf_layers
        if (
            isinstance(albedo, (str, bytes))
            or len(albedo) != 3
            or not all(isinstance(part, (int, float)) and 0.0 <= part <= 1.0 for part in albedo)
        ):
            raise PrtError(f"scene.albedo={albedo!r} must be 3 numbers between 0 and 1; give linear RGB")
        red, green, blue = (float(part) for part in albedo)
        self.albedo = (red, green, blue)

    @functools.cached_property
    def network(self) -> NeuralSdf:
        """The trained network; its weights and formula are what a shader needs."""
        return neural_bunny(self.sdf_neurons, self.sdf_layers)

    @property
    def distance(self) -> Callable[[Float[Tensor, "N 3"]], Float[Tensor, "N"]]:
        """From points (N, 3) to distances (N,), negative inside, no greater than the true ones."""
        return self.network.distance

    @property
    def bounds(self) -> tuple[Corner, Corner]:
        """Corners of the box that the network was trained in, world units."""
        return self.network.bounds

    def fingerprint(self) -> dict[str, Any]:
        return {"scene": "neural_sdf", **self.network.fingerprint(), "albedo": list(self.albedo)}

    def description(self) -> dict[str, Any]:
        """There is none.

        Raises:
            PrtError: always.
        """
        raise PrtError(
            f"scene {self.name} is a signed distance field, it has no shapes for Mitsuba; "
            "use task=relight_direct, or a mesh scene"
        )

    def check(self) -> None:
        """Look for a zero set on a grid in the box.

        Raises:
            PrtError: where there is none (training failed).
        """
        low, high = self.bounds
        axes = [a + (b - a) * (torch.arange(PROBE) + 0.5) / PROBE for a, b in zip(low, high, strict=True)]
        with torch.no_grad():
            values = torch.cat([self.distance(part) for part in torch.cartesian_prod(*axes).split(CHUNK)])
        if not float(values.min()) < 0.0 < float(values.max()):
            raise PrtError(
                f"scene.sdf_neurons={self.sdf_neurons}, scene.sdf_layers={self.sdf_layers}: no surface; "
                "choose 32 or 64 neurons and 2 layers"
            )

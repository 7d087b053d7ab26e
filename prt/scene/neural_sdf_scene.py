"""The Stanford bunny as a neural signed distance field: a scene with no triangles."""

import functools
from collections.abc import Sequence
from typing import Any, Literal

from prt.scene.field_scene import Corner, Distance, FieldScene
from prt.scene.neural_sdf import Fit, NeuralSdf, neural_bunny
from prt.scene.scene import Trajectory


class NeuralSdfScene(FieldScene):
    """One opaque, diffuse object of one colour; the network is trained when it is first needed.

    Args:
        cameras, name, max_depth, record, albedo: as in :class:`~prt.scene.field_scene.FieldScene`.
        sdf_neurons, sdf_layers: of each hidden layer; hidden layers.

    Raises:
        PrtError: if a setting is out of range; where the mesh is missing (when it is first needed).
    """

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
        super().__init__(cameras, name, max_depth, record, albedo)
        Fit(sdf_neurons, sdf_layers)  # refused now, not when it is trained
        self.sdf_neurons, self.sdf_layers = sdf_neurons, sdf_layers

    @functools.cached_property
    def network(self) -> NeuralSdf:
        """The trained network; its weights and formula are what a shader needs."""
        return neural_bunny(self.sdf_neurons, self.sdf_layers)

    @property
    def distance(self) -> Distance:
        """The network's."""
        return self.network.distance

    @property
    def bounds(self) -> tuple[Corner, Corner]:
        """Corners of the box that the network was trained in, world units."""
        return self.network.bounds

    def fingerprint(self) -> dict[str, Any]:
        return {"scene": "neural_sdf", **self.network.fingerprint(), "albedo": list(self.albedo)}

    def without_surface(self, least: float, most: float) -> str:
        return (
            f"scene.sdf_neurons={self.sdf_neurons}, scene.sdf_layers={self.sdf_layers}: no surface; "
            "choose 32 or 64 neurons and 2 layers"
        )

"""Transfer at the vertices, interpolated over triangles (Sloan, Kautz and Snyder 2002)."""

from pathlib import Path
from typing import Any

from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import FitLog
from prt.methods.sh_relight import ShRelight
from prt.methods.texture_prt import atlas_of, mesh_of
from prt.scene.atlas import interpolate
from prt.scene.gbuffer import GBuffer
from prt.trace.sh_transfer import vertex_origins
from prt.trace.transfer import bake


class VertexPrt(ShRelight):
    """The method; settings as in ``conf/method/vertex_prt.yaml``.

    Args:
        directions: rays a vertex.
    """

    def __init__(self, directions: int):
        self.directions = directions
        self._values: Float[Tensor, "V K"] | None = None
        self._face: Int[Tensor, "F 3"] | None = None

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Cast the rays of all vertices.

        Raises:
            PrtError: for a surface without vertices.
        """
        self.prepare(task, device)
        mesh = mesh_of(task, "vertex_prt").mesh()
        kept = log.resume()
        log.start(1, "vertex_prt")
        if kept is None:
            origin = vertex_origins(mesh)
            values = bake(task.surface, origin, mesh.normal, task.order, self.directions, seed, "vertices")
            log.step(1, mean=float(values[:, 0].mean()))
            log.save(1, {"values": values})
        else:
            values = kept[1]["values"]
        self._values, self._face = values.to(device), mesh.face.to(device)

    def transfer(self, gbuffer: GBuffer) -> Float[Tensor, "N K"]:
        """Interpolated from the corners of the triangles.

        Raises:
            PrtError: for a G-buffer without triangles, or before ``fit`` or ``load``.
        """
        if self._values is None or self._face is None:
            raise PrtError("vertex_prt has no transfer yet; fit it or load a checkpoint first")
        found = atlas_of(gbuffer, "vertex_prt")
        return interpolate(self._values[self._face[found.triangle]], found.barycentric)

    def nbytes(self) -> int:
        """The transfer of all vertices, float32."""
        return 0 if self._values is None else 4 * self._values.numel()

    def save(self, path: Path) -> None:
        if self._values is None:
            raise PrtError("vertex_prt has no transfer to save; fit it first")
        self.save_tensors(path, {"values": self._values})

    def load(self, path: Path, task: Any, device: str) -> None:
        self._values = self.load_tensors(path, task, device)["values"]
        self._face = mesh_of(task, "vertex_prt").mesh().face.to(device)

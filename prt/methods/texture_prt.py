"""Transfer in a texture over the mesh's atlas: the baseline of Dhawal 2022, section 5 (PRT textures)."""

from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import FitLog
from prt.methods.sh_relight import ShRelight
from prt.scene.gbuffer import GBuffer
from prt.scene.lightmap_points import AtlasGBuffer
from prt.scene.texture_lookup import bilinear


class TexturePrt(ShRelight):
    """The method; settings as in ``conf/method/texture_prt.yaml``. Its size is the task's ``texels``."""

    _texels: Tensor | None = None  # (T, K)
    _size: tuple[int, int] = (0, 0)

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Take the task's texture of transfer.

        Raises:
            PrtError: for a surface without an atlas.
        """
        self.prepare(task, device)
        log.resume()
        log.start(1, "texture_prt")
        size, texels = mesh_of(task, "texture_prt").size, task.texture(seed).to(device)
        self._texels, self._size = texels, size
        log.step(1, mean=float(texels[:, 0].mean()))
        log.save(1, {})

    def transfer(self, gbuffer: GBuffer) -> Float[Tensor, "N K"]:
        """Bilinear lookups at the G-buffer's places in the atlas.

        Raises:
            PrtError: for a G-buffer without such places, or before ``fit`` or ``load``.
        """
        if self._texels is None:
            raise PrtError("texture_prt has no transfer yet; fit it or load a checkpoint first")
        return bilinear(self._texels, self._size, atlas_of(gbuffer, "texture_prt").uv)

    def nbytes(self) -> int:
        """The texture, float32, its empty texels included."""
        return 0 if self._texels is None else 4 * self._texels.numel()

    def save(self, path: Path) -> None:
        if self._texels is None:
            raise PrtError("texture_prt has no transfer to save; fit it first")
        self.save_tensors(path, {"texels": self._texels, "size": torch.tensor(self._size)})

    def load(self, path: Path, task: Any, device: str) -> None:
        state = self.load_tensors(path, task, device)
        height, width = (int(part) for part in state["size"])
        self._texels, self._size = state["texels"], (height, width)


def mesh_of(task: Any, method: str) -> Any:
    """The mesh asset of the task's surface.

    Raises:
        PrtError: for a surface that is none, such as a signed distance field.
    """
    asset = getattr(task.surface, "asset", None)
    if asset is None or not getattr(task, "texels", 1):
        raise PrtError(
            f"method={method} stores transfer on a mesh, and scene={task.scene.name} has none, or "
            "task.texels=0; take method=learnt_sh, irradiance_volume or cast_prt"
        )
    return asset


def atlas_of(gbuffer: GBuffer, method: str) -> AtlasGBuffer:
    """The G-buffer, if it knows triangles and places in the atlas.

    Raises:
        PrtError: if not.
    """
    if not isinstance(gbuffer, AtlasGBuffer):
        raise PrtError(f"{method} needs a G-buffer of the task's mesh (MeshSurface.capture)")
    return gbuffer

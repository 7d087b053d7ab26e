"""Classical precomputed radiance transfer: spherical harmonics per vertex (Sloan, Kautz and Snyder 2002).

The comparison of Belcour 2022, section 6.4 and figure 12: lighting of few bands, transfer vectors at the
vertices, so that light leaks behind objects and what a triangle shows is interpolated from its corners.
"""

import math
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.light.local import LightRig
from prt.light.sh import project, sh_basis
from prt.methods.base import Component, FitLog
from prt.scene.asset import scaled_albedo
from prt.scene.atlas import interpolate
from prt.scene.lightmap_points import AtlasGBuffer, TriangleMesh
from prt.trace.sh_transfer import vertex_transfer


class ShVertex:
    """The method; settings as in ``conf/method/sh_vertex.yaml``.

    Args:
        order: bands n of the lighting; ``K = n^2`` coefficients, 5 bands are the paper's 25.
        directions: rays a vertex.
        bounces: most reflections of the light before it arrives at a vertex; None: one less than the bounces
            of the scene's paths, ``max_depth``, of which one is at the vertex.
        full: predict direct light as well.
    """

    component = Component.INDIRECT
    tasks = frozenset({"local_lights"})

    def __init__(self, order: int, directions: int, bounces: int | None = None, full: bool = False):
        for name, value, most in (
            ("order", order, 16),
            ("directions", directions, 1 << 16),
            ("bounces", 1 if bounces is None else bounces, 64),
        ):
            if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= most:
                null = " or null" if name == "bounces" else ""
                raise PrtError(f"method.{name}={value!r} must be a whole number from 1 to {most}{null}")
        self.order, self.directions, self.bounces = order, directions, bounces
        self.component = Component.FULL if full else Component.INDIRECT
        self._direct: Float[Tensor, "V K"] | None = None
        self._interreflected: Float[Tensor, "V K 3"] | None = None
        self._shown: Float[Tensor, "V K 3"] = torch.empty(0)
        self._face: Int[Tensor, "F 3"] | None = None

    # ---- fitting

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Trace the transfer of every vertex; ``seed`` turns the directions.

        Raises:
            PrtError: for an asset that moves, is not made of triangles or has a medium inside.
        """
        face = _static_mesh(task.asset).face
        kept = log.resume()
        log.start(1, "sh_vertex")
        if kept is not None:
            self._take(kept[1]["direct"], kept[1]["interreflected"], face, device)
            return
        bounces = task.asset.scene.max_depth - 1 if self.bounces is None else self.bounces
        direct, interreflected = vertex_transfer(task.asset, self.order, self.directions, bounces, seed)
        # under the constant lighting of radiance 1, whose one coefficient is sqrt(4 pi)
        means = [float(values[:, 0].mean()) * math.sqrt(4 * math.pi) for values in (direct, interreflected)]
        log.step(1, direct=means[0], interreflected=means[1])
        log.save(1, {"direct": direct, "interreflected": interreflected})
        self._take(direct, interreflected, face, device)

    def _take(self, direct: Tensor, interreflected: Tensor, face: Tensor, device: str) -> None:
        self._direct, self._interreflected = direct.to(device), interreflected.to(device)
        self._face = face.to(device)
        # what a frame reads: with ``full`` one transfer of both, summed once
        full = self.component is Component.FULL
        self._shown = self._interreflected + self._direct[..., None] if full else self._interreflected

    # ---- rendering

    def light(self, lighting: LightRig) -> Float[Tensor, "K 3"]:
        """Coefficients of the environment and the directional lights, each of those a delta distribution.

        Raises:
            PrtError: for lights at a finite distance, or before ``fit`` or ``load``.
        """
        face = self._fitted()[2]
        total = torch.zeros((self.order**2, 3))
        if lighting.environment is not None:
            total += project(lighting.environment.float().cpu(), self.order - 1)
        for light in lighting.lights:
            if light.kind != "directional":
                raise PrtError(
                    f"method sh_vertex cannot be lit by a {light.kind} light: spherical harmonics hold "
                    "distant light only, directional lights and environments; set lighting=directional or "
                    "lighting=environments, or take method=svd_transfer"
                )
            towards = -torch.tensor([light.direction], dtype=torch.float32)
            towards = torch.nn.functional.normalize(towards, dim=1)
            total += sh_basis(towards, self.order - 1).T * torch.tensor(light.color)
        return total.to(face.device)

    def shade(
        self, gbuffer: AtlasGBuffer, code: Float[Tensor, "K 3"], v: Tensor | None = None
    ) -> Float[Tensor, "N 3"]:
        """Indirect radiance, with ``full`` direct too, interpolated from the vertices; it may ring below 0.

        Raises:
            PrtError: for a G-buffer without triangles, or before ``fit`` or ``load``.
        """
        self._fitted()
        # the channels as columns of a block matrix: one product that reads the transfer once, as it lies
        K = len(code)
        block = (code[:, :, None] * torch.eye(3, device=code.device)).reshape(3 * K, 3)
        return self._interpolated(gbuffer, self._shown.flatten(1) @ block)

    def direct(self, gbuffer: AtlasGBuffer, code: Float[Tensor, "K 3"]) -> Float[Tensor, "N 3"]:
        """Direct radiance in the same way: its blurred shadows are the light leaking of figure 12.

        Raises:
            PrtError: as :meth:`shade`.
        """
        return self._interpolated(gbuffer, self._fitted()[0] @ code)

    def _interpolated(self, gbuffer: AtlasGBuffer, colour: Float[Tensor, "V 3"]) -> Float[Tensor, "N 3"]:
        if not isinstance(gbuffer, AtlasGBuffer):
            raise PrtError("sh_vertex needs a G-buffer of its asset (Asset.capture), with triangles")
        corners = self._fitted()[2][gbuffer.triangle]
        return scaled_albedo(gbuffer) * interpolate(colour[corners], gbuffer.barycentric)

    def _fitted(self) -> tuple[Tensor, Tensor, Tensor]:
        """Direct transfer, interreflected transfer, faces."""
        if self._direct is None or self._interreflected is None or self._face is None:
            raise PrtError("sh_vertex has no transfer yet; fit it or load a checkpoint first")
        return self._direct, self._interreflected, self._face

    # ---- storage

    def nbytes(self) -> int:
        """The transfer that a frame reads, float32; the direct one is kept for :meth:`direct` alone."""
        self._fitted()
        return 4 * self._shown.numel()

    def save(self, path: Path) -> None:
        direct, interreflected, _ = self._fitted()
        tensors = {"direct": direct, "interreflected": interreflected}
        save_file({name: value.cpu().contiguous() for name, value in tensors.items()}, path)

    def load(self, path: Path, task: Any, device: str) -> None:
        """Read it back.

        Raises:
            PrtError: where the model was fitted to another mesh, or with another number of bands.
        """
        state, mesh = load_file(path), _static_mesh(task.asset)
        vertices, K = state["direct"].shape
        if K != self.order**2:
            raise PrtError(
                f"the model has {K} coefficients, method.order={self.order} means {self.order**2}; "
                f"set method.order={math.isqrt(K)}"
            )
        if vertices != len(mesh.position):
            raise PrtError(
                f"the model has {vertices} vertices, the asset {len(mesh.position)}; "
                "set scene to what the model was fitted to"
            )
        self._take(state["direct"], state["interreflected"], mesh.face, device)


def _static_mesh(asset: Any) -> TriangleMesh:
    """The mesh of an asset that this method can do, or an error that says why it cannot."""
    if asset.poses > 1:
        raise PrtError(
            f"method sh_vertex precomputes one pose and the asset has {asset.poses}; choose a scene that "
            "does not move, or method=svd_transfer"
        )
    if not hasattr(asset, "mesh"):
        raise PrtError(
            "method sh_vertex needs an asset made of triangles, which this one (hair) is not; choose another "
            "scene, or method=svd_transfer"
        )
    if asset.stores != "incident":
        raise PrtError(
            "method sh_vertex needs an asset that reflects light at its surface, and light passes through "
            "this one's; choose another scene, or method=svd_transfer"
        )
    return asset.mesh(0)

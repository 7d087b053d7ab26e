"""Data-driven transfer by SVD (Belcour et al. 2022): indirect light from a few measurements of direct."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.light.local import LightRig
from prt.methods.base import Component, FitLog
from prt.methods.lightmap_blend import Blender
from prt.methods.svd_basis import (
    NORMS,
    Pairs,
    Vectors,
    error_curve,
    extract,
    norm_of,
    normalised,
    transfer_matrix,
)
from prt.scene.asset import scaled_albedo
from prt.scene.lightmap_points import AtlasGBuffer
from prt.trace.measure import Meter

CHANNELS = ("shared", "interleaved", "separate")
KEYFRAMES = ("shared", "separate")
RENDERERS = ("torch", "shader")
AUTO = "auto"


class SvdTransfer:
    """The method; settings as in ``conf/method/svd_transfer.yaml``.

    Args:
        basis: elements, the mean included (section 4.2), or ``auto``: the fewest whose error on held-out
            configurations is at most ``target_error``.
        target_error: root mean square error over that of the indirect light, for ``auto``.
        held_out: share of the training configurations (the last ones) that ``auto`` judges on; with a number
            of elements given it only draws the curve, and all configurations are used.
        points: measurements of direct light; ``supersample`` points are averaged for each (section 5.1).
        regularisation: lambda of Eq. 14 for direct vectors of unit norm; null or 0: pseudo-inverse (Eq. 13).
        channels: ``shared``, one basis for the three channels as separate vectors, a transfer matrix each
            (the paper's choice, section 5.2); ``interleaved``, colours are part of the basis and there is
            one matrix; ``separate``, a basis per channel.
        gamma: direct and indirect light to the power 1 / gamma before, back after (section 5.3); 1: linear.
        normalise: each pair is divided by a norm of its direct light: ``l2`` (section 4.2), ``l1``, ``none``.
            The indirect light follows the sum of the direct, which is the l1 norm: a small bright spot has a
            large l2 norm and little of it. With l1 the weight of the mean is linear in direct light as well.
        keyframes: of an animated asset: one transfer matrix for all, or ``separate`` ones (section 5.4).
        renderer: ``torch``, or ``shader``, a GLSL fragment shader (four elements a texture).
    """

    component = Component.INDIRECT
    tasks = frozenset({"local_lights"})

    def __init__(
        self, basis: int | str, target_error: float, held_out: float, points: int, supersample: int,
        regularisation: float | None, channels: str, gamma: float, normalise: str, keyframes: str,
        renderer: str,
    ):  # fmt: skip
        whole = isinstance(basis, int) and not isinstance(basis, bool) and basis >= 1
        if not (whole or basis == AUTO):
            raise PrtError(f"method.basis={basis!r} must be a whole number of at least 1, or auto")
        for name, value, allowed in (("channels", channels, CHANNELS), ("keyframes", keyframes, KEYFRAMES),
                                     ("normalise", normalise, NORMS),
                                     ("renderer", renderer, RENDERERS)):  # fmt: skip
            if value not in allowed:
                raise PrtError(f"method.{name}={value!r} is not one of {', '.join(allowed)}")
        if regularisation is not None and not 0 <= regularisation < math.inf:
            raise PrtError(
                f"method.regularisation={regularisation} must be at least 0, or null (lambda of Eq. 14)"
            )
        if not 0.1 <= gamma <= 10:
            raise PrtError(f"method.gamma={gamma} must lie between 0.1 and 10; 1 is linear, 2.2 the usual")
        if not 0 < held_out < 1 or not 0 < target_error:
            raise PrtError(
                f"method.held_out={held_out} must lie between 0 and 1, method.target_error={target_error} "
                "above 0"
            )
        self.wanted, self.target_error, self.held_out = basis, float(target_error), float(held_out)
        self.points, self.supersample = points, supersample
        self.regularisation, self.channels, self.gamma = regularisation, channels, float(gamma)
        self.normalise, self.keyframes, self.renderer = normalise, keyframes, renderer
        self.meter: Any = None  # a Meter
        self.basis: Any = None  # (n, H, W, C)
        self.transfer: Any = None  # (keyframes, B, M, n - 1)
        self.asset: Any = None
        self.spectrum: list[Tensor] = []  # eigenvalues of each group of vectors, after fit
        self._blender: Blender | None = None
        self._shader: Any = None
        self._shown: AtlasGBuffer | None = None  # what the shader's G-buffer holds
        self._device = "cpu"

    # ---- fitting

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Basis and transfer matrix of the task's database; ``seed`` places the measurement points."""
        self._take(task, seed, device)
        database = task.database()
        count = len(database.rigs)
        if self.wanted != AUTO and self.wanted > count:
            raise PrtError(
                f"method.basis={self.wanted} is more elements than the {count} configurations baked; lower "
                f"it or raise task.train_count"
            )
        direct = torch.stack([self.meter(rig) for rig in database.rigs])
        direct, indirect = self._encoded(direct), self._encoded(database.lightmaps)
        poses = torch.tensor([rig.pose for rig in database.rigs])
        elements = self._elements(direct, indirect, log, count)
        self.spectrum = []
        images, matrices = [], []
        for group in self._groups(direct, indirect):
            pairs = normalised(group.direct, group.indirect, self.normalise)
            whole = extract(pairs.indirect)
            self.spectrum.append(whole.eigenvalues)
            kept = min(elements - 1, len(whole.vectors))
            texels = torch.zeros((elements, pairs.indirect.shape[1]))
            texels[0], texels[1 : kept + 1] = whole.mean, whole.vectors[:kept]
            images.append(texels)
            coefficients = whole.coefficients[:, :kept]
            matrices += self._transfers(pairs, coefficients, group, poses, elements - 1)
        height, width = database.size
        maps = [self._to_image(texels, database.fill, height, width) for texels in images]
        self.basis = torch.cat(maps, dim=3)  # (n, H, W, C)
        self.transfer = torch.stack(matrices, dim=1).float()  # (keyframes, B, M, n - 1)
        log.save(1, {"elements": elements})
        self._ready()

    def _take(self, task: Any, seed: int, device: str) -> None:
        self.asset, self._device = task.asset, device
        self.meter = Meter(task.asset, self.points, self.supersample, seed)

    def _encoded(self, values: Tensor) -> Tensor:
        """Gamma correction (section 5.3)."""
        return values if self.gamma == 1 else values.clamp_min(0) ** (1 / self.gamma)

    def _groups(self, direct: Float[Tensor, "N M 3"], indirect: Float[Tensor, "N T 3"]) -> list[Vectors]:
        """The vectors that one basis is made of, for each basis.

        With ``shared`` the channels are vectors of one basis but keep a transfer matrix each ("we have to
        perform a transfer matrix multiplication per color channel", section 5.2): what a red wall or a
        medium does with light differs from channel to channel, and its direct light does not say so.
        """
        count = len(direct)
        number = torch.arange(count)
        if self.channels == "interleaved":
            return [Vectors(direct.flatten(1), indirect.flatten(1), number, torch.zeros_like(number))]
        parts = [Vectors(direct[..., c], indirect[..., c], number, torch.full((count,), c)) for c in range(3)]
        return parts if self.channels == "separate" else [Vectors.joined(parts)]

    def _transfers(
        self, pairs: Pairs, coefficients: Tensor, group: Vectors, poses: Tensor, columns: int
    ) -> list[Tensor]:
        """For each channel of the group, a matrix (M, columns) for all keyframes or one per keyframe.

        Columns beyond the rank are 0, and so is the matrix of a channel that was never lit.
        """
        channel, pose = group.channel[pairs.row], poses[group.configuration[pairs.row]]
        own = self.keyframes == "separate" and self.asset.poses > 1
        found = []
        for c in group.channel.unique():
            matrices = []
            for keyframe in range(self.asset.poses if own else 1):
                rows = (channel == c) & ((pose == keyframe) if own else True)
                if own and not bool(rows.any()):
                    raise PrtError(
                        f"no training configuration lights keyframe {keyframe}; raise task.train_count, "
                        "lower scene.keyframes or use method.keyframes=shared"
                    )
                matrix = torch.zeros((pairs.direct.shape[1], columns), dtype=torch.float64)
                if bool(rows.any()):
                    matrix[:, : coefficients.shape[1]] = transfer_matrix(
                        pairs.direct[rows], coefficients[rows], self.regularisation
                    )
                matrices.append(matrix)
            found.append(torch.stack(matrices))
        return found

    def _elements(self, direct: Tensor, indirect: Tensor, log: FitLog, count: int) -> int:
        """The given number, or the smallest that meets the target on held-out configurations.

        Either way the curve of error over elements goes into the log: it is what justifies the number.
        """
        held = max(1, round(self.held_out * count))
        if held >= count:
            if self.wanted == AUTO:
                raise PrtError(
                    f"method.basis=auto needs configurations to hold out, but only {count} are baked; give "
                    "a number or raise task.train_count"
                )
            log.start(1, "svd_transfer")
            log.step(1, elements=float(self.wanted))
            return int(self.wanted)
        curves = []
        trained = self._groups(direct[:-held], indirect[:-held])
        unseen = self._groups(direct[-held:], indirect[-held:])
        for group, new in zip(trained, unseen, strict=True):
            pairs = normalised(group.direct, group.indirect, self.normalise)
            judged = normalised(new.direct, new.indirect, self.normalise)
            basis = extract(pairs.indirect)
            for c in group.channel.unique():
                rows = group.channel[pairs.row] == c
                transfer = transfer_matrix(pairs.direct[rows], basis.coefficients[rows], self.regularisation)
                part = judged.part(new.channel[judged.row] == c)
                curves.append(error_curve(basis, transfer, part))
        length = min(min(len(error) for error, _ in curves), count - held)
        error = torch.stack([e[:length] for e, _ in curves]).square().mean(0).sqrt()
        bound = torch.stack([b[:length] for _, b in curves]).square().mean(0).sqrt()
        log.start(length, "svd_transfer")
        for n in range(length):
            log.step(n + 1, held_out_error=float(error[n]), bound=float(bound[n]))
        if self.wanted != AUTO:
            return int(self.wanted)
        enough = (error <= self.target_error).nonzero()
        if len(enough) == 0:
            best = int(error.argmin())
            raise PrtError(
                f"method.target_error={self.target_error:g} is not met: the least error on held-out "
                f"configurations is {float(error[best]):.3g} at {best + 1} elements; raise it, or "
                "task.train_count, or method.points"
            )
        return int(enough[0]) + 1

    def _to_image(self, texels: Tensor, fill: Tensor, height: int, width: int) -> Tensor:
        """(n, C) covered texels as (n, H, W, channels), seams padded."""
        channels = 3 if self.channels == "interleaved" else 1
        values = texels.view(len(texels), -1, channels)
        return values[:, fill].view(len(texels), height, width, channels)

    def _ready(self) -> None:
        self.basis, self.transfer = self.basis.to(self._device), self.transfer.to(self._device)
        self._blender, self._shader = Blender(self.basis), None

    # ---- run time (section 4.3)

    def light(self, lighting: LightRig) -> Float[Tensor, "n 3"]:
        """Measure direct light, transfer it to the coefficients of the basis.

        Raises:
            PrtError: for a keyframe the asset does not have.
        """
        if not 0 <= lighting.pose < self.asset.poses:
            raise PrtError(f"the asset has keyframes 0 to {self.asset.poses - 1}, not {lighting.pose}")
        return self.coefficients(self.measure(lighting), lighting.pose)

    def measure(self, rig: LightRig) -> Float[Tensor, "M 3"]:
        """The direct vector: shading of the fake G-buffer."""
        return self.meter(rig).to(self._device)

    def coefficients(self, direct: Float[Tensor, "M 3"], pose: int = 0) -> Float[Tensor, "n 3"]:
        """u = M_n x (Eq. 10), below the weight of the mean."""
        direct = self._encoded(direct)
        matrix = self.transfer[min(pose, len(self.transfer) - 1)]
        if self.channels == "interleaved":
            vector = direct.flatten()
            norm = norm_of(vector[None], self.normalise)
            return torch.cat([norm, vector @ matrix[0]])[:, None].expand(-1, 3)
        norm = norm_of(direct.T, self.normalise)
        return torch.cat([norm[None], torch.einsum("bmk,mb->kb", matrix, direct)])

    def shade(
        self, gbuffer: AtlasGBuffer, code: Float[Tensor, "n 3"], v: Tensor | None = None
    ) -> Float[Tensor, "N 3"]:
        """Blend the basis at the points' places in the lightmap.

        Raises:
            PrtError: for a G-buffer without places in a lightmap, or before ``fit`` or ``load``.
        """
        if self._blender is None:
            raise PrtError("svd_transfer has no basis yet; fit it or load a checkpoint first")
        if not isinstance(gbuffer, AtlasGBuffer):
            raise PrtError("svd_transfer needs a G-buffer of its asset (Asset.capture), with lightmap places")
        if self.renderer == "shader":
            return self._shade_on_screen(gbuffer, code)
        return self.scale(gbuffer) * self._blender.blend(code, gbuffer.uv, self.gamma)

    def scale(self, gbuffer: AtlasGBuffer) -> Float[Tensor, "N 3"]:
        """What the lightmap's values are multiplied by."""
        return scaled_albedo(gbuffer) if self.asset.stores == "incident" else torch.ones_like(gbuffer.diffuse)

    def _shade_on_screen(self, gbuffer: AtlasGBuffer, code: Tensor) -> Tensor:
        shader = self.shader()
        if self._shown is not gbuffer:
            shader.set_gbuffer(gbuffer, self.scale(gbuffer), torch.zeros_like(gbuffer.diffuse))
            self._shown = gbuffer
        image = shader.render(code.cpu())
        return image.reshape(-1, 3)[gbuffer.hit.cpu()]

    def shader(self) -> Any:
        """The basis as textures of a fragment shader, made on first use.

        Raises:
            PrtError: where there is no OpenGL.
        """
        from prt.methods.blend_shader import BlendShader

        if self._shader is None:
            self._shader, self._shown = BlendShader(self.basis.cpu(), self.gamma), None
        return self._shader

    def timed_parts(self, lighting: LightRig, gbuffer: AtlasGBuffer) -> dict[str, Callable[[], Any]]:
        """The three parts of Table 1."""
        direct = self.measure(lighting)
        code = self.coefficients(direct, lighting.pose)
        return {
            "measure": lambda: self.measure(lighting),
            "transfer": lambda: self.coefficients(direct, lighting.pose),
            "blend": lambda: self.shade(gbuffer, code),
        }

    # ---- what the basis alone can do

    def project(self, indirect: Float[Tensor, "C 3"], lighting: LightRig) -> Float[Tensor, "C 3"]:
        """Covered texels of a known lightmap projected into the basis (Figure 14, dashed)."""
        covered = self.asset.covered
        basis = self.basis.cpu().flatten(1, 2)[:, covered]  # (n, C, channels)
        norms = self.coefficients(self.measure(lighting), lighting.pose)[0].cpu()  # weights of the mean
        values = self._encoded(indirect)
        if self.channels == "interleaved":
            flat = basis.flatten(1)
            left = values.flatten() - norms[0] * flat[0]
            found = (norms[0] * flat[0] + (flat[1:] @ left) @ flat[1:]).view_as(values)
        else:
            columns = []
            for c in range(3):
                own = basis[..., c if self.channels == "separate" else 0]
                left = values[:, c] - norms[c] * own[0]
                columns.append(norms[c] * own[0] + (own[1:] @ left) @ own[1:])
            found = torch.stack(columns, dim=1)
        return found if self.gamma == 1 else found.clamp_min(0) ** self.gamma

    # ---- storage

    def nbytes(self) -> int:
        """Basis, transfer matrices and the fake G-buffer, float32."""
        return 4 * (self.basis.numel() + self.transfer.numel()) + self.meter.nbytes

    def save(self, path: Path) -> None:
        state = {"basis": self.basis.cpu().contiguous(), "transfer": self.transfer.cpu().contiguous()}
        save_file(state | {"seed": torch.tensor(self.meter.seed)}, path)

    def load(self, path: Path, task: Any, device: str) -> None:
        state = load_file(path)
        self._take(task, int(state["seed"]), device)
        self.basis, self.transfer = state["basis"], state["transfer"]
        height, width = task.asset.size
        if self.basis.shape[1:3] != (height, width):
            raise PrtError(
                f"the model's lightmap has {tuple(self.basis.shape[1:3])} texels, the asset's "
                f"{(height, width)}; set task.texels as it was when the model was fitted"
            )
        self._ready()

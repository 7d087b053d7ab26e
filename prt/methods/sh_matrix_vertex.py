"""Classical glossy transfer with interreflection: a matrix of harmonics per vertex (Sloan et al. 2002).

What Raghavan 2023, table 6 and figure 7, holds its hash grid against: harmonics "with a maximum degree of 8
stored on mesh vertices". A vertex knows, for each harmonic of the lighting, which indirect light arrives at
it from where; a pixel interpolates that from the corners of its triangle, and what it sends on is the
integral with the cosine about its normal (diffuse) and with its GGX lobe about the reflected direction
(glossy). 81 coefficients hold no sharp reflection and no caustic of a small light, and ring where light
changes fast.
"""

import json
import math
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.light.glossy_lobe import cosine_bands, lobe_above, lobe_bands, lobe_reflectance
from prt.light.sh import project, sh_basis
from prt.light.sh_products import band_of, window
from prt.methods.base import Component, FitLog, check_lighting
from prt.scene.gbuffer import GBuffer
from prt.scene.mesh_places import MeshPlaces
from prt.scene.subdivide import fine_mesh
from prt.scene.thinned import thinned
from prt.trace.record import prior_sampler
from prt.trace.sh_transfer import vertex_origins
from prt.trace.vertex_matrices import incident_matrices

#: samples traced, pixels shaded and vertices lit at a time: bounds the memory
SAMPLES, PIXELS, VERTICES = 1 << 21, 1 << 14, 1 << 9
#: vertices of the mesh that pixels are found on; the matrices, not these, are what costs
MOST = 2_000_000


class ShMatrixVertex:
    """The method; settings as in ``conf/method/sh_matrix_vertex.yaml``.

    A matrix of degree 8 for three colours takes 39 kB in half precision, far finer than the noise of its
    paths. So not every vertex has one: of vertices closer to each other than ``spacing_pixels`` one is kept,
    and the others are interpolated from those around them, once per lighting. Scene four_animals has 49072
    vertices at ``edge_pixels=2``, of which 19523 are kept at a spacing of one training pixel: 0.77 GB, and
    the ground, the only coarse mesh of that scene, keeps every one of its own.

    Args:
        degree: largest band of lighting and of arriving light, 8 in the paper: 81 coefficients each.
        paths: traced from every vertex that is kept. Few fall into one lobe of a glossy surface: on
            four_animals 1024 leave noise of a third of the squared error, 4096 of a tenth. Those are 80
            million paths, less than wavelet_neural records there.
        edge_pixels: longest edge of a mesh in training pixels; longer ones are halved.
        spacing_pixels: between vertices that have a matrix; 0: all have one.
        window: damps the upper bands against ringing (:func:`prt.light.sh_products.window`); 0: not at all.
        memory_gb: what all matrices may take, in 10^9 bytes.

    Raises:
        PrtError: for a setting out of range.
    """

    component = Component.INDIRECT
    tasks = frozenset({"relight_indirect"})
    #: settings that a fitted model does not depend on
    rendering = frozenset({"window"})

    def __init__(
        self,
        degree: int,
        paths: int,
        edge_pixels: float,
        spacing_pixels: float,
        window: float = 0.0,
        memory_gb: float = 1.0,
    ):
        for name, value, most in (("degree", degree, 15), ("paths", paths, 1 << 20)):
            if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= most:
                raise PrtError(f"method.{name}={value!r} must be a whole number from 1 to {most}")
        for name, value, free in (
            ("edge_pixels", edge_pixels, False), ("spacing_pixels", spacing_pixels, True),
            ("window", window, True), ("memory_gb", memory_gb, False),
        ):  # fmt: skip
            number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
            if not number or value < 0 or (value == 0 and not free):
                raise PrtError(
                    f"method.{name}={value!r} must be a number {'of 0 or more' if free else 'above 0'}"
                )
        self.degree, self.paths, self.window, self.memory_gb = degree, paths, float(window), memory_gb
        self.edge_pixels, self.spacing_pixels = edge_pixels, spacing_pixels
        self.device = "cpu"
        self._matrices: Float[Tensor, "S 3 K K"] | None = None

    # ---- fitting

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Trace the matrices of the vertices that are kept; resumes between blocks of them.

        Raises:
            PrtError: for a scene that is not made of triangles, or matrices beyond ``memory_gb``.
        """
        edge = self.edge_pixels * task.pixel_size
        mesh = fine_mesh(task.scene, edge, MOST, "method.edge_pixels")
        some = thinned(mesh, self.spacing_pixels * task.pixel_size)
        self._check_size(len(some.kept))
        mi_scene = task.scene.asset(8).load(
            {}
        )  # analytic shapes as the triangles that the vertices belong to
        sampler = None
        if task.scene.record == "nee":
            sampler = prior_sampler(task.prior().view(6, task.resolution, task.resolution, 3))
        bounces = task.scene.max_depth - 1
        per_vertex = self.paths * (bounces + 1 if sampler else 1)
        blocks = some.kept.split(max(1, SAMPLES // per_vertex))
        matrices = torch.zeros((len(some.kept), 3, self.count, self.count), dtype=torch.float16)
        first, kept = 0, log.resume()
        if kept is not None:
            first, done = kept[0], kept[1]["matrices"]
            matrices[: len(done)] = done
        log.start(len(blocks), "sh_matrix_vertex")
        origin, ends = vertex_origins(mesh), torch.tensor([len(b) for b in blocks]).cumsum(0).tolist()
        for step in range(first + 1, len(blocks) + 1):
            block, end = blocks[step - 1], ends[step - 1]
            found = incident_matrices(
                mi_scene, origin[block], mesh.normal[block], self.degree, self.paths, bounces,
                task.resolution, _block_seed(seed, step), sampler,
            )  # fmt: skip
            matrices[end - len(block) : end] = found.half()
            # of constant light of radiance 1 (its coefficient is sqrt(4 pi)), the mean over the hemisphere
            log.step(step, arriving=2 * float(found[:, :, 0, 0].mean()))
            if log.checkpoint_due(step):
                log.save(step, {"matrices": matrices[:end]})
        self._take(matrices, some.rows, some.weights, MeshPlaces(mesh), edge, device)

    def _check_size(self, vertices: int) -> None:
        size = vertices * 3 * self.count**2 * 2
        if size > self.memory_gb * 1e9:
            raise PrtError(
                f"method sh_matrix_vertex: {vertices} matrices of degree {self.degree} take {size / 1e9:.3g} "
                f"GB, method.memory_gb={self.memory_gb} allows less; raise it or method.spacing_pixels, or "
                "lower method.degree"
            )

    def _take(
        self, matrices: Tensor, rows: Int[Tensor, "V C"], weights: Float[Tensor, "V C"], places: MeshPlaces,
        edge: float, device: str,
    ) -> None:  # fmt: skip
        self.device, self._places, self._edge = device, places, edge
        self._matrices, self._rows, self._weights = (part.to(device) for part in (matrices, rows, weights))

    @property
    def count(self) -> int:
        """K, coefficients of lighting and of arriving light."""
        return (self.degree + 1) ** 2

    # ---- rendering

    @torch.no_grad()
    def light(self, lighting: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "V 3K"]:
        """Coefficients of the light that arrives at every vertex of the mesh, colour after colour.

        Raises:
            PrtError: before ``fit`` or ``load``, or for a lighting that no light can be.
        """
        check_lighting(lighting)
        matrices = self._fitted()
        coefficients = project(lighting.float().to(self.device), self.degree)
        coefficients *= window(self.degree + 1, self.window).to(coefficients)[:, None]
        arriving = torch.empty(matrices.shape[:3], device=self.device)
        for start in range(0, len(matrices), VERTICES):
            rows = slice(start, start + VERTICES)
            for colour in range(3):
                arriving[rows, colour] = matrices[rows, colour].float() @ coefficients[:, colour]
        return weighted(arriving.flatten(1), self._rows, self._weights)

    @torch.no_grad()
    def shade(
        self, gbuffer: GBuffer, code: Float[Tensor, "V 3K"], v: Tensor | None = None
    ) -> Float[Tensor, "N 3"]:
        """Indirect radiance; it may ring below 0.

        Raises:
            PrtError: before ``fit`` or ``load``.
        """
        self._fitted()
        rows, weights = (part.to(self.device) for part in self._places(gbuffer))
        gbuffer = gbuffer.to(self.device)
        band = band_of(self.degree + 1).to(self.device)
        cosine = cosine_bands(self.degree + 1).to(self.device)[band]
        out = torch.empty((len(gbuffer), 3), device=self.device)
        for part in torch.arange(len(gbuffer), device=self.device).split(PIXELS):
            g = gbuffer.rows(part)
            arriving = weighted(code, rows[part], weights[part]).view(len(g), 3, self.count)
            diffuse = cosine * sh_basis(g.normal, self.degree)
            glossy = lobe_bands(g.roughness, self.degree + 1)[:, band] * sh_basis(g.wr, self.degree)
            sent = arriving @ torch.stack([diffuse, glossy], 2)
            angle = (g.normal * g.wo).sum(1).clamp(0, 1)
            above = lobe_above(g.roughness, angle, self.degree + 1)[:, None]
            reflectance = lobe_reflectance(g.specular, g.roughness, angle) / above
            out[part] = g.diffuse * sent[..., 0] + reflectance * sent[..., 1]
        return out.cpu()

    def _fitted(self) -> Float[Tensor, "S 3 K K"]:
        if self._matrices is None:
            raise PrtError("sh_matrix_vertex has no matrices yet; fit it or load a checkpoint first")
        return self._matrices

    # ---- storage

    def nbytes(self) -> int:
        """The matrices in half precision, and which of them every vertex is interpolated from."""
        parts = (self._fitted(), self._rows, self._weights)
        return sum(part.numel() * part.element_size() for part in parts)

    def save(self, path: Path) -> None:
        tensors = {"matrices": self._fitted(), "rows": self._rows, "weights": self._weights}
        save_file(
            {name: value.cpu().contiguous() for name, value in tensors.items()},
            path,
            metadata={"edge": json.dumps(self._edge)},
        )

    def load(self, path: Path, task: Any, device: str) -> None:
        """Read it back.

        Raises:
            PrtError: where the model was fitted to another scene, or with another degree.
        """
        with safe_open(path, "pt") as file:
            edge = json.loads(file.metadata()["edge"])
        state = load_file(path)
        K = state["matrices"].shape[-1]
        if self.count != K:
            raise PrtError(
                f"the model has {K} coefficients, method.degree={self.degree} means {self.count}; "
                f"set method.degree={math.isqrt(K) - 1}"
            )
        mesh = fine_mesh(task.scene, edge, MOST, "method.edge_pixels")
        if len(state["rows"]) != len(mesh.position):
            raise PrtError(
                f"the model has {len(state['rows'])} vertices, the scene {len(mesh.position)}; "
                "set scene to what the model was fitted to"
            )
        self._take(state["matrices"], state["rows"], state["weights"], MeshPlaces(mesh), edge, device)


def weighted(
    table: Float[Tensor, "V F"], rows: Int[Tensor, "N C"], weights: Float[Tensor, "N C"]
) -> Float[Tensor, "N F"]:
    """Weighted sums of rows of a table."""
    return torch.nn.functional.embedding_bag(rows, table, mode="sum", per_sample_weights=weights)


def _block_seed(seed: int, step: int) -> int:
    """Of one block of vertices: a resumed fit goes on with the numbers it would have had."""
    return (seed * 1_000_003 + step) % (1 << 31)

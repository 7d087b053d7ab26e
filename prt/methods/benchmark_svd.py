"""Times and sizes of data-driven transfer (Belcour 2022, Table 1) and how its eigenvalues fall (Figure 3).

Called by ``prt table belcour2022/table1`` and ``belcour2022/figure3``; failures are in ``stability_svd.py``.
"""

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import torch

from prt.errors import PrtError
from prt.methods.base import Silent
from prt.methods.svd_transfer import SvdTransfer
from prt.metrics.timing import device_name, time_repeated

NAME, PLAIN = "svd_transfer", "no_indirect"


def fitted(task: Any, settings: dict[str, Any], **changes: Any) -> SvdTransfer:
    """The method with some settings changed, fitted to the task's database."""
    method = SvdTransfer(**{**settings, **changes})
    method.fit(task, Silent(), 0, "cpu")
    return method


def row(
    metric: str,
    value: float,
    variant: str = "",
    method: str = NAME,
    device: str = "",
    hi: float | None = None,
) -> dict[str, Any]:
    """A row of ``results.csv`` without interval, except an upper one (95th percentile) where given.

    Times and sizes are of the whole method, all else is of indirect light.
    """
    component = "" if metric.startswith(("time/", "bytes/")) else "indirect"
    found = {"method": method, "device": device, "variant": variant, "metric": metric}
    found["component"] = component
    return {**found, "value": float(value), "lo": None, "hi": hi, "n": 1}


def eigenvalues(task: Any, method: dict[str, Any], count: int = 128) -> list[dict[str, Any]]:
    """Figure 3: eigenvalues of the Gram matrix of the indirect vectors over the largest one."""
    model = fitted(task, method, basis=1)
    values = model.spectrum[0]
    values = values[:count] / values[0]
    return [row("eigenvalue/relative", v, f"element={i + 1}") for i, v in enumerate(values.tolist())]


def capacity(task: Any, method: dict[str, Any], targets: list[float]) -> list[dict[str, Any]]:
    """Error on held-out configurations against the number of elements, and what ``basis=auto`` chooses.

    ``basis/chosen`` is the smallest number whose error meets the target; missing where none does.
    """
    curve: dict[int, dict[str, float]] = {}

    class Curve(Silent):
        def step(self, step: int, **values: float) -> None:
            curve[step] = values

    SvdTransfer(**{**method, "basis": 1}).fit(task, Curve(), 0, "cpu")
    rows = []
    for step, values in curve.items():
        rows.append(row("error/held_out", values["held_out_error"], f"basis={step}"))
        rows.append(row("error/bound", values["bound"], f"basis={step}"))
    for target in targets:
        try:
            model = fitted(task, method, basis="auto", target_error=target)
        except PrtError:  # not met by any number: the curve shows why
            continue
        rows.append(row("basis/chosen", len(model.basis), f"target={target:g}"))
        rows.append(row("bytes/model", model.nbytes(), f"target={target:g}"))
    return rows


def table1(
    task: Any, method: dict[str, Any], basis: list[int], repetitions: int = 30, paper_size: int = 1024,
    paper_points: int = 256,
) -> list[dict[str, Any]]:  # fmt: skip
    """Table 1: a frame with and without indirect light, its parts, bake time, and storage.

    ``time/frame`` is the fragment shader (deferred: G-buffer in textures, one pass, no read-back);
    ``no_indirect`` is the same pass without the lightmap. ``bytes/basis`` and ``bytes/transfer`` are those of
    the model; ``variant`` with ``paper_size`` of one of the paper's size, by formula and as a written file.

    Raises:
        PrtError: where there is no OpenGL, or more elements than configurations.
    """
    from prt.methods.blend_shader import available
    from prt.methods.blend_shader import device_name as renderer_name

    problem = available()
    if problem:
        raise PrtError(problem)
    if max(basis) > task.train_count:
        raise PrtError(f"benchmark.basis={basis}: only {task.train_count} configurations are baked")
    item, rows = task.timed_item(), []
    cpu = f"{device_name()}, {torch.get_num_threads()} threads"
    gpu = ""
    for number, elements in enumerate(basis):
        model = fitted(task, method, basis=elements)
        variant = f"basis={elements}"
        code = model.light(item.lighting)
        with model.shader() as shader:
            gpu = renderer_name()
            shader.set_gbuffer(
                item.gbuffer, model.scale(item.gbuffer), torch.zeros_like(item.gbuffer.diffuse)
            )

            def frame(indirect: bool, shader: Any = shader, code: Any = code) -> Any:
                return time_repeated(
                    lambda: shader.draw(code, indirect=indirect), repetitions, synchronise=shader.finish
                )

            if number == 0:
                plain = frame(False)
                rows.append(row("time/frame", plain.median, "", PLAIN, gpu, plain.p95))
            whole = frame(True)
            rows.append(row("time/frame", whole.median, variant, device=gpu, hi=whole.p95))
        for name, part in model.timed_parts(item.lighting, item.gbuffer).items():
            taken = time_repeated(part, repetitions)
            rows.append(row(f"time/{name}", taken.median, variant, device=cpu, hi=taken.p95))
        rows.append(row("bytes/basis", 4 * model.basis.numel(), variant, device=cpu))
        rows.append(row("bytes/transfer", 4 * model.transfer.numel(), variant, device=cpu))
    rows.append(row("time/bake", task.database().seconds, device=cpu))
    return rows + storage(16, paper_size, paper_points)


@dataclasses.dataclass(frozen=True)
class Storage:
    """Bytes at run time by formula: what Belcour 2022, section 6.5, counts."""

    basis: int
    transfer: int

    @staticmethod
    def of(elements: int, height: int, width: int, points: int) -> "Storage":
        """Float32 textures of ``elements`` monochannel maps, the mean among them, and for each of the three
        channels a matrix of as many rows as there are maps to weigh, the mean not among them."""
        return Storage(4 * elements * height * width, 3 * 4 * (elements - 1) * points)


def storage(elements: int, size: int, points: int) -> list[dict[str, Any]]:
    """A model of the paper's size, by formula and by the size of a file with exactly those tensors."""
    from safetensors.torch import save_file

    formula = Storage.of(elements, size, size, points)
    variant = f"basis={elements},texels={size},points={points}"
    rows = [
        row("bytes/basis", formula.basis, variant), row("bytes/transfer", formula.transfer, variant),
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        for name, shape in (("basis", (elements, size, size, 1)), ("transfer", (3, points, elements - 1))):
            path = Path(folder) / f"{name}.safetensors"
            save_file({name: torch.zeros(shape)}, path)
            rows.append(row(f"bytes/{name}_file", path.stat().st_size, variant))
    return rows

"""Where data-driven transfer fails (Belcour 2022, sections 4.3, 5.1, 6.1, 7), measured on one baked asset.

Called by ``prt table belcour2022/stability``. Errors are root mean squares over test lightmaps divided by
that of the references; every figure is a row of its own, ``variant`` names what was varied.
"""

import dataclasses
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.local import LightRig
from prt.methods.base import Silent
from prt.methods.benchmark_svd import fitted, row
from prt.methods.svd_basis import condition, normalised
from prt.methods.svd_transfer import SvdTransfer
from prt.scene.lightmap_points import MeasurePoints
from prt.trace.measure import Meter

#: how far a near-duplicate point lies from the one it repeats, in radii of the asset
NEAR = 1e-3


def measure_failures(
    task: Any, method: dict[str, Any], lambdas: list[float], duplicates: list[float],
    configurations: list[int], points: list[int], supersample: list[int], lights: list[str],
    brighter: list[float],
) -> list[dict[str, Any]]:  # fmt: skip
    """All failure experiments on one asset.

    Args:
        lambdas: regularisations; 0 is the pseudo-inverse.
        duplicates: shares of the points that repeat another one.
        configurations: numbers of baked configurations.
        points, supersample: measurements, and points averaged for each, for flicker and aliasing.
        lights: splits of the scenario to test under.
        brighter: factors on the intensity of the test lights.
    """
    rows = regularised(task, method, lambdas, duplicates)
    rows += few_configurations(task, method, configurations)
    rows += few_points(task, method, points, supersample)
    return rows + other_lights(task, method, lights, brighter)


def regularised(
    task: Any, method: dict[str, Any], lambdas: list[float], duplicates: list[float]
) -> list[dict[str, Any]]:
    """Near-duplicate points: condition number, error and negative texels against lambda."""
    rows = []
    for share in duplicates:
        for value in lambdas:
            model = with_duplicates(task, method, share, value)
            variant = f"duplicates={share:g},lambda={value:g}"
            direct = torch.stack([model.measure(rig) for rig in task.database().rigs])
            pairs = normalised(direct.flatten(1), direct.flatten(1))
            error, negative = judged(task, model, "same")
            rows += [
                row("condition/direct", condition(pairs.direct, value), variant),
                row("error/relative", error, variant), row("negative/share", negative, variant),
            ]  # fmt: skip
    return rows


class Repeating(Meter):
    """A meter, the first ``share`` of whose points repeat the last ones, a little moved."""

    share = 0.0

    def points(self, pose: int = 0) -> MeasurePoints:
        """Points of the asset with the first ones put beside others."""
        found = super().points(pose)
        count = round(self.share * len(found.position))
        if count == 0:
            return found
        moved = dataclasses.replace(
            found, position=found.position.clone(), normal=found.normal.clone(), albedo=found.albedo.clone()
        )
        # whole groups are repeated, so that measurements and not only samples are alike
        order = found.group.argsort(stable=True)
        to, of = order[:count], order[-count:]
        shift = torch.randn((count, 3), generator=torch.Generator().manual_seed(0))
        shift -= (shift * found.normal[of]).sum(1, keepdim=True) * found.normal[of]
        moved.position[to] = found.position[of] + NEAR * self.asset.radius * shift
        moved.normal[to], moved.albedo[to] = found.normal[of], found.albedo[of]
        return moved


class WithDuplicates(SvdTransfer):
    """The method with a share of its points near-duplicates of others."""

    share = 0.0

    def _take(self, task: Any, seed: int, device: str) -> None:
        super()._take(task, seed, device)
        self.meter = Repeating(task.asset, self.points, self.supersample, seed)
        self.meter.share = self.share


def with_duplicates(task: Any, method: dict[str, Any], share: float, value: float) -> SvdTransfer:
    """The method with a share of its points near-duplicates, and with this lambda, fitted.

    Raises:
        PrtError: for a share that leaves fewer points than it repeats.
    """
    if not 0 <= share <= 0.5:
        raise PrtError(f"benchmark.duplicates={share} must lie between 0 and 0.5")
    model = WithDuplicates(**{**method, "regularisation": value})
    model.share = share
    model.fit(task, Silent(), 0, "cpu")
    return model


def few_configurations(task: Any, method: dict[str, Any], configurations: list[int]) -> list[dict[str, Any]]:
    """Error with fewer baked configurations, down to a single one."""
    rows = []
    for count in configurations:
        basis = min(method["basis"], count)
        model = fitted(First(task, count), method, basis=basis)
        rows.append(row("error/relative", judged(task, model, "same")[0], f"configurations={count}"))
    return rows


class First:
    """A task of which only the first configurations were baked."""

    def __init__(self, task: Any, count: int):
        self._task, self.count = task, count

    def __getattr__(self, name: str) -> Any:
        return getattr(self._task, name)

    def database(self) -> Any:
        return self._task.database(self.count)


def few_points(
    task: Any, method: dict[str, Any], points: list[int], supersample: list[int]
) -> list[dict[str, Any]]:
    """Aliasing: error under still lights, flicker as one moves slowly, with and without averaging."""
    rows = []
    path = [item for item in task.tests() if item.split == "path"]
    for many in supersample:
        for count in points:
            model = fitted(task, method, points=count, supersample=many)
            variant = f"points={count},supersample={many}"
            rows.append(row("error/relative", judged(task, model, "same")[0], variant))
            if len(path) > 1:
                rows.append(row("flicker/relative", flicker(model, path), variant))
    return rows


def flicker(model: SvdTransfer, path: list[Any]) -> float:
    """Change between consecutive frames beyond the reference's own, over the reference's root mean square."""
    predicted = torch.stack([texels(model, item) for item in path])
    truth = torch.stack([reference(item) for item in path])
    beyond = (predicted.diff(dim=0) - truth.diff(dim=0)).square().mean().sqrt()
    return float(beyond / truth.square().mean().sqrt())


def other_lights(
    task: Any, method: dict[str, Any], lights: list[str], brighter: list[float]
) -> list[dict[str, Any]]:
    """Lights of other scenarios, brighter ones, and none at all."""
    model = fitted(task, method)
    rows = []
    for split in ["same", *lights]:
        error, negative = judged(task, model, split)
        bound = bound_of(task, model, split)
        rows += [
            row("error/relative", error, f"lights={split}"), row("error/bound", bound, f"lights={split}"),
            row("negative/share", negative, f"lights={split}"),
        ]  # fmt: skip
    for factor in brighter:
        # light transport is linear: the reference of a brighter light is the brighter reference
        rows.append(row("error/relative", judged(task, model, "same", factor)[0], f"brighter={factor:g}"))
    item = next(item for item in task.tests() if item.split == "same")
    dark = model.shade(item.gbuffer, model.light(LightRig(pose=item.lighting.pose)))
    rows.append(row("error/black", float(dark.abs().max()), "lights=none"))
    return rows


def judged(task: Any, model: SvdTransfer, split: str, factor: float = 1.0) -> tuple[float, float]:
    """Relative error and share of negative texels over the lightmaps of a split.

    Raises:
        PrtError: if the task has no test lights of that name.
    """
    items = [item for item in task.tests() if item.split == split and item.view_name == "lightmap"]
    if not items:
        raise PrtError(f"benchmark.lights: the task has no test lights {split!r}; see lighting.others")
    wrong, whole, negative, count = 0.0, 0.0, 0, 0
    for item in items:
        found = texels(model, item, factor)
        truth = factor * reference(item)
        wrong += float((found - truth).double().square().sum())
        whole += float(truth.double().square().sum())
        negative += int((found < 0).any(dim=1).sum())
        count += len(found)
    return (wrong / max(whole, 1e-30)) ** 0.5, negative / count


def bound_of(task: Any, model: SvdTransfer, split: str) -> float:
    """Relative error of the references' own projection into the basis."""
    wrong, whole = 0.0, 0.0
    for item in task.tests():
        if item.split == split and item.view_name == "lightmap":
            truth = reference(item)
            wrong += float((model.project(truth, item.lighting) - truth).double().square().sum())
            whole += float(truth.double().square().sum())
    return (wrong / max(whole, 1e-30)) ** 0.5


def texels(model: SvdTransfer, item: Any, factor: float = 1.0) -> Float[Tensor, "C 3"]:
    """The method's lightmap of a test item."""
    return model.shade(item.gbuffer, model.light(item.lighting.scaled(factor)))


def reference(item: Any) -> Float[Tensor, "C 3"]:
    """Its reference."""
    return item.references["indirect"].reshape(-1, 3)[item.gbuffer.hit]

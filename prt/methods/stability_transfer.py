"""Where learnt transfer fails (Dhawal 2022 says little of it), measured one thing at a time.

Called by ``prt table dhawal2022/stability`` and the tables beside it. ``error/relative`` is the root mean
square error of transfer vectors over their root mean square, at points that were held out.
"""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.light.sh_products import window
from prt.methods.base import Silent
from prt.methods.benchmark_transfer import row
from prt.methods.learnt_sh import LearntSh, points_gbuffer
from prt.scene.lightmap_points import OFFSET
from prt.scene.mitsuba_setup import mitsuba
from prt.trace import sh_shading
from prt.trace.direct_light import direct_light
from prt.trace.surface import MeshSurface, SurfacePoints
from prt.trace.transfer import bake

#: upper edges of the bins of distance to the nearest other surface, shares of the extent; fewest points
DISTANCES, FEWEST = (0.003, 0.006, 0.012, 0.025, 0.05, 0.1, 0.2, 0.5, 1.0), 30


def fitted(task: Any, method: dict[str, Any], **changes: Any) -> LearntSh:
    """The method with some settings changed, fitted to the task's points."""
    model = LearntSh(**{**method, **changes})
    model.fit(task, Silent(), 0, "cpu")
    return model


def transfer_at(model: LearntSh, position: Tensor, normal: Tensor) -> Float[Tensor, "N K"]:
    """What the method gives at single points."""
    with torch.no_grad():
        return model.transfer(points_gbuffer(SurfacePoints(position, normal)))


def relative(found: Tensor, truth: Tensor) -> float:
    """Root mean square error over the root mean square of the truth."""
    return float((found - truth).norm() / truth.norm().clamp_min(1e-30))


def measure_failures(
    task: Any, method: dict[str, Any], off_surface: list[float], sizes: list[list[int]],
    windows: list[float], exponents: list[float],
) -> list[dict[str, Any]]:  # fmt: skip
    """All that a trained network of the scene can be asked: off the surface, wrong normals, size, ringing."""
    model = fitted(task, method)
    rows = leaving_the_surface(task, model, off_surface) + wrong_normals(task, model)
    for neurons, layers in sizes:
        small = fitted(task, method, neurons=neurons, layers=layers)
        data = task.held_out()
        error = relative(transfer_at(small, data.points.position, data.points.normal), data.transfer)
        rows.append(row("error/relative", error, f"neurons={neurons},layers={layers}"))
        rows.append(row("bytes/model", small.nbytes(), f"neurons={neurons},layers={layers}"))
    rows += ringing(task, model, windows, exponents)
    if isinstance(task.surface, MeshSurface):
        rows += near_other_surfaces(task, model)
    return rows


def leaving_the_surface(task: Any, model: LearntSh, distances: list[float]) -> list[dict[str, Any]]:
    """Points moved along their normals, shares of the extent; the truth is the transfer on the surface."""
    data = task.held_out()
    rows = []
    for distance in distances:
        moved = data.points.position + distance * task.surface.extent * data.points.normal
        error = relative(transfer_at(model, moved, data.points.normal), data.transfer)
        rows.append(row("error/relative", error, f"off_surface={distance:g}"))
    return rows


def wrong_normals(task: Any, model: LearntSh) -> list[dict[str, Any]]:
    """Normals as they should be, turned by 10 degrees, flipped, or missing (zero)."""
    data = task.held_out()
    normal = data.points.normal
    tilt = torch.randn(normal.shape, generator=torch.Generator().manual_seed(0))
    tilt = torch.nn.functional.normalize(tilt - (tilt * normal).sum(1, keepdim=True) * normal, dim=1)
    turned = np.cos(np.radians(10)) * normal + np.sin(np.radians(10)) * tilt
    kinds = {"right": normal, "tilted": turned, "flipped": -normal, "missing": 0 * normal}
    return [
        row("error/relative", relative(transfer_at(model, data.points.position, n), data.transfer),
            f"normals={name}")
        for name, n in kinds.items()
    ]  # fmt: skip


def near_other_surfaces(task: Any, model: LearntSh) -> list[dict[str, Any]]:
    """Error by the distance to the nearest other surface, in front or behind: where light leaks through.

    Points are put into bins; ``variant`` names the upper edge of each, as a share of the extent; what is
    further away than the last is in the last. ``error/leak`` is the signed error of the mean visibility:
    above zero, light where none is.
    """
    data = task.held_out()
    position, normal = data.points.position, data.points.normal
    found = transfer_at(model, position, normal)
    distance = other_surface(task.surface, position, normal) / task.surface.extent
    bins = torch.bucketize(distance, torch.tensor(DISTANCES[:-1]))
    rows = []
    for number, edge in enumerate(DISTANCES):
        part = (bins == number).nonzero()[:, 0]
        if len(part) < FEWEST:
            continue
        variant = f"distance={edge:g}"
        rows.append(row("error/relative", relative(found[part], data.transfer[part]), variant, n=len(part)))
        leak = (found[part, 0] - data.transfer[part, 0]).mean() / data.transfer[:, 0].square().mean().sqrt()
        rows.append(row("error/leak", float(leak), variant, n=len(part)))
    return rows


def other_surface(surface: MeshSurface, position: Tensor, normal: Tensor) -> Float[Tensor, "N"]:
    """Distance to the next surface along the normal or against it, whichever is nearer; twice the extent at
    most."""
    mi = mitsuba()
    scene = surface.asset.load({})
    best = torch.full((len(position),), 2 * surface.extent)
    for sign in (1.0, -1.0):
        d = sign * normal
        origin = position + 2 * OFFSET * surface.extent * d
        columns = (np.ascontiguousarray(v.numpy().T, dtype=np.float32) for v in (origin, d))
        o, along = columns
        found = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(o), mi.Vector3f(along)))
        t = torch.from_numpy(np.array(found.t).astype(np.float32))
        best = torch.minimum(best, torch.where(t.isfinite(), t, best))
    return best


def ringing(
    task: Any, model: LearntSh, windows: list[float], exponents: list[float], samples: int = 256
) -> list[dict[str, Any]]:
    """Negative radiance and error under a single bright texel, by the strength of the window.

    ``exponent=0`` in ``variant`` is the diffuse material. The truth is ray-traced under the whole light.
    """
    R = task.resolution
    light = torch.zeros((6, R, R, 3))
    light[2, R // 3, R // 3] = 6.0 * R * R  # unit mean
    gbuffer = task.tests()[0].gbuffer
    rows = []
    for exponent in exponents:
        material = "glossy" if exponent else "diffuse"
        lit = task.dressed(gbuffer, material)
        if exponent:
            lit.roughness = torch.full_like(lit.roughness, sh_shading.roughness_of(exponent))
        truth = direct_light(
            task.surface, lit.position, lit.normal, lit.wr, lit.diffuse, lit.specular,
            sh_shading.exponent_of(lit.roughness), light, samples, 1,
        )  # fmt: skip
        plain = model.light(light)
        with torch.no_grad():
            transfer = model.transfer(lit)
        for strength in windows:
            damped = window(task.order, strength)[:, None] * plain.coefficients
            image = sh_shading.shade(transfer, lit, sh_shading.ShCode.of(damped))
            variant = f"window={strength:g},exponent={exponent:g}"
            negative = float((image < 0).any(dim=1).float().mean())
            below = float(-image.clamp(max=0).sum() / image.abs().sum().clamp_min(1e-30))
            rows += [
                row("negative/share", negative, variant), row("negative/energy", below, variant),
                row("error/truth", relative(image, truth), variant),
            ]  # fmt: skip
    return rows


# ---- scenes that are cut into cells


def seams(
    task: Any, method: dict[str, Any], margins: list[float], reach: float = 0.002
) -> list[dict[str, Any]]:
    """Jumps across the boundaries of a partition, with and without a margin (section 4.4).

    At surface points no further than ``reach`` extents from a boundary, both networks are asked at the very
    same point: ``seam/transfer`` is the root mean square of their difference over that of the transfer
    there, ``seam/radiance`` the same of diffuse radiance under the first test light.

    Raises:
        PrtError: if the method's scene is not cut, or no point lies near a boundary.
    """
    if method.get("cells") is None:
        raise PrtError("method.cells is null: there are no seams; set method.cells=[x, y, z]")
    rows = []
    for margin in margins:
        model = fitted(task, method, margin=margin)
        assert model.partition is not None
        data = task.training()
        a, b, index = across(model, data.points.position, reach * task.surface.extent)
        if len(index) == 0:
            raise PrtError(f"no training point lies within benchmark.reach={reach} of a boundary; raise it")
        position, normal = data.points.position[index], data.points.normal[index]
        nets = model.networks_of()
        both = [torch.zeros_like(data.transfer[index]) for _ in range(2)]
        with torch.no_grad():
            for out, which in zip(both, (a, b), strict=True):
                for number, net in enumerate(nets):
                    mine = which == number
                    out[mine] = net(position[mine], normal[mine])
        code = model.light(task.lighting.test()[1][0])
        jump = float((both[0] - both[1]).norm() / data.transfer[index].norm())
        light = code.coefficients
        radiance = float(((both[0] - both[1]) @ light).norm() / (data.transfer[index] @ light).norm())
        found = transfer_at(model, task.held_out().points.position, task.held_out().points.normal)
        variant = f"margin={margin:g}"
        rows += [
            row("seam/transfer", jump, variant, n=len(index)),
            row("seam/radiance", radiance, variant, n=len(index)),
            row("error/relative", relative(found, task.held_out().transfer), variant),
            row("networks/used", len(nets), variant),
        ]  # fmt: skip
    return rows


def across(
    model: LearntSh, position: Float[Tensor, "N 3"], reach: float, most: int = 4000
) -> tuple[Int[Tensor, "M"], Int[Tensor, "M"], Int[Tensor, "M"]]:
    """Points near a boundary between two networks: both networks' numbers, and which points they are."""
    grid = model.partition
    assert grid is not None
    here = grid.group_of(position)
    a, b, index = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            moved = position.clone()
            moved[:, axis] += sign * reach
            there = grid.group_of(moved)
            found = (there != here).nonzero()[:, 0]
            a.append(here[found])
            b.append(there[found])
            index.append(found)
    pick = torch.randperm(len(torch.cat(index)), generator=torch.Generator().manual_seed(0))[:most]
    return torch.cat(a)[pick], torch.cat(b)[pick], torch.cat(index)[pick]


# ---- signed distance fields


def step_limits(task: Any, limits: list[int]) -> list[dict[str, Any]]:
    """Rays that meet the step limit of sphere tracing: pixels of a view, and rays of the transfer.

    No ray is lost in silence: those next to the surface count as hits, all of them are counted.

    Raises:
        PrtError: for a scene that is no signed distance field.
    """
    if isinstance(task.surface, MeshSurface):
        raise PrtError(f"scene={task.scene.name} is a mesh; step limits are of signed distance fields")
    from prt.trace.sdf_surface import SdfSurface

    view = task.scene.views("far", 1, task.size)[0]
    points = task.surface.sample(2000, 0)
    full = bake(task.surface, points.position, points.normal, task.order, 64, 0)
    whole = task.surface.capture(view)
    rows = []
    for steps in limits:
        surface = SdfSurface(task.scene, steps=steps)
        seen = surface.capture(view)
        counted = sum(count for name, count in surface.counts.items() if "exhausted" in name)
        found = bake(surface, points.position, points.normal, task.order, 64, 0)
        variant = f"steps={steps}"
        rows += [
            row("rays/exhausted", counted / len(seen.hit), variant),
            row("rays/missing", max(len(whole) - len(seen), 0) / max(len(whole), 1), variant),
            row("error/relative", relative(found, full), variant),
        ]  # fmt: skip
    return rows

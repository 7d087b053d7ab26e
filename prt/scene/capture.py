"""The G-buffer of a view: one ray through each pixel centre, materials read where it lands."""

import dataclasses
import functools
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int

from prt.errors import PrtError
from prt.scene.gbuffer import GBuffer
from prt.scene.materials import Material, evaluate
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View

#: The camera's near plane in world units; the far plane never cuts.
NEAR, FAR = 1e-3, 1e7
#: Surfaces more transparent than this (masks) are looked through, so many layers deep.
SEE_THROUGH, MAX_LAYERS = 0.5, 8


def sensor_description(view: View, spp: int = 16, seed: int = 0) -> dict[str, Any]:
    """The view as a Mitsuba sensor: pinhole, box filter, linear RGB in float32, independent sampler.

    The G-buffer of :func:`capture` sees exactly the centres of this sensor's pixels.
    """
    mi = mitsuba()
    return {
        "type": "perspective",
        "fov": view.fov,
        "fov_axis": "x",
        "near_clip": NEAR,
        "far_clip": FAR,
        "to_world": mi.ScalarTransform4f().look_at(origin=view.origin, target=view.target, up=view.up),
        "sampler": {"type": "independent", "sample_count": spp, "seed": seed},
        "film": {
            "type": "hdrfilm",
            "width": view.width,
            "height": view.height,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
    }


def camera_frame(view: View) -> Float[np.ndarray, "3 3"]:
    """Rows right, up, forward of the camera, world space, unit.

    Raises:
        PrtError: if the pose defines no camera (origin equals target, up along the line of sight, fov).
    """
    origin, target, up = (np.asarray(v, dtype=np.float64) for v in (view.origin, view.target, view.up))
    forward = target - origin
    right = np.cross(forward, up)
    if not (np.isfinite(right).all() and np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward) > 0.0):
        raise PrtError(
            f"view from {view.origin} to {view.target} with up {view.up} is no camera: origin and target "
            "must differ and up must not lie along the line of sight; choose another up"
        )
    if not 0.0 < view.fov < 180.0 or view.width < 1 or view.height < 1:
        raise PrtError(
            f"view with fov={view.fov} and size {view.width}x{view.height}: fov must lie between 0 and 180 "
            "degrees and the size must be at least 1x1"
        )
    forward /= np.linalg.norm(forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), forward])


def pixel_directions(view: View) -> Float[np.ndarray, "P 3"]:
    """Unit directions from the camera through the pixel centres, row-major, float32."""
    right, up, forward = camera_frame(view)
    x = (2 * (np.arange(view.width) + 0.5) / view.width - 1) * view.half_width
    y = (1 - 2 * (np.arange(view.height) + 0.5) / view.height) * view.half_width * view.height / view.width
    d = x[None, :, None] * right + y[:, None, None] * up + forward
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    return d.reshape(-1, 3).astype(np.float32)


def camera_rays(view: View):
    """``mi.Ray3f`` through the pixel centres, row-major; kernels stay the same from view to view."""
    mi = mitsuba()
    directions = pixel_directions(view)
    forward = camera_frame(view)[2].astype(np.float32)
    near = NEAR / (directions @ forward)[:, None]
    origins = np.asarray(view.origin, dtype=np.float32) + near * directions
    return mi.Ray3f(mi.Point3f(origins.T.copy()), mi.Vector3f(directions.T.copy()))


def capture(mi_scene, view: View) -> GBuffer:
    """The G-buffer of a view.

    Args:
        mi_scene: from ``Scene.load``, with or without an emitter.
        view: the camera; image of P = width x height pixels.

    Returns:
        CPU float32 tensors for the N pixels that hit the scene; the others are False in ``hit``. The normal
        is the shading normal (bump and normal maps included) on the viewer's side, and ``wr`` is ``wo``
        mirrored about it.

    Raises:
        PrtError: for a BSDF that is not supported, a degenerate camera, or without a vectorised variant.
    """
    import drjit as dr

    mi = mitsuba()
    if mi.variant().startswith("scalar"):
        raise PrtError("the G-buffer needs a vectorised Mitsuba variant: pip install karellen-llvm-core")
    si = first_opaque_hit(mi_scene, camera_rays(view))
    dr.eval(si)  # once: the gathers below would otherwise trace the rays again
    hit = torch.from_numpy(np.array(si.is_valid()))
    count = int(hit.sum())
    if count == 0:
        return _empty(hit, view)
    si = dr.gather(mi.SurfaceInteraction3f, si, row_numbers(hit.nonzero()[:, 0]))
    seen = surfaces(si, count, towards(view, rows_of(si.p, count)))
    return dataclasses.replace(seen, hit=hit, view=view)


def surfaces(si, count: int, wo: Float[torch.Tensor, "N 3"]) -> GBuffer:
    """The G-buffer of ``count`` valid interactions seen along ``wo``; it belongs to no image."""
    material = materials_of(si, count)
    normal, wr = mirrored(wo, rows_of(material.normal, count), rows_of(si.n, count))
    return GBuffer(
        position=rows_of(si.p, count),
        normal=normal,
        wo=wo,
        wr=wr,
        diffuse=rows_of(material.diffuse, count),
        specular=rows_of(material.specular, count),
        roughness=rows_of(material.roughness, count),
        uv=rows_of(si.uv, count),
        hit=torch.ones(count, dtype=torch.bool),
    )


def first_opaque_hit(mi_scene, ray):
    """The first surface that is not mostly transparent; mask BSDFs let the ray through elsewhere.

    Thin glass stays a surface: the light it mirrors is part of what is seen.
    """
    return looked_through(mi_scene, ray, mi_scene.ray_intersect(ray))


def looked_through(mi_scene, ray, si):
    """The same, given what the ray meets first."""
    import drjit as dr

    mi = mitsuba()
    bsdfs = {id(bsdf): bsdf for shape in mi_scene.shapes() if (bsdf := shape.bsdf()) is not None}
    masks = [
        dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))
        for bsdf in bsdfs.values()
        if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null) and bsdf.class_name() != "ThinDielectric"
    ]
    for _ in range(MAX_LAYERS if masks else 0):
        pointers = si.bsdf()
        numbers = dr.reinterpret_array(mi.UInt32, pointers)
        masked = si.is_valid() & functools.reduce(lambda a, b: a | b, (numbers == mask for mask in masks))
        transmission = dr.mean(mi.Color3f(pointers.eval_null_transmission(si, masked)))
        through = masked & (transmission > SEE_THROUGH)
        if not dr.any(through):
            break
        si = dr.select(through, mi_scene.ray_intersect(si.spawn_ray(ray.d), through), si)
    return si


def materials_of(si, count: int) -> Material:
    """Evaluate each BSDF on the hits that carry it and put the results together."""
    import drjit as dr

    mi = mitsuba()
    pointers, shapes = si.bsdf(), si.shape
    ids = np.array(dr.reinterpret_array(mi.UInt32, pointers))
    out = Material(dr.zeros(mi.Color3f, count), dr.zeros(mi.Color3f, count), dr.zeros(mi.Float, count),
                   dr.zeros(mi.Normal3f, count))  # fmt: skip
    for value in np.unique(ids):
        where = np.flatnonzero(ids == value)
        index = row_numbers(torch.from_numpy(where))
        first = int(where[0])
        part = evaluate(pointers[first], dr.gather(mi.SurfaceInteraction3f, si, index), shapes[first].id())
        for name in ("diffuse", "specular", "roughness", "normal"):
            dr.scatter(getattr(out, name), getattr(part, name), index)
    return out


def row_numbers(index: Int[torch.Tensor, "N"]):
    """Row numbers as ``mi.UInt32``.

    Copied by torch, whose memory is aligned: kernels would otherwise come in two versions, by where numpy
    happened to put an array.
    """
    return mitsuba().UInt32(index.cpu().to(torch.int32).clone())


def vectors(kind: Any, rows: Float[torch.Tensor, "N 3"]):
    """Rows as a Dr.Jit array of vectors, as ``mi.Point3f``; aligned as :func:`row_numbers`."""
    columns = rows.detach().cpu().float().unbind(1)
    return kind(*(mitsuba().Float(column.contiguous().clone()) for column in columns))


def rows_of(values, count: int) -> Float[torch.Tensor, "N C"]:
    """A Dr.Jit array of N vectors (or scalars) as a torch tensor with one row each."""
    import drjit as dr

    # column by column: a kernel that interleaves them would have N written into it, and be compiled for each
    columns = list(values) if dr.depth_v(values) > 1 else [values]
    dr.eval(columns)
    out = torch.empty((count, len(columns)))
    for number, column in enumerate(columns):
        out[:, number] = torch.from_numpy(np.array(column, dtype=np.float32))
    return out


def facing(
    view: View, position: Float[torch.Tensor, "N 3"], shading: Float[torch.Tensor, "N 3"],
    geometric: Float[torch.Tensor, "N 3"],
) -> tuple[Float[torch.Tensor, "N 3"], Float[torch.Tensor, "N 3"], Float[torch.Tensor, "N 3"]]:  # fmt: skip
    """The normal on the viewer's side, ``wo`` towards the viewer, and ``wr``, which is ``wo`` mirrored."""
    wo = towards(view, position)
    normal, wr = mirrored(wo, shading, geometric)
    return normal, wo, wr


def towards(view: View, position: Float[torch.Tensor, "N 3"]) -> Float[torch.Tensor, "N 3"]:
    """Unit directions from points to the viewer."""
    return torch.nn.functional.normalize(torch.tensor(view.origin, dtype=torch.float32) - position, dim=1)


def mirrored(
    wo: Float[torch.Tensor, "N 3"], shading: Float[torch.Tensor, "N 3"],
    geometric: Float[torch.Tensor, "N 3"],
) -> tuple[Float[torch.Tensor, "N 3"], Float[torch.Tensor, "N 3"]]:  # fmt: skip
    """The normal on the side that ``wo`` points to, and ``wo`` mirrored about it."""
    normal = _towards_viewer(shading, geometric, wo)
    cosine = (normal * wo).sum(1, keepdim=True)
    return normal, torch.nn.functional.normalize(2 * cosine * normal - wo, dim=1)


def _towards_viewer(shading, geometric, wo) -> Float[torch.Tensor, "N 3"]:
    """The shading normal on the side of the surface the viewer is on.

    The side is judged by the geometric normal: near a silhouette the interpolated normal may point away from
    a viewer who does see the front, and flipping it there would turn it inside out. It is then bent just
    until it is perpendicular to ``wo``.
    """
    # vertex normals of degenerate triangles are NaN
    shading = torch.where(shading.isfinite().all(1, keepdim=True), shading, geometric)
    sides = (geometric * wo).sum(1) * (geometric * shading).sum(1)
    normal = torch.where((sides < 0)[:, None], -shading, shading)
    behind = (normal * wo).sum(1, keepdim=True).clamp(max=0.0)
    return torch.nn.functional.normalize(normal - behind * wo, dim=1)


def _empty(hit: torch.Tensor, view: View) -> GBuffer:
    def zeros(channels):
        return torch.zeros((0, channels))

    return GBuffer(zeros(3), zeros(3), zeros(3), zeros(3), zeros(3), zeros(3), zeros(1), zeros(2), hit, view)

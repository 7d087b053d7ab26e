"""Diffuse and specular colour, roughness and shading normal of a surface, read from Mitsuba's own BSDFs.

A BSDF hands out its textures and nested BSDFs through Mitsuba's scene-graph traversal, so a textured
parameter is evaluated at the hit by the very texture the path tracer uses. Conventions:

- ``specular`` is the colour k_s of the specular lobe at normal incidence: Fresnel reflectance times the
  ``specular_reflectance``; for transmitting BSDFs the reflected and the transmitted share together.
- ``roughness`` is sigma = sqrt(alpha) of the GGX or Beckmann lobe (geometric mean where anisotropic);
  0 for perfectly smooth lobes; 1 with ``specular`` 0 for a purely diffuse surface.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba


@dataclasses.dataclass
class Material:
    """What the G-buffer needs to know about N hits: Dr.Jit arrays of width N (or 1 where constant)."""

    diffuse: Any  # mi.Color3f
    specular: Any  # mi.Color3f
    roughness: Any  # mi.Float, sigma
    normal: Any  # mi.Normal3f, world space, unit, side of the surface as modelled

    @staticmethod
    def select(mask, a: "Material", b: "Material") -> "Material":
        import drjit as dr

        pairs = ((getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(Material))
        return Material(*(dr.select(mask, x, y) for x, y in pairs))


def parts(bsdf) -> dict[str, Any]:
    """Textures, nested BSDFs and plain parameters of a BSDF by name."""
    mi = mitsuba()

    class Collect(mi.TraversalCallback):
        def __init__(self):
            super().__init__()
            self.found: dict[str, Any] = {}

        def put(self, name, value, flags, cpptype=None):
            self.found[name] = value if cpptype is None else mi.get_property(value, cpptype, bsdf)

    collect = Collect()
    bsdf.traverse(collect)
    return collect.found


def supported() -> str:
    """The BSDF types :func:`evaluate` understands, for error messages."""
    return ", ".join(sorted({name for name, _ in _HANDLERS.values()}))


def evaluate(bsdf, si, shape_id: str = "?") -> Material:
    """The material at surface interactions that all carry this BSDF.

    Args:
        bsdf: a ``mi.BSDF``.
        si: ``mi.SurfaceInteraction3f`` of width N.
        shape_id: for the error message.

    Raises:
        PrtError: for a BSDF type that is not known; names it, its shape, and the known ones.
    """
    entry = _HANDLERS.get(bsdf.class_name())
    if entry is None:
        raise PrtError(
            f"BSDF {bsdf.class_name()!r} (id {bsdf.id()!r}) on shape {shape_id!r} is not supported; "
            f"supported are {supported()}; replace it in the scene file"
        )
    return entry[1](parts(bsdf), si, shape_id)


def _color(value, si, default: float = 1.0):
    """A texture, a float or nothing, as a colour at the hits."""
    mi = mitsuba()
    if value is None:
        return mi.Color3f(default)
    if isinstance(value, mi.Texture):
        return mi.Color3f(value.eval(si))
    return mi.Color3f(value)


def _scalar(value, si, default: float = 0.0):
    mi = mitsuba()
    if value is None:
        return mi.Float(default)
    if isinstance(value, mi.Texture):
        return value.eval_1(si)
    return mi.Float(value)


def _sigma(found: dict[str, Any], si, default_alpha: float = 0.1):
    """sqrt of alpha, or of the geometric mean of alpha_u and alpha_v."""
    import drjit as dr

    if "alpha_u" in found:
        alpha = dr.sqrt(_scalar(found["alpha_u"], si) * _scalar(found["alpha_v"], si))
    else:
        alpha = _scalar(found.get("alpha"), si, default_alpha)
    return dr.sqrt(dr.clip(alpha, 0.0, 1.0))


def _dielectric_f0(eta):
    """Fresnel reflectance at normal incidence of a dielectric interface with relative index eta."""
    return ((eta - 1.0) / (eta + 1.0)) ** 2


def _diffuse(found, si, shape_id) -> Material:
    mi = mitsuba()
    return Material(_color(found["reflectance"], si), mi.Color3f(0.0), mi.Float(1.0), si.sh_frame.n)


def _conductor(rough: bool) -> Callable:
    def handler(found, si, shape_id) -> Material:
        mi = mitsuba()
        eta, k = _color(found.get("eta"), si, 0.0), _color(found.get("k"), si, 1.0)
        f0 = ((eta - 1.0) ** 2 + k**2) / ((eta + 1.0) ** 2 + k**2)
        specular = f0 * _color(found.get("specular_reflectance"), si)
        return Material(
            mi.Color3f(0.0), specular, _sigma(found, si) if rough else mi.Float(0.0), si.sh_frame.n
        )

    return handler


def _plastic(rough: bool) -> Callable:
    def handler(found, si, shape_id) -> Material:
        mi = mitsuba()
        specular = _dielectric_f0(_scalar(found["eta"], si)) * _color(found.get("specular_reflectance"), si)
        diffuse = _color(found["diffuse_reflectance"], si)
        return Material(diffuse, specular, _sigma(found, si) if rough else mi.Float(0.0), si.sh_frame.n)

    return handler


def _dielectric(rough: bool) -> Callable:
    def handler(found, si, shape_id) -> Material:
        mi = mitsuba()
        f0 = _dielectric_f0(_scalar(found["eta"], si))
        reflected = f0 * _color(found.get("specular_reflectance"), si)
        transmitted = (1.0 - f0) * _color(found.get("specular_transmittance"), si)
        sigma = _sigma(found, si) if rough else mi.Float(0.0)
        return Material(mi.Color3f(0.0), reflected + transmitted, sigma, si.sh_frame.n)

    return handler


def _principled(found, si, shape_id) -> Material:
    """Burley's model: alpha = roughness^2, so sigma is the ``roughness`` parameter itself."""
    import drjit as dr

    mi = mitsuba()
    base = _color(found["base_color"], si)
    metallic, transmission = _scalar(found.get("metallic"), si), _scalar(found.get("spec_trans"), si)
    if "specular" in found:
        f0 = 0.08 * _scalar(found["specular"], si)
    else:
        f0 = _dielectric_f0(_scalar(found.get("eta"), si, 1.5))
    opaque = (1.0 - metallic) * (1.0 - transmission)
    refracted = (1.0 - metallic) * transmission * (1.0 - f0)
    specular = dr.lerp(mi.Color3f(f0), base, metallic) + refracted * dr.sqrt(dr.maximum(base, 0.0))
    return Material(
        opaque * base, specular, dr.clip(_scalar(found["roughness"], si), 0.0, 1.0), si.sh_frame.n
    )


def _two_sided(found, si, shape_id) -> Material:
    front = evaluate(found["brdf_0"], si, shape_id)
    back = found.get("brdf_1")
    if back is None or back is found["brdf_0"]:
        return front
    return Material.select(si.wi.z > 0.0, front, evaluate(back, si, shape_id))


def _mask(found, si, shape_id) -> Material:
    return evaluate(found["nested_bsdf"], si, shape_id)


def _blend(found, si, shape_id) -> Material:
    """Colours blend linearly; roughness and normal are those of the heavier part."""
    import drjit as dr

    weight = dr.clip(_scalar(found["weight"], si), 0.0, 1.0)
    a, b = (evaluate(found[name], si, shape_id) for name in ("bsdf_0", "bsdf_1"))
    heavier = Material.select(weight > 0.5, b, a)
    heavier.diffuse = dr.lerp(a.diffuse, b.diffuse, weight)
    heavier.specular = dr.lerp(a.specular, b.specular, weight)
    return heavier


def _bump_map(found, si, shape_id) -> Material:
    """Blinn's displaced tangents, as in Mitsuba's ``bumpmap`` plugin."""
    import drjit as dr

    gradient = _scalar(found.get("scale"), si, 1.0) * found["nested_texture"].eval_1_grad(si)
    n = si.sh_frame.n
    du = si.dp_du + n * (gradient.x - dr.dot(n, si.dp_du))
    dv = si.dp_dv + n * (gradient.y - dr.dot(n, si.dp_dv))
    bent = dr.normalize(dr.cross(du, dv))
    bent = dr.select(dr.dot(bent, n) < 0.0, -bent, bent)
    material = evaluate(found["nested_bsdf"], si, shape_id)
    # Meshes without texture coordinates have no tangents to displace.
    material.normal = dr.select(dr.all(dr.isfinite(bent)), bent, n)
    return material


def _normal_map(found, si, shape_id) -> Material:
    import drjit as dr

    mi = mitsuba()
    local = dr.normalize(mi.Vector3f(found["normalmap"].eval_3(si)) * 2.0 - 1.0)
    bent = si.to_world(local)
    material = evaluate(found["nested_bsdf"], si, shape_id)
    material.normal = dr.select(dr.all(dr.isfinite(bent)), bent, si.sh_frame.n)
    return material


#: class name in Mitsuba -> (plugin name in scene files, handler)
_HANDLERS: dict[str, tuple[str, Callable]] = {
    "SmoothDiffuse": ("diffuse", _diffuse),
    "Principled": ("principled", _principled),
    "RoughConductor": ("roughconductor", _conductor(rough=True)),
    "SmoothConductor": ("conductor", _conductor(rough=False)),
    "RoughPlastic": ("roughplastic", _plastic(rough=True)),
    "SmoothPlastic": ("plastic", _plastic(rough=False)),
    "RoughDielectric": ("roughdielectric", _dielectric(rough=True)),
    "SmoothDielectric": ("dielectric", _dielectric(rough=False)),
    "ThinDielectric": ("thindielectric", _dielectric(rough=False)),
    "TwoSidedBRDF": ("twosided", _two_sided),
    "MaskBSDF": ("mask", _mask),
    "BlendBSDF": ("blendbsdf", _blend),
    "BumpMap": ("bumpmap", _bump_map),
    "NormalMap": ("normalmap", _normal_map),
}

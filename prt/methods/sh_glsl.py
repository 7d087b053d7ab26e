"""Shading by transfer vectors in GLSL 3.30: :mod:`prt.trace.sh_shading`, and what it takes of harmonics."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.network_glsl import literal
from prt.trace.sh_shading import SHARPEST, ShCode

#: what the shader can shade; the other part is left out of its source
MATERIALS = {"diffuse": (1, 0), "glossy": (0, 1), "both": (1, 1)}

SHADE = """
layout(std140) uniform Light {
    vec4 light[K];
#if GLOSSY
    vec4 product[K * K];
#endif
};

vec3 shade(float t[K], vec3 diffuse, vec3 specular, float roughness, vec3 reflected) {
    vec3 color = vec3(0.0);
#if DIFFUSE
    vec3 even = vec3(0.0);
    for (int i = 0; i < K; ++i) even += light[i].rgb * t[i];
    color += diffuse * even;
#endif
#if GLOSSY
    float rough = max(roughness, 1e-4);
    float exponent = clamp(2.0 / (rough * rough * rough * rough) - 2.0, 0.0, SHARPEST);
    float y[K];
    lobe(reflected, exponent, y);
    vec3 sharp = vec3(0.0);
    // the bound keeps compilers from writing out all K * K terms
    for (int k = 0; k < (always ? K : 0); ++k) {
        vec3 sum = vec3(0.0);
        for (int i = 0; i < K; ++i) sum += product[k * K + i].rgb * t[i];
        sharp += y[k] * sum;
    }
    color += specular * sharp;
#endif
    return color;
}
"""


def check_order(order: int, info: dict) -> None:
    """Refuse more bands than the light matrix of a uniform block may have.

    Args:
        info: limits of the OpenGL context.

    Raises:
        PrtError: for an order that is no integer from 1 to what OpenGL allows (7 where a block has 64 KiB).
    """
    room = info["GL_MAX_UNIFORM_BLOCK_SIZE"] // 16
    most = math.isqrt((math.isqrt(1 + 4 * room) - 1) // 2)
    if not isinstance(order, int) or not 1 <= order <= most:
        raise PrtError(f"order={order!r} must be 1 to {most} for a fragment shader here; use renderer=torch")


def shade_source(order: int, material: str) -> str:
    """``vec3 shade(float t[K], vec3 diffuse, vec3 specular, float roughness, vec3 reflected)``.

    With definitions of K, DIFFUSE and GLOSSY, and the uniform block ``Light`` of :func:`light_block`.

    Args:
        order: bands; ``K = order^2``.
        material: ``diffuse``, ``glossy`` or ``both``: which terms it has.

    Raises:
        PrtError: for an unknown material.
    """
    if material not in MATERIALS:
        raise PrtError(f"material={material!r} is not one of {', '.join(MATERIALS)}")
    diffuse, glossy = MATERIALS[material]
    values = {"K": order**2, "DIFFUSE": diffuse, "GLOSSY": glossy, "SHARPEST": literal(SHARPEST)}
    defines = "".join(f"#define {name} {value}\n" for name, value in values.items())
    return defines + (lobe_source(order) if glossy else "") + SHADE


def lobe_source(order: int) -> str:
    """``void lobe(vec3 d, float s, out float y[K])``: pi times harmonics at d, convolved with a Phong lobe.

    The recurrences of :func:`prt.light.sh.sh_basis` and :func:`prt.light.sh_products.phong_bands`, written
    out.
    """
    lines = []
    for l in range(order):
        before = f"a{l - 2} * (s - {literal(l - 2)}) / (s + {literal(l + 1)})"
        lines.append(f"float a{l} = {f'1.0 / (s + {l + 1}.0)' if l < 2 else before};")
    lines += ["float c0 = 1.0, s0 = 0.0;", f"s += 2.0; s *= {literal(math.pi)};"]
    diagonal = math.sqrt(1 / (4 * math.pi))
    for m in range(order):
        if m > 0:
            lines.append(
                f"float c{m} = d.x * c{m - 1} - d.y * s{m - 1}, s{m} = d.x * s{m - 1} + d.y * c{m - 1};"
            )
            diagonal *= math.sqrt((2 * m + 1) / (2 * m))
        for l in range(m, order):
            value = literal(diagonal)
            if l > m:
                a = math.sqrt((4 * l * l - 1) / (l * l - m * m))
                b = math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1))
                lower = f" - {literal(b)} * p{l - 2}_{m}" if l > m + 1 else ""
                value = f"{literal(a)} * (d.z * p{l - 1}_{m}{lower})"
            lines.append(f"float p{l}_{m} = {value};")
            middle, factor = l * l + l, f"s * a{l} * {literal(math.sqrt(2))} * p{l}_{m}"
            if m == 0:
                lines.append(f"y[{middle}] = s * a{l} * p{l}_0;")
            else:
                lines += [f"y[{middle + m}] = {factor} * c{m};", f"y[{middle - m}] = {factor} * s{m};"]
    return f"void lobe(vec3 d, float s, out float y[{order**2}]) {{\n" + "\n".join(lines) + "\n}\n"


def light_block(code: ShCode, order: int, material: str) -> Float[Tensor, "R 4"]:
    """The uniform block ``Light`` (std140): coefficients, then the matrix row by row unless ``diffuse``.

    Raises:
        PrtError: for a lighting of another number of coefficients.
    """
    K = order**2
    if code.coefficients.shape != (K, 3) or code.matrix.shape != (K, K, 3):
        raise PrtError(
            f"a lighting of {len(code.coefficients)} coefficients for a shader of order={order}, "
            f"which has {K}"
        )
    rows = [code.coefficients]
    if MATERIALS[material][1]:
        rows.append(code.matrix.reshape(K * K, 3))
    values = torch.cat(rows).detach().cpu().float()
    return torch.cat([values, torch.zeros((len(values), 1))], dim=1)

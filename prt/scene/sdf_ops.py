"""Functions of scalars of any kind: torch tensors, Dr.Jit floats, GLSL expressions and Python's own floats.

A distance field is written once with these and with ``+ - * /``; what it is evaluated with decides the kind.
Operands are of one kind; numbers go with all.
"""

import math
import sys
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor

from prt.scene.sdf_glsl import Glsl, call

#: what a square root starts at: its slope stays finite, and a length is wrong by 1e-10 at most
TINY = 1e-20


def sqrt(a: Any) -> Any:
    """Square root of ``a``, or of :data:`TINY` below it, where the derivative is zero."""
    return _backend(a).sqrt(maximum(a, TINY))


def absolute(a: Any) -> Any:
    """|a|; its derivative at 0 is zero in torch."""
    return _backend(a).absolute(a)


def minimum(a: Any, b: Any) -> Any:
    """The smaller of two."""
    return _backend(a, b).minimum(a, b)


def maximum(a: Any, b: Any) -> Any:
    """The larger of two."""
    return _backend(a, b).maximum(a, b)


def clamp(a: Any, low: float, high: float) -> Any:
    """``a`` held between two numbers."""
    return _backend(a).clamp(a, low, high)


def sin(a: Any) -> Any:
    """Sine, radians."""
    return _backend(a).sin(a)


def cos(a: Any) -> Any:
    """Cosine, radians."""
    return _backend(a).cos(a)


def length(*parts: Any) -> Any:
    """Length of the vector with these components; at zero 1e-10, with zero derivatives."""
    total = parts[0] * parts[0]
    for part in parts[1:]:
        total = total + part * part
    return sqrt(total)


def weighted(weights: tuple[float, ...], parts: tuple[Any, ...]) -> Any:
    """Sum of the parts times their weights, without the terms that vanish."""
    total: Any = None
    for weight, part in zip(weights, parts, strict=True):
        if weight == 0.0:
            continue
        term = part if weight == 1.0 else weight * part
        total = term if total is None else total + term
    return parts[0] * 0.0 if total is None else total


def _torch_minimum(a: Any, b: Any) -> Tensor:
    if isinstance(a, Tensor) and isinstance(b, Tensor):
        return torch.minimum(a, b)
    return torch.clamp(a, max=b) if isinstance(a, Tensor) else torch.clamp(b, max=a)


def _torch_maximum(a: Any, b: Any) -> Tensor:
    if isinstance(a, Tensor) and isinstance(b, Tensor):
        return torch.maximum(a, b)
    return torch.clamp(a, min=b) if isinstance(a, Tensor) else torch.clamp(b, min=a)


_TORCH = SimpleNamespace(
    sqrt=torch.sqrt,
    absolute=torch.abs,
    minimum=_torch_minimum,
    maximum=_torch_maximum,
    clamp=torch.clamp,
    sin=torch.sin,
    cos=torch.cos,
)
_GLSL = SimpleNamespace(
    sqrt=lambda a: call("sqrt", a),
    absolute=lambda a: call("abs", a),
    minimum=lambda a, b: call("min", a, b),
    maximum=lambda a, b: call("max", a, b),
    clamp=lambda a, low, high: call("clamp", a, low, high),
    sin=lambda a: call("sin", a),
    cos=lambda a: call("cos", a),
)
_NUMBER = SimpleNamespace(
    sqrt=math.sqrt,
    absolute=abs,
    minimum=min,
    maximum=max,
    clamp=lambda a, low, high: min(max(a, low), high),
    sin=math.sin,
    cos=math.cos,
)


def _backend(*operands: Any) -> Any:
    """The functions of the operands' kind."""
    kinds = [operand for operand in operands if not isinstance(operand, (int, float))]
    if not kinds:
        return _NUMBER
    if isinstance(kinds[0], Tensor):
        return _TORCH
    if isinstance(kinds[0], Glsl):
        return _GLSL
    # whoever holds a Dr.Jit float has imported drjit
    drjit = sys.modules.get("drjit")
    if drjit is None or not drjit.is_array_v(kinds[0]):
        raise TypeError(f"no scalar of a distance field: {type(kinds[0]).__name__}")
    return SimpleNamespace(
        sqrt=drjit.sqrt,
        absolute=drjit.abs,
        minimum=drjit.minimum,
        maximum=drjit.maximum,
        clamp=drjit.clip,
        sin=drjit.sin,
        cos=drjit.cos,
    )

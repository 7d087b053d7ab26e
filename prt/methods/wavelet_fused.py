"""Which form shades the network of Raghavan 2023: readable, folded in torch, or folded and fused.

Fused kernels are Triton's on a GPU (:mod:`prt.methods.wavelet_kernel`, :mod:`prt.nn.hashgrid_kernel`) and C++
compiled at first use on the CPU (:mod:`prt.methods.wavelet_compiled`, :mod:`prt.nn.hashgrid_compiled`). On a
GPU the layers are fused in bfloat16 only: in float32 the hash grid's lookup is, and the layers are torch's.
"""

import contextlib
from collections.abc import Iterator
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.methods.wavelet_compiled import arranged, compiled_problem, shade_compiled
from prt.methods.wavelet_shading import WaveletCode, shade_folded, shade_readable
from prt.methods.wavelet_tiles import pack
from prt.nn.hashgrid import HashGrid
from prt.nn.hashgrid_compiled import lookup_compiled
from prt.nn.triton_setup import triton_problem
from prt.nn.wavelet_transport import PixelInputs, WaveletTransport
from prt.scene.gbuffer import GBuffer

KERNELS = ("auto", "plain", "fused")
#: pixels that plain torch shades at a time on a GPU: the CPU's cache-sized chunks would leave it idle
GPU_CHUNK = 4096

Form = Literal["plain", "triton", "compiled"]


def check_kernel(kernel: str, folded: bool) -> None:
    """Refuse a setting ``method.kernel`` that is unknown or contradicts ``method.folded``.

    Raises:
        PrtError: naming the setting and what is allowed.
    """
    if kernel not in KERNELS:
        raise PrtError(f"method.kernel={kernel!r} is not one of {', '.join(KERNELS)}")
    if kernel == "fused" and not folded:
        raise PrtError("method.kernel=fused fuses the folded form; set method.folded=true, or kernel=auto")


def form_of(kernel: str, device: str) -> Form:
    """What ``method.kernel`` means on a device (``cpu`` or ``cuda``).

    ``auto``: Triton's kernels on a GPU that can run them, else plain torch. ``fused`` must not fall back.

    Raises:
        PrtError: if ``fused`` is asked for and Triton cannot run.
    """
    gpu = torch.device(device).type == "cuda"
    if kernel == "plain" or (kernel == "auto" and not gpu):
        return "plain"
    problem = triton_problem() if gpu else None
    if problem and kernel == "fused":
        raise PrtError(f"method.kernel=fused: {problem}; set method.kernel=auto")
    return "plain" if problem else "triton" if gpu else "compiled"


def encode(
    form: Form, net: WaveletTransport, index: Int[Tensor, "K"], value: Float[Tensor, "K 3"], precision: str
) -> WaveletCode:
    """The code of a lighting's kept coefficients, with the weights that a fused form needs.

    Raises:
        PrtError: if the form is ``compiled`` and the processor or its compiler cannot do it.
    """
    kind = torch.bfloat16 if precision == "bfloat16" else torch.float32
    folded, weight = net.fold(index), value * net.scale[index][:, None]
    code = WaveletCode(index, value, folded.to(kind), weight, None)
    if form == "compiled":
        problem = compiled_problem(kind)
        if problem:
            raise PrtError(f"method.kernel=fused, precision={precision}: {problem}; set method.kernel=auto")
        code.packed = arranged(pack(net, folded, weight, kind))
    elif form == "triton" and kind == torch.bfloat16:
        code.packed = pack(net, folded, weight, kind)
    return code


def shade_as(
    form: Form, net: WaveletTransport, gbuffer: GBuffer, code: WaveletCode, folded: bool, chunk: int
) -> Float[Tensor, "N 3"]:
    """Indirect radiance of a G-buffer's points, on the network's device, which the G-buffer is on.

    Args:
        form: as for :func:`encode`, which made ``code``; only the folded network has fused forms.
        chunk: pixels at a time in plain torch.
    """
    pixel = inputs(form if folded else "plain", net, gbuffer)
    if not folded:
        return shade_readable(net, pixel, code, chunk)
    if code.packed is None:
        return shade_folded(net, pixel, code, chunk_on(pixel.space.device.type, chunk))
    bias = net.per_pixel(pixel.features)
    if form == "compiled":
        return shade_compiled(pixel.space, bias, code.packed)
    with triton_errors():
        from prt.methods.wavelet_kernel import shade_on_gpu

        return shade_on_gpu(pixel.space, bias, code.packed)


def chunk_on(device: str, chunk: int) -> int:
    """Pixels that plain torch shades at a time on a device, if ``method.chunk`` is ``chunk``."""
    return max(chunk, GPU_CHUNK) if device == "cuda" else chunk


def inputs(form: Form, net: WaveletTransport, gbuffer: GBuffer) -> PixelInputs:
    """:meth:`WaveletTransport.inputs`, with a fused lookup where the features lie in a hash grid."""
    if form == "plain" or not isinstance(net.grid, HashGrid):
        return net.inputs(gbuffer)
    if form == "compiled":
        return net.joined(lookup_compiled(net.grid, gbuffer.position), gbuffer)
    with triton_errors():
        from prt.nn.hashgrid_kernel import lookup_on_gpu

        space = lookup_on_gpu(net.grid, gbuffer.position)
    return net.joined(space, gbuffer)


@contextlib.contextmanager
def triton_errors() -> Iterator[None]:
    """What Triton, its compiler or the driver raises (no common base) as one line with a way out."""
    try:
        yield
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise PrtError(f"a Triton kernel failed on this GPU ({reason}); set method.kernel=plain") from error

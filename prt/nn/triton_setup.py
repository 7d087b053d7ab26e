"""Whether Triton kernels can run here; nothing needs them."""

import functools

import torch


@functools.cache
def triton_problem() -> str | None:
    """None where Triton kernels run on this machine's GPU, else why not."""
    missing = triton_missing()
    if missing:
        return missing
    if not torch.cuda.is_available():
        return "torch sees no CUDA device"
    major, minor = torch.cuda.get_device_capability()
    if major < 8:  # matrix instructions for bfloat16
        return f"the GPU has compute capability {major}.{minor}, and 8.0 is needed"
    return None


def triton_missing() -> str | None:
    """None where Triton can be imported, else why not."""
    try:
        import triton  # noqa: F401  # pyright: ignore[reportMissingImports]
    except Exception as error:  # a Triton that does not match torch or the driver fails in ways of its own
        return f"Triton cannot be imported ({error}); pip install triton (torch's CUDA wheels bring it)"
    return None

"""OpenGL 3.3 without a window, and what everything that draws with it shares.

OpenGL comes from ``moderngl``: through EGL on Linux, where Mesa's software renderer serves a machine without
a GPU.
"""

import sys
import weakref
from typing import Any

from typing_extensions import Self

from prt.errors import PrtError

HOW = "Debian: apt-get install libegl1 libgl1 libgl1-mesa-dri, or a GPU driver with EGL"
#: a triangle that covers the screen, from nothing but the vertices' numbers; its depth is the middle one
VERTEX = """#version 330
void main() {
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
"""


def open_context() -> Any:
    """A fresh OpenGL context without a window, made current.

    Raises:
        PrtError: where there is none, with what to install.
    """
    try:
        import moderngl
    except ImportError as error:
        raise PrtError("the GLSL renderer needs moderngl: pip install moderngl") from error
    backend = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    try:
        return moderngl.create_context(require=330, standalone=True, **backend)
    except Exception as error:  # the loader raises nothing more special
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PrtError(f"the GLSL renderer finds no OpenGL 3.3 ({reason}); {HOW}") from error


def available() -> str | None:
    """None where there is OpenGL 3.3, else one line that says why not and what to install."""
    try:
        open_context().release()
    except PrtError as error:
        return str(error)
    return None


def device_name() -> str:
    """What would draw: ``GL_RENDERER`` of a fresh context.

    Raises:
        PrtError: where there is no OpenGL.
    """
    context = open_context()
    try:
        return context.info["GL_RENDERER"]
    finally:
        context.release()


class Renderer:
    """Owner of an OpenGL context of its own; a context manager.

    Otherwise ``release()`` gives the context back (it also goes with the object). To be used from one thread,
    the one that made it.

    Raises:
        PrtError: where there is no OpenGL.
    """

    def __init__(self):
        self._context = context = open_context()
        # the context alone: a method of self would keep self alive
        self.release = weakref.finalize(self, context.release)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.release()

    def device_name(self) -> str:
        """What draws: ``GL_RENDERER``."""
        return self._current().info["GL_RENDERER"]

    def finish(self) -> None:
        """Wait until everything is drawn."""
        with self._current() as context:
            context.finish()

    def _current(self) -> Any:
        """The context, for a ``with`` that makes it current and brings back the one before."""
        if not self.release.alive:
            raise PrtError(f"this {type(self).__name__} was released; make a new one")
        return self._context

    def _check_size(self, size: tuple[int, int]) -> None:
        side = self._context.info["GL_MAX_TEXTURE_SIZE"]
        if max(size) > side:
            raise PrtError(f"an image of {size[0]} x {size[1]} pixels; {side} a side are allowed here")

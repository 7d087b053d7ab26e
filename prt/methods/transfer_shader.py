"""Learnt transfer drawn by a fragment shader from a G-buffer (Dhawal 2022, section 4.3.1)."""

import time
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.methods.gl_context import VERTEX, Renderer
from prt.methods.network_glsl import ALWAYS, check_fits, transfers_source
from prt.methods.sh_glsl import check_order, light_block, shade_source
from prt.nn.transfer_network import TransferNetwork
from prt.scene.gbuffer import GBuffer
from prt.trace.sh_shading import ShCode

#: textures of the G-buffer, in the order of their units: position and roughness; normal and 1 + cell, 0 where
#: nothing is hit; and the others
SCREEN = ("place", "facing", "reflected", "diffuse", "specular")
#: the early depth pass; it also blackens the image
DEPTH = """#version 330
uniform sampler2D facing;
out vec4 color;
void main() {
    color = vec4(0.0);
    gl_FragDepth = texelFetch(facing, ivec2(gl_FragCoord.xy), 0).w > 0.0 ? 1.0 : 0.0;
}
"""
MAIN = """
uniform sampler2D place, facing, reflected, diffuse, specular;
out vec4 color;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 where = texelFetch(place, pixel, 0), turned = texelFetch(facing, pixel, 0);
    float t[K];
    transfer(int(turned.w) - 1, where.xyz, turned.xyz, t);
    vec3 even = texelFetch(diffuse, pixel, 0).rgb, sharp = texelFetch(specular, pixel, 0).rgb;
    color = vec4(shade(t, even, sharp, where.w, texelFetch(reflected, pixel, 0).xyz), 1.0);
}
"""


class NetworkRenderer(Renderer):
    """What draws with transfer networks in a fragment shader: the program, the lighting, the first compile.

    Args:
        networks: one for each cell.
        order, material: as in :func:`prt.methods.sh_glsl.shade_source`.
        ahead, main: GLSL before and after the functions ``transfer`` and ``shade``.

    Attributes:
        source_bytes: length of the fragment shader.
        compile_seconds: time the driver took for it, one pixel included: some compile when they first draw.

    Raises:
        PrtError: for networks of another number of outputs than ``order^2``, that do not fit in a shader
            (:func:`prt.methods.network_glsl.check_fits`, or the driver says so), or where there is no OpenGL.
    """

    def __init__(
        self, networks: Sequence[TransferNetwork], order: int, material: str, main: str, ahead: str = ""
    ):
        for network in networks:
            if len(network.scale) != order**2:
                raise PrtError(
                    f"a network of {len(network.scale)} outputs for order={order}: {order**2} are needed"
                )
        shading = shade_source(order, material)
        source = f"#version 330\n{ALWAYS}{ahead}{transfers_source(networks)}{shading}{main}"
        check_fits(source)
        self.order, self.material, self.source_bytes = order, material, len(source.encode())
        super().__init__()
        try:
            check_order(order, self._context.info)
            start = time.perf_counter()
            with self._context as context:
                self._program = compiled(context, source)
                self._triangle = context.vertex_array(self._program, [])
                rows = order**2 * (1 + order**2 if material != "diffuse" else 1)
                self._light = context.buffer(reserve=16 * rows, dynamic=True)
                self._light.clear()
                self._warm(context)
                context.finish()
            self.compile_seconds = time.perf_counter() - start
        except BaseException:
            self.release()
            raise

    def _warm(self, context: Any) -> None:
        """Draw one pixel of anything."""
        raise NotImplementedError

    def _draw(self, code: ShCode | None) -> None:
        """The triangle, with the lighting; None for the one before. The target is in use already."""
        if code is not None:
            self._light.write(light_block(code, self.order, self.material).numpy())
        self._light.bind_to_uniform_block(0)
        self._triangle.render(vertices=3)


def compiled(context: Any, fragment: str) -> Any:
    """The program of the full-screen triangle and a fragment shader.

    Raises:
        PrtError: with the driver's first complaint.
    """
    import moderngl

    try:
        return context.program(VERTEX, fragment_shader=fragment)
    except moderngl.Error as error:
        lines = [line.strip() for line in str(error).splitlines() if "error" in line.lower() and ":" in line]
        raise PrtError(
            f"{context.info['GL_RENDERER']} refuses the fragment shader of {len(fragment) / 1e6:.2f} MB "
            f"({(lines or ['no reason given'])[0]}); use a smaller network, or renderer=torch"
        ) from error


class TransferShader(NetworkRenderer):
    """Network and shading for every pixel of a G-buffer, as :func:`prt.trace.sh_shading.shade` has it.

    Pixels that hit nothing fail an early depth test: the network is not evaluated there.

    Args:
        network: or one for each cell of a scene that is cut.
        order: bands of lighting and transfer.
        material: ``diffuse`` or ``glossy`` leave out the other term, whatever the G-buffer says; ``both``.

    Raises:
        PrtError: as :class:`NetworkRenderer`.
    """

    def __init__(
        self, network: TransferNetwork | Sequence[TransferNetwork], order: int, material: str = "both"
    ):
        networks = [network] if isinstance(network, TransferNetwork) else list(network)
        self.cells = len(networks)
        self._screen: dict[str, Any] = {}
        self._target: Any = None
        self._size = (0, 0)
        super().__init__(networks, order, material, MAIN)

    def set_gbuffer(self, gbuffer: GBuffer, cell: Int[Tensor, "N"] | None = None) -> None:
        """Upload what the shader reads per pixel, as five RGBA32F textures, and draw the depth.

        Args:
            gbuffer: everything but ``wo`` and ``uv`` is used.
            cell: the network of each of the N points; 0 where left out.

        Raises:
            PrtError: for a G-buffer that belongs to no image, or cells without a network.
        """
        if gbuffer.view is None:
            raise PrtError("the GLSL renderer draws images; this G-buffer belongs to none (its view is None)")
        cell = torch.zeros(len(gbuffer)) if cell is None else cell
        if (
            cell.shape != (len(gbuffer),)
            or len(cell)
            and not 0 <= int(cell.min()) <= int(cell.max()) < self.cells
        ):
            raise PrtError(
                f"cells of shape {tuple(cell.shape)} must be {len(gbuffer)} numbers from 0 to "
                f"{self.cells - 1}, one for each point of the G-buffer"
            )
        hit, size = gbuffer.hit.cpu(), (gbuffer.view.width, gbuffer.view.height)
        marks = 1.0 + cell[:, None].to(gbuffer.normal)
        values = (
            torch.cat([gbuffer.position, gbuffer.roughness], dim=1),
            torch.cat([gbuffer.normal, marks], dim=1),
            gbuffer.wr,
            gbuffer.diffuse,
            gbuffer.specular,
        )
        with self._current() as context:
            self._resize(context, size)
            for name, value in zip(SCREEN, values, strict=True):
                image = torch.zeros((hit.numel(), 4))
                image[hit, : value.shape[1]] = value.detach().cpu().float()
                self._screen[name].write(image.numpy(), viewport=(0, 0, *size))
            self._draw_depth(context)

    def draw(self, code: ShCode) -> None:
        """Upload the lighting and start drawing; :meth:`finish` waits for it.

        Raises:
            PrtError: for a lighting of another number of coefficients, or before :meth:`set_gbuffer`.
        """
        if self._size == (0, 0):
            raise PrtError("the GLSL renderer has nothing to draw; call set_gbuffer first")
        with self._current():
            self._shade(code)

    def render(self, code: ShCode) -> Float[Tensor, "H W 3"]:
        """:meth:`draw`, and the image: linear RGB, zero where nothing is hit; it may ring below zero."""
        self.draw(code)
        width, height = self._size
        image = torch.empty((height, width, 3))
        with self._current():
            self._target.read_into(image.numpy(), components=3, dtype="f4")
        return image

    def _warm(self, context: Any) -> None:
        self._depth = context.vertex_array(compiled(context, DEPTH), [])
        for unit, name in enumerate(SCREEN):
            if name in self._program:
                self._program[name] = unit
        self._depth.program["facing"] = SCREEN.index("facing")
        context.enable(context.DEPTH_TEST)
        self._resize(context, (1, 1))
        self._draw_depth(context)
        self._shade(None)
        self._size = (0, 0)

    def _shade(self, code: ShCode | None) -> None:
        for unit, name in enumerate(SCREEN):
            self._screen[name].use(unit)
        self._target.depth_mask = False
        self._target.use()
        self._context.depth_func = "<"
        self._draw(code)

    def _draw_depth(self, context: Any) -> None:
        """1 where a pixel is to be shaded, 0 elsewhere; the triangle lies at one half."""
        self._target.depth_mask = True
        self._target.use()
        context.depth_func = "1"
        unit = SCREEN.index("facing")
        self._screen["facing"].use(unit)
        self._depth.render(vertices=3)

    def _resize(self, context: Any, size: tuple[int, int]) -> None:
        if size == self._size:
            return
        self._check_size(size)
        for old in (*self._screen.values(), self._target):
            if old is not None:
                old.release()
        # Mesa's software renderer compiles anew when the sides of a texture become powers of two, or cease to
        sides = tuple(1 << (side - 1).bit_length() for side in size)
        self._screen = {name: context.texture(sides, 4, dtype="f4") for name in SCREEN}
        self._target = context.framebuffer(
            [context.renderbuffer(size, 4, dtype="f4")], context.depth_renderbuffer(size)
        )
        self._size = size

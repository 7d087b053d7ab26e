"""The fragment shader that blends a lightmap basis on screen (Belcour 2022, section 5.2), in OpenGL 3.3.

Elements lie four to an RGBA texture, their coefficients in one 4 x 3 matrix per texture.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.blend_glsl import BASIS_UNIT, FRAGMENT, SCREEN
from prt.methods.gl_context import VERTEX, Renderer, available, device_name
from prt.methods.lightmap_blend import check, with_channels
from prt.scene.gbuffer import GBuffer

__all__ = ["FILTERS", "BlendShader", "available", "device_name", "packed"]
FILTERS = ("hardware", "exact")


class BlendShader(Renderer):
    """direct + scale * sum_k c_k B_k(uv) for every pixel of a G-buffer, drawn by a fragment shader.

    Args:
        basis: n elements, element 0 the mean; with one channel, (n, H, W) or (n, H, W, 1), four lie in a
            layer of an RGBA32F texture array, zeros after the last; with three channels, each has a layer.
        gamma: as in :meth:`prt.methods.lightmap_blend.Blender.blend`.
        filter: ``hardware`` is the texture unit's bilinear filter, what the paper's shader and its times
            use; ``exact`` fetches four texels and mixes them in float32, slower. Both are kept because GPUs
            commonly round the filter's weights to 8 bits, an error of up to 1/512 of the difference between
            neighbouring texels; Mesa's software renderer does not, there both agree with torch.

    Raises:
        PrtError: for an unknown filter, a basis of another shape or larger than OpenGL allows here, a gamma
            not above 0, or where there is no OpenGL (:func:`available` says why).
    """

    def __init__(
        self,
        basis: Float[Tensor, "n H W"] | Float[Tensor, "n H W C"],
        gamma: float = 1.0,
        filter: str = "hardware",
    ):
        if filter not in FILTERS:
            raise PrtError(f"filter={filter!r} is not one of {', '.join(FILTERS)}")
        layers = packed(basis)
        self.elements, self.channels = len(basis), with_channels(basis).shape[3]
        if not gamma > 0:
            raise PrtError(f"gamma={gamma} must be above 0; 1 is linear, 2.2 the usual")
        self.gamma = gamma
        super().__init__()
        try:
            self._check_limits(layers)
            self._build(layers, filter)
        except BaseException:
            self.release()
            raise
        self._screen: dict[str, Any] = {}
        self._target: Any = None
        self._size = (0, 0)

    @property
    def nbytes(self) -> int:
        """Bytes of the basis' textures on the GPU (what section 6.5 counts), zero padding included."""
        width, height, layers = self._basis.size
        return 16 * width * height * layers

    def set_gbuffer(
        self, gbuffer: GBuffer, scale: Float[Tensor, "N 3"], direct: Float[Tensor, "N 3"]
    ) -> None:
        """Upload what the shader reads per pixel, as three RGBA32F textures of the view's size.

        Args:
            gbuffer: its ``view``, ``hit`` and ``uv`` (places in the lightmap) are used.
            scale: linear RGB the indirect light is multiplied with; of the N pixels that hit the scene.
            direct: linear RGB radiance added to it.

        Raises:
            PrtError: for a G-buffer that belongs to no image, or values of another number than its points.
        """
        if gbuffer.view is None:
            raise PrtError("the GLSL renderer draws images; this G-buffer belongs to none (its view is None)")
        shape = (len(gbuffer.uv), 3)
        if scale.shape != shape or direct.shape != shape:
            raise PrtError(
                f"scale {tuple(scale.shape)} and direct {tuple(direct.shape)} must be {shape}, one row for "
                "each point of the G-buffer"
            )
        hit = gbuffer.hit.cpu()
        place = torch.cat([gbuffer.uv, torch.ones_like(gbuffer.uv[:, :1])], dim=1)
        size = (gbuffer.view.width, gbuffer.view.height)
        with self._current() as context:
            if size != self._size:
                self._resize(context, size)
            for name, values in zip(SCREEN, (place, scale, direct), strict=True):
                image = torch.zeros((hit.numel(), 4))
                image[hit, :3] = values.detach().cpu().float()
                self._screen[name].write(image.numpy())

    def draw(self, coefficients: Float[Tensor, "n 3"], indirect: bool = True) -> None:
        """Upload the coefficients and start drawing; :meth:`finish` waits for it.

        Args:
            coefficients: one row per element, one column per colour.
            indirect: False draws with the shader that reads the same G-buffer and knows no indirect light
                (``No GI`` of Table 1).

        Raises:
            PrtError: for coefficients of another number than the basis, or before :meth:`set_gbuffer`.
        """
        check(coefficients, self.elements, self.gamma)
        if self._target is None:
            raise PrtError("the GLSL renderer has nothing to draw; call set_gbuffer first")
        with self._current():
            if indirect:
                rows = torch.zeros((self._coefficients.size // 16, 4))
                rows[: self.elements, :3] = coefficients.detach().cpu()
                self._coefficients.write(rows.numpy())
                self._coefficients.bind_to_uniform_block(0)
                self._basis.use(BASIS_UNIT)
            for unit, name in enumerate(SCREEN):
                self._screen[name].use(unit)
            self._target.use()
            self._shaders[indirect].render(vertices=3)

    def render(self, coefficients: Float[Tensor, "n 3"], indirect: bool = True) -> Float[Tensor, "H W 3"]:
        """:meth:`draw`, and the image: linear RGB, zero where a pixel hits nothing."""
        self.draw(coefficients, indirect)
        width, height = self._size
        image = torch.empty((height, width, 3))
        with self._current():
            self._target.read_into(image.numpy(), components=3, dtype="f4")
        return image

    def _check_limits(self, layers: Float[Tensor, "L H W 4"]) -> None:
        info, per_layer = self._context.info, 4 if self.channels == 1 else 1
        side, block = info["GL_MAX_TEXTURE_SIZE"], info["GL_MAX_UNIFORM_BLOCK_SIZE"]
        most = min(info["GL_MAX_ARRAY_TEXTURE_LAYERS"], block // (16 * per_layer))
        if len(layers) > most or max(layers.shape[1:3]) > side:
            raise PrtError(
                f"{self.elements} elements of {layers.shape[1]} x {layers.shape[2]} texels are too much for "
                f"{info['GL_RENDERER']}: at most {most * per_layer} elements, {side} texels "
                "a side; use the torch renderer"
            )

    def _build(self, layers: Float[Tensor, "L H W 4"], filter: str) -> None:
        context = self._context
        with context:
            count, height, width, _ = layers.shape
            self._basis = context.texture_array((width, height, count), 4, layers.numpy(), dtype="f4")
            self._basis.filter = (context.LINEAR, context.LINEAR)
            self._basis.repeat_x = self._basis.repeat_y = False
            elements = 4 * count if self.channels == 1 else count
            self._coefficients = context.buffer(reserve=16 * elements, dynamic=True)
            self._shaders = {}
            for indirect in (False, True):
                names = {"LAYERS": count, "CHANNELS": self.channels, "INDIRECT": int(indirect)}
                names["EXACT"] = int(filter == "exact")
                if self.gamma != 1:
                    names["GAMMA"] = self.gamma
                defines = "".join(f"#define {name} {value}\n" for name, value in names.items())
                program = context.program(VERTEX, fragment_shader=f"#version 330\n{defines}{FRAGMENT}")
                for unit, name in enumerate((*SCREEN, "basis")):
                    if name in program:
                        program[name] = unit
                self._shaders[indirect] = context.vertex_array(program, [])

    def _resize(self, context: Any, size: tuple[int, int]) -> None:
        self._check_size(size)
        for old in (*self._screen.values(), self._target):
            if old is not None:
                old.release()
        self._screen = {name: context.texture(size, 4, dtype="f4") for name in SCREEN}
        self._target = context.framebuffer([context.renderbuffer(size, 4, dtype="f4")])
        self._size = size


def packed(basis: Float[Tensor, "n H W"] | Float[Tensor, "n H W C"]) -> Float[Tensor, "L H W 4"]:
    """The basis as RGBA layers: four elements of one channel each, or one of three and a zero."""
    full = with_channels(basis).detach().cpu().float()
    elements, height, width, channels = full.shape
    if channels == 3:
        return torch.cat([full, torch.zeros((elements, height, width, 1))], dim=3)
    padded = torch.cat([full[..., 0], torch.zeros((-elements % 4, height, width))])
    return padded.view(-1, 4, height, width).permute(0, 2, 3, 1).contiguous()

"""The G-buffer: what one ray per pixel sees, packed to the pixels that hit the scene."""

import dataclasses

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from typing_extensions import Self

from prt.scene.view import View


@dataclasses.dataclass
class GBuffer:
    """Surface attributes of N visible pixels; directions are unit, world space, away from the surface.

    Attributes:
        position: first hit, world units.
        normal: shading normal, on the side of the viewer.
        wo: towards the viewer.
        wr: wo mirrored about the normal.
        diffuse, specular: linear RGB reflectances k_d, k_s.
        roughness: sigma in [0, 1], the square root of GGX alpha; 0 is a mirror, 1 also stands for diffuse.
        uv: texture coordinates.
        hit: which pixels of the image are the N (row-major); N = hit.sum().
        view: the camera, None for points that belong to no image.
    """

    position: Float[Tensor, "N 3"]
    normal: Float[Tensor, "N 3"]
    wo: Float[Tensor, "N 3"]
    wr: Float[Tensor, "N 3"]
    diffuse: Float[Tensor, "N 3"]
    specular: Float[Tensor, "N 3"]
    roughness: Float[Tensor, "N 1"]
    uv: Float[Tensor, "N 2"]
    hit: Bool[Tensor, "P"]
    view: View | None = None

    FIELDS = ("position", "normal", "wo", "wr", "diffuse", "specular", "roughness", "uv")

    def __len__(self) -> int:
        return self.position.shape[0]

    def rows(self, index: Tensor) -> Self:
        """The G-buffer of some of its N points; it no longer belongs to an image."""
        parts = {name: getattr(self, name)[index] for name in self.FIELDS}
        return type(self)(**parts, hit=torch.ones(len(parts["position"]), dtype=torch.bool), view=None)

    def to(self, device: torch.device | str) -> Self:
        parts = {name: getattr(self, name).to(device) for name in (*self.FIELDS, "hit")}
        return dataclasses.replace(self, **parts)

    def image(self, values: Float[Tensor, "N C"]) -> Float[Tensor, "H W C"]:
        """Put per-point values back into the image; pixels that hit nothing are zero."""
        if self.view is None:
            raise ValueError("this G-buffer belongs to no image")
        out = values.new_zeros((self.hit.numel(), values.shape[1]))
        out[self.hit.to(values.device)] = values
        return out.reshape(self.view.height, self.view.width, values.shape[1])

    def guides(self) -> dict[str, Float[Tensor, "H W 3"]]:
        """What guides a denoiser: images of the colours and of the normals."""
        albedo = (self.diffuse + self.specular).clamp(0, 1)
        return {"albedo": self.image(albedo), "normal": self.image(self.normal)}

    def tensors(self) -> dict[str, Tensor]:
        """Everything but the view, for a file; :meth:`from_tensors` reads it back."""
        return {f"gbuffer.{name}": getattr(self, name) for name in (*self.FIELDS, "hit")}

    @classmethod
    def from_tensors(cls, tensors: dict[str, Tensor], view: View | None) -> Self:
        """The inverse of :meth:`tensors`; other entries are left alone."""
        return cls(**{name: tensors[f"gbuffer.{name}"] for name in (*cls.FIELDS, "hit")}, view=view)

    @classmethod
    def concatenate(cls, parts: list["GBuffer"]) -> Self:
        """The points of several G-buffers one after the other."""
        fields = {name: torch.cat([getattr(p, name) for p in parts]) for name in cls.FIELDS}
        return cls(**fields, hit=torch.ones(len(fields["position"]), dtype=torch.bool), view=None)

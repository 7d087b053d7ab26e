"""What transfer is baked on: points spread over a surface, what blocks their light, what a camera sees."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from typing_extensions import Self

from prt.errors import PrtError
from prt.scene.area_sampling import by_area, triangle_areas
from prt.scene.atlas import interpolate
from prt.scene.capture import capture
from prt.scene.gbuffer import GBuffer
from prt.scene.meshes import flat_normals
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View


@dataclasses.dataclass
class SurfacePoints:
    """N points of a surface with their outward unit normals, world space."""

    position: Float[Tensor, "N 3"]
    normal: Float[Tensor, "N 3"]

    def __len__(self) -> int:
        return len(self.position)

    def rows(self, index: Tensor | slice) -> Self:
        """Some of them."""
        return type(self)(self.position[index], self.normal[index])


@runtime_checkable
class Surface(Protocol):
    """A surface of any representation; the contract stands in docs/architecture.md."""

    scene: Any

    @property
    def counts(self) -> dict[str, int]:
        """Rays that could not be decided, and the like, by name."""
        ...

    @property
    def blocked(self) -> Callable[[Any, Any], Any] | None:
        """Whether the way from an origin along a direction is blocked, as Dr.Jit code; None without."""
        ...

    @property
    def bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Corners of the box around it, world units."""
        ...

    @property
    def extent(self) -> float:
        """Half the diagonal of that box."""
        ...

    def sample(self, count: int, seed: int) -> SurfacePoints:
        """Points spread evenly by area."""
        ...

    def occluded(self, origin: Float[Tensor, "N 3"], direction: Float[Tensor, "N 3"]) -> Bool[Tensor, "N"]:
        """Whether anything of the surface lies in that direction."""
        ...

    def capture(self, view: View) -> GBuffer:
        """What a camera sees."""
        ...

    def fingerprint(self) -> dict[str, Any]:
        """Plain JSON: everything that determines the surface."""
        ...


def shadowed(
    surface: Surface, origin: Float[Tensor, "N 3"], direction: Float[Tensor, "N 3"]
) -> Bool[Tensor, "N"]:
    """:meth:`Surface.occluded`, by the Dr.Jit code where there is some: 20 times faster for fields."""
    if surface.blocked is None:
        return surface.occluded(origin, direction)
    mi = mitsuba()
    columns = (np.ascontiguousarray(v.cpu().numpy().T, dtype=np.float32) for v in (origin, direction))
    o, d = columns
    found = surface.blocked(mi.Point3f(o), mi.Vector3f(d))
    return torch.from_numpy(np.array(found)).to(origin.device)


class MeshSurface:
    """The triangles of a scene, all of them.

    Args:
        scene: a static one without a medium.
        texels: of its atlas, a side, for methods that store transfer in a texture; 0 for no atlas, which a
            large scene may take minutes for: views then know neither places in it nor triangles.

    Raises:
        PrtError: for a scene that moves, or that light passes through.
    """

    def __init__(self, scene: Any, texels: int):
        if scene.poses != 1 or scene.medium:
            raise PrtError(
                f"scene={scene.name} moves or is translucent; transfer of direct light needs a static, "
                "opaque scene"
            )
        self.scene, self.texels, self.asset = scene, texels, scene.asset(max(texels, 8))
        self.counts: dict[str, int] = {}

    @property
    def bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Corners of the box around it, world units."""
        position = self.asset.mesh().position
        return tuple(position.amin(0).tolist()), tuple(position.amax(0).tolist())

    @property
    def extent(self) -> float:
        """Half the diagonal of that box."""
        return self.asset.radius

    def fingerprint(self) -> dict[str, Any]:
        """Geometry and materials; the atlas does not count."""
        return self.scene.fingerprint()

    def sample(self, count: int, seed: int) -> SurfacePoints:
        """Points spread evenly by area, uniform within triangles (Turk 1990), with interpolated normals."""
        return self.at(*self.places(count, seed))

    def places(self, count: int, seed: int) -> tuple[Int[Tensor, "N"], Float[Tensor, "N 2"]]:
        """Triangles and barycentric weights of ``count`` points, one in each of as many equal areas.

        Raises:
            PrtError: for a mesh without area.
        """
        mesh = self.asset.mesh()
        area = triangle_areas(mesh.position[mesh.face])
        if not area.sum() > 0:
            raise PrtError(f"scene={self.scene.name} has no surface: its triangles have no area")
        generator = torch.Generator().manual_seed(seed)
        random = torch.rand((count, 3), generator=generator, dtype=torch.float64)
        triangle, weights = by_area(area, random, torch.arange(count))
        return triangle, weights.float()

    def at(self, triangle: Int[Tensor, "N"], weights: Float[Tensor, "N 2"]) -> SurfacePoints:
        """Points given by triangle and barycentric weights of its second and third corner."""
        mesh = self.asset.mesh()
        corners = mesh.face[triangle]
        normal = torch.nn.functional.normalize(interpolate(mesh.normal[corners], weights), dim=1)
        # triangles too thin to have vertex normals have one of their own
        bad = ~(normal.square().sum(1) > 0.5)
        normal[bad] = flat_normals(mesh)[triangle[bad]]
        return SurfacePoints(interpolate(mesh.position[corners], weights), normal)

    @functools.cached_property
    def _scene(self) -> Any:
        return self.asset.load({})

    def blocked(self, origin: Any, direction: Any) -> Any:
        """:meth:`occluded` of ``mi.Point3f`` and ``mi.Vector3f``, a ``mi.Bool``."""
        return self._scene.ray_test(mitsuba().Ray3f(origin, direction))

    def occluded(self, origin: Float[Tensor, "N 3"], direction: Float[Tensor, "N 3"]) -> Bool[Tensor, "N"]:
        """Whether any triangle lies in that direction."""
        return shadowed(self, origin, direction)

    def capture(self, view: View) -> GBuffer:
        """What a camera sees, with places in the atlas and on the triangles where there is an atlas."""
        return self.asset.capture(self._scene, view) if self.texels else capture(self._scene, view)

"""A signed distance field with learnt transfer, drawn by one fragment shader (Dhawal 2022, section 5.2).

Rays are those of :meth:`prt.trace.sdf_surface.SdfSurface.capture`, step by step.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.network_glsl import literal
from prt.methods.transfer_shader import NetworkRenderer
from prt.nn.transfer_network import TransferNetwork
from prt.scene.capture import NEAR, camera_frame
from prt.scene.view import View
from prt.trace.sh_shading import ShCode
from prt.trace.sphere_tracing import EPSILON, NEARLY, STEPS

#: half the distance between the places whose distances make a normal, as a share of the extent (half the
#: diagonal of the box): the error of the difference grows with its square, float32's with its inverse
DIFFERENCE = 2.5e-4
#: alpha: the ray arrived; it met the step limit next to the surface, or elsewhere; one that left is discarded
HIT, CLOSE, LOST = 1.0, 0.75, 0.5

MAIN = """
uniform vec3 origin, right, up, forward;  // right and up as long as half the image on a plane at distance 1
uniform vec2 size;
uniform vec3 albedo, mirror;
uniform float rough;
out vec4 color;

vec3 gradient(vec3 p) {
    vec3 sum = vec3(0.0);
    // one call of sdf, under a bound that the compiler does not know: it would write it out six times
    for (int k = 0; k < (always ? 6 : 0); ++k) {
        vec3 axis = vec3(k % 3 == 0, k % 3 == 1, k % 3 == 2) * (k < 3 ? 1.0 : -1.0);
        sum += axis * sdf(p + DIFFERENCE * axis);
    }
    return sum;
}

void main() {
    vec2 place = 2.0 * gl_FragCoord.xy / size - 1.0;
    vec3 ray = normalize(place.x * right - place.y * up + forward);
    vec3 slow = vec3(lessThan(abs(ray), vec3(1e-20)));
    vec3 inverse = mix(1.0 / mix(ray, vec3(1.0), slow), vec3(1e20), slow);
    vec3 a = (LOW - origin) * inverse, b = (HIGH - origin) * inverse;
    vec3 first = min(a, b), last = max(a, b);
    float t = max(max(max(first.x, first.y), max(first.z, 0.0)), NEAR / dot(ray, forward));
    float far = min(last.x, min(last.y, last.z)), value = 1e30;
    bool under_way = t < far;
    for (int k = 0; k < STEPS && under_way; ++k) {
        value = sdf(origin + t * ray);
        t += max(value, 0.0);
        under_way = value >= EPSILON && t <= far;
    }
    if (!under_way && value >= EPSILON) discard;
    if (value >= NEARLY * EPSILON) {
        color = vec4(vec3(0.0), LOST);
        return;
    }
    vec3 position = origin + t * ray, normal = gradient(position);
    normal = dot(normal, normal) > 0.0 ? normalize(normal) : vec3(0.0, 1.0, 0.0);
    if (dot(normal, ray) > 0.0) normal = -normal;
    float transferred[K];
    transfer(0, position, normal, transferred);
    vec3 reflected = normalize(reflect(ray, normal));
    color = vec4(shade(transferred, albedo, mirror, rough, reflected), under_way ? CLOSE : HIT);
}
"""


class SdfShader(NetworkRenderer):
    """Sphere tracing, network and shading for every pixel of a view.

    Normals are the direction of central differences (six distances). The tetrahedron of four would be
    cheaper, but its error grows with the step itself rather than the step's square.

    Args:
        sdf_source: GLSL 3.30 of ``float sdf(vec3 p)``, a bound of the distance, negative inside; it may use
            ``uniform bool always`` (:data:`prt.methods.network_glsl.ALWAYS`), which is there already.
        bounds: corners of a box that holds the whole surface, world units.
        network, order, material: as in :class:`prt.methods.transfer_shader.TransferShader`.
        albedo, specular: linear RGB reflectances, the same everywhere.
        roughness: as in a G-buffer.
        epsilon: distance at which a ray has arrived, world units; as ``SdfSurface`` where None.
        steps: evaluations of the distance a ray may take.
        difference: step of the normals, world units; :data:`DIFFERENCE` times the extent where None.

    Raises:
        PrtError: as :class:`prt.methods.transfer_shader.NetworkRenderer`; for a box, epsilon, difference or
            steps that are none, or where the driver refuses ``sdf_source``.
    """

    def __init__(
        self,
        sdf_source: str,
        bounds: tuple[Sequence[float], Sequence[float]],
        network: TransferNetwork,
        order: int,
        albedo: Sequence[float] = (0.8, 0.8, 0.8),
        specular: Sequence[float] = (0.0, 0.0, 0.0),
        roughness: float = 1.0,
        epsilon: float | None = None,
        steps: int = STEPS,
        material: str = "both",
        difference: float | None = None,
    ):
        low, high = (tuple(map(float, corner)) for corner in bounds)
        extent = math.dist(low, high) / 2
        if not all(math.isfinite(b - a) and b > a for a, b in zip(low, high, strict=True)):
            raise PrtError(f"bounds={(low, high)} is no box: each lower number must be below its counterpart")
        epsilon = EPSILON * extent if epsilon is None else epsilon
        difference = DIFFERENCE * extent if difference is None else difference
        if not (epsilon > 0 and difference > 0 and steps >= 1):
            raise PrtError(f"epsilon={epsilon}, difference={difference} and steps={steps} must be above 0")
        values = {"EPSILON": epsilon, "DIFFERENCE": difference, "NEARLY": NEARLY, "NEAR": NEAR}
        values |= {"HIT": HIT, "CLOSE": CLOSE, "LOST": LOST}
        constants = {name: literal(value) for name, value in values.items()}
        constants |= {"STEPS": str(int(steps))}
        constants |= {
            name: f"vec3({', '.join(map(literal, v))})" for name, v in (("LOW", low), ("HIGH", high))
        }
        defines = "".join(f"#define {name} {value}\n" for name, value in constants.items())
        self._surface = {"albedo": albedo, "mirror": specular, "rough": roughness}
        self._target: Any = None
        self._size = (0, 0)
        # definitions come after the user's source, whose names they would otherwise replace
        super().__init__([network], order, material, defines + MAIN, sdf_source)

    def draw(self, view: View, code: ShCode) -> None:
        """Upload camera and lighting and start drawing; :meth:`finish` waits for it.

        Raises:
            PrtError: for a degenerate camera, or a lighting of another number of coefficients.
        """
        with self._current() as context:
            self._look(context, view)
            self._draw(code)

    def render(self, view: View, code: ShCode) -> tuple[Float[Tensor, "H W 3"], Bool[Tensor, "H W"], int]:
        """:meth:`draw`, and what came out.

        Returns:
            The image, linear RGB, zero where nothing is hit. Which pixels hit the surface. How many met the
            step limit: a hit if nearer than ``NEARLY * epsilon``, as in :mod:`prt.trace.sphere_tracing`.
        """
        self.draw(view, code)
        image = torch.empty((view.height, view.width, 4))
        with self._current():
            self._target.read_into(image.numpy(), components=4, dtype="f4")
        alpha = image[..., 3]
        exhausted = int(((alpha == CLOSE) | (alpha == LOST)).sum())
        return image[..., :3].contiguous(), (alpha == HIT) | (alpha == CLOSE), exhausted

    def _warm(self, context: Any) -> None:
        for name, value in self._surface.items():
            self._set(name, value)
        self._look(context, View((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), width=1, height=1))
        self._draw(None)

    def _look(self, context: Any, view: View) -> None:
        """Camera and target of a view; the target is in use, and empty."""
        right, up, forward = camera_frame(view)
        size = (view.width, view.height)
        if size != self._size:
            self._check_size(size)
            if self._target is not None:
                self._target.release()
            self._target = context.framebuffer([context.renderbuffer(size, 4, dtype="f4")])
            self._size = size
        self._set("origin", view.origin)
        self._set("right", view.half_width * right)
        self._set("up", view.half_width * view.height / view.width * up)
        self._set("forward", forward)
        self._set("size", size)
        self._target.use()
        self._target.clear()

    def _set(self, name: str, value: Any) -> None:
        if name in self._program:  # the compiler leaves out what it does not need
            array = np.asarray(value, dtype=np.float64)
            self._program[name] = float(array) if array.ndim == 0 else tuple(map(float, array))

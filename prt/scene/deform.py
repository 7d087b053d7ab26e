"""A mesh pushed through a smooth map of space, its normals with it."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from prt.scene.shapes import MeshData

Map = Callable[[Float[np.ndarray, "V 3"]], Float[np.ndarray, "V 3"]]


def deformed(data: MeshData, change: Map, step: float = 1e-5) -> MeshData:
    """The mesh with every vertex moved by ``change``; faces, texture coordinates and their order stay.

    Normals are multiplied by the cofactor matrix of the map's Jacobian, which is how areas transform: they
    stay at right angles to the surface and on its outside as long as the map turns nothing inside out. The
    Jacobian is taken by central differences, which needs no formula per map.

    Args:
        change: from positions to positions, world units; smooth.
        step: of the differences, world units.
    """
    x, y, z = (
        (change(data.position + offset) - change(data.position - offset)) / (2 * step)
        for offset in step * np.eye(3)
    )
    n = data.normal
    normal = n[:, :1] * np.cross(y, z) + n[:, 1:2] * np.cross(z, x) + n[:, 2:] * np.cross(x, y)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return dataclasses.replace(data, position=change(data.position), normal=normal)


def bend(angle: float, direction: float, length: float) -> Map:
    """What stands along +y on y = 0 is bent into an arc of a circle (Barr 1984).

    The plane y = 0 stays where it is, the axis keeps its length.

    Args:
        angle: between the axis at its foot and at height ``length``, degrees.
        direction: the side it leans to: 0 towards +x, 90 towards -z, as a turn about +y goes; degrees.
        length: height over which it bends by ``angle``, world units.
    """
    curvature = math.radians(angle) / length
    cosine, sine = math.cos(math.radians(direction)), math.sin(math.radians(direction))
    to, across = np.array([cosine, 0.0, -sine]), np.array([sine, 0.0, cosine])

    def change(position: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        lean, side, height = position @ to, position @ across, position[:, 1]
        turned = curvature * height
        # sin(a h) / a and (1 - cos(a h)) / a, without dividing by a curvature of nought
        up = height * np.sinc(turned / np.pi)
        out = height * np.sin(turned / 2) * np.sinc(turned / 2 / np.pi)
        moved = lean * np.cos(turned) + out
        return (
            moved[:, None] * to + side[:, None] * across + (up - lean * np.sin(turned))[:, None] * [0, 1, 0]
        )

    return change

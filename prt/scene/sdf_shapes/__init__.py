"""Four distance fields written for this project: each fits in [-1, 1]^3, y up, and stands on a plinth.

A change of any shape changes its GLSL text, and with it the fingerprint of the scene.
"""

from prt.scene.sdf_shapes.car import car
from prt.scene.sdf_shapes.fish import fish
from prt.scene.sdf_shapes.monster import monster
from prt.scene.sdf_shapes.rabbit import rabbit

__all__ = ["car", "fish", "monster", "rabbit"]

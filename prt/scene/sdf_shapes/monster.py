"""A friendly round monster with one eye: horns, a toothed grin, one arm waving; it looks along +z."""

from prt.scene.sdf import Sdf, intersection, smooth_subtraction, smooth_union, subtraction, union
from prt.scene.sdf_primitives import capsule, cylinder, ellipsoid, half_space, round_cone, sphere, torus

#: height of the ground, and where the middle of the body and of the eye are above it
GROUND, BODY, EYE = -0.86, 0.78, (0.0, 0.93, 0.36)


def monster() -> Sdf:
    """Body, face, limbs, horns and the spines of its back on a round slab."""
    body = smooth_union(ellipsoid(0.5, 0.53, 0.46).moved(y=BODY), _legs(), k=0.14)
    body = smooth_union(body, _raised_arm(), _hanging_arm(), k=0.07)
    body = smooth_union(body, _horns(), k=0.05)
    body = smooth_union(body, _spines(), k=0.04)
    body = smooth_subtraction(body, _mouth(), k=0.03)
    socket = torus(0.235, 0.045).turned("x", 78).moved(EYE[0], EYE[1], EYE[2] + 0.035)
    body = smooth_union(body, socket, k=0.05)
    slab = cylinder(0.86, 0.045, 0.03).moved(y=-0.045)
    return union(body, _eye(), _teeth(), slab).moved(y=GROUND)


def _eye() -> Sdf:
    """A ball with a dish for the iris and a bead for the pupil, and a lid over its upper part."""
    ball = smooth_subtraction(sphere(0.22), sphere(0.12).moved(z=0.27), k=0.015)
    pupil = sphere(0.055).moved(0.0, 0.0, 0.165)
    lid = subtraction(sphere(0.245), sphere(0.222))
    lid = intersection(lid, half_space(y=-1, z=0.45, offset=-0.055))
    return union(ball.turned("x", -6), pupil.turned("x", -6), lid.rounded(0.006)).moved(*EYE)


def _mouth() -> Sdf:
    """A grin: the lower part of a flat bowl, open to the front."""
    bowl = ellipsoid(0.3, 0.22, 0.26).moved(0.0, 0.64, 0.42)
    return smooth_subtraction(bowl, ellipsoid(0.5, 0.22, 0.6).moved(0.0, 0.8, 0.42), k=0.04)


def _teeth() -> Sdf:
    upper = round_cone((0.13, 0.645, 0.4), (0.125, 0.545, 0.42), 0.045, 0.012)
    lower = round_cone((0.045, 0.4, 0.36), (0.045, 0.49, 0.37), 0.042, 0.02)
    return union(upper, lower).mirrored("x")


def _legs() -> Sdf:
    leg = round_cone((0.22, 0.4, 0.0), (0.25, 0.14, 0.02), 0.15, 0.11)
    foot = smooth_union(leg, ellipsoid(0.15, 0.09, 0.2).moved(0.27, 0.08, 0.1), k=0.08)
    toes = union(
        sphere(0.055).moved(0.17, 0.05, 0.26),
        sphere(0.06).moved(0.275, 0.05, 0.29),
        sphere(0.055).moved(0.38, 0.05, 0.25),
    )
    return smooth_union(foot, toes, k=0.03).mirrored("x")


def _hand() -> Sdf:
    """Three fingers and a thumb at the origin, pointing up."""
    fingers = union(
        capsule((0, 0, 0), (0.02, 0.17, 0.02), 0.035),
        capsule((0, 0, 0), (0.1, 0.13, 0.02), 0.035),
        capsule((0, 0, 0), (-0.06, 0.15, 0.02), 0.035),
        capsule((0, 0, 0), (-0.12, 0.04, 0.04), 0.033),
    )
    return smooth_union(sphere(0.075), fingers, k=0.04)


def _raised_arm() -> Sdf:
    upper = round_cone((0.42, 0.82, 0.02), (0.68, 0.84, 0.06), 0.085, 0.065)
    fore = round_cone((0.68, 0.84, 0.06), (0.74, 1.13, 0.1), 0.065, 0.055)
    return smooth_union(upper, fore, _hand().turned("z", -8).moved(0.75, 1.18, 0.1), k=0.05)


def _hanging_arm() -> Sdf:
    upper = round_cone((-0.42, 0.84, 0.02), (-0.63, 0.66, 0.04), 0.085, 0.065)
    fore = round_cone((-0.63, 0.66, 0.04), (-0.66, 0.42, 0.14), 0.065, 0.055)
    return smooth_union(upper, fore, _hand().turned("x", 160).moved(-0.66, 0.37, 0.15), k=0.05)


def _horns() -> Sdf:
    """Bent outwards, then up, with a ring about each."""
    root = round_cone((0.24, 1.16, 0.0), (0.39, 1.36, -0.02), 0.105, 0.078)
    middle = round_cone((0.39, 1.36, -0.02), (0.42, 1.53, 0.0), 0.078, 0.048)
    tip = round_cone((0.42, 1.53, 0.0), (0.36, 1.67, 0.03), 0.048, 0.014)
    ring = torus(0.085, 0.024).turned("z", -38).moved(0.345, 1.3, -0.015)
    return union(smooth_union(root, middle, tip, k=0.015), ring).mirrored("x")


def _spines() -> Sdf:
    return union(
        round_cone((0.0, 1.22, -0.14), (0.0, 1.42, -0.24), 0.075, 0.015),
        round_cone((0.0, 1.06, -0.34), (0.0, 1.19, -0.52), 0.08, 0.015),
        round_cone((0.0, 0.82, -0.42), (0.0, 0.87, -0.62), 0.08, 0.015),
        round_cone((0.0, 0.55, -0.38), (0.0, 0.52, -0.56), 0.07, 0.015),
    )

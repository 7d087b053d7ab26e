"""A sitting rabbit with long ears, one of them bent, and a carrot before it; it looks along +z."""

from prt.scene.sdf import Sdf, smooth_subtraction, smooth_union, union
from prt.scene.sdf_primitives import box, capsule, cylinder, ellipsoid, round_cone, sphere, torus

#: height of the ground, and the middle of the head above it
GROUND, HEAD = -0.9, (0.0, 0.93, 0.26)


def rabbit() -> Sdf:
    """Body, head, ears, legs and tail, blended; eyes, teeth and carrot apart; on a round slab."""
    body = smooth_union(_trunk(), _hind_legs(), k=0.07)
    body = smooth_union(body, _front_legs(), k=0.05)
    body = smooth_union(body, sphere(0.12).moved(0.0, 0.2, -0.54), k=0.03)
    body = smooth_union(body, _head(), k=0.07)
    slab = cylinder(0.84, 0.04, 0.03).moved(y=-0.04)
    return union(body, _teeth(), _carrot(), slab).moved(y=GROUND)


def _trunk() -> Sdf:
    back = round_cone((0.0, 0.36, -0.2), (0.0, 0.66, 0.1), 0.35, 0.22)
    neck = round_cone((0.0, 0.6, 0.1), (0.0, 0.84, 0.19), 0.23, 0.19)
    return smooth_union(back, neck, k=0.15)


def _head() -> Sdf:
    skull = ellipsoid(0.27, 0.25, 0.28)
    cheek = sphere(0.115).moved(0.1, -0.1, 0.15).mirrored("x")
    snout = ellipsoid(0.12, 0.1, 0.14).moved(0.0, -0.03, 0.22)
    head = smooth_union(skull, cheek, snout, k=0.08)
    head = smooth_union(head, _ears(), k=0.06)
    # sockets, the cleft of the lip
    head = smooth_subtraction(head, sphere(0.08).moved(0.215, 0.05, 0.165).mirrored("x"), k=0.04)
    head = smooth_subtraction(head, capsule((0.0, -0.06, 0.36), (0.0, -0.17, 0.31), 0.016), k=0.03)
    nose = ellipsoid(0.045, 0.03, 0.03).moved(0.0, -0.005, 0.355)
    eye = smooth_subtraction(sphere(0.07), sphere(0.035).moved(0.06, 0.02, 0.05), k=0.01)
    eye = eye.moved(0.178, 0.05, 0.135).mirrored("x")
    return union(head, nose, eye).moved(*HEAD)


def _ear() -> Sdf:
    """An upright ear at the origin, its hollow towards +z."""
    leaf = union(
        round_cone((0.0, 0.0, 0.0), (0.0, 0.26, 0.0), 0.075, 0.12),
        round_cone((0.0, 0.26, 0.0), (0.0, 0.56, 0.0), 0.12, 0.055),
    )
    hollow = union(
        round_cone((0.0, 0.09, 0.0), (0.0, 0.27, 0.0), 0.045, 0.095),
        round_cone((0.0, 0.27, 0.0), (0.0, 0.54, 0.0), 0.095, 0.03),
    )
    return smooth_subtraction(leaf.stretched(z=0.5), hollow.stretched(z=0.7).moved(z=0.07), k=0.025)


def _ears() -> Sdf:
    upright = _ear().turned("x", -8).turned("z", -12).moved(0.11, 0.17, -0.05)
    # the other one tips over forwards and sideways
    lower = round_cone((0.0, 0.0, 0.0), (0.0, 0.27, 0.0), 0.075, 0.11)
    tip = round_cone((0.0, 0.0, 0.0), (0.0, 0.29, 0.0), 0.11, 0.055).stretched(z=0.5)
    hollow = round_cone((0.0, 0.04, 0.0), (0.0, 0.27, 0.0), 0.075, 0.025).stretched(z=0.7)
    tip = smooth_subtraction(tip, hollow.moved(z=-0.07), k=0.025)
    tip = tip.turned("x", 138).turned("y", -35).moved(0.0, 0.28, 0.0)
    bent = smooth_union(lower.stretched(z=0.5), tip, k=0.05)
    return union(upright, bent.turned("x", -8).turned("z", 14).moved(-0.11, 0.17, -0.05))


def _hind_legs() -> Sdf:
    haunch = ellipsoid(0.17, 0.25, 0.27).turned("x", 20).moved(0.27, 0.29, -0.16)
    foot = smooth_union(
        capsule((0.3, 0.075, -0.2), (0.33, 0.07, 0.22), 0.075),
        sphere(0.085).moved(0.335, 0.075, 0.24),
        k=0.04,
    )
    return smooth_union(haunch, _with_toes(foot, 0.335, 0.32), k=0.06).mirrored("x")


def _front_legs() -> Sdf:
    leg = round_cone((0.14, 0.55, 0.22), (0.13, 0.12, 0.36), 0.09, 0.062)
    paw = ellipsoid(0.075, 0.06, 0.1).moved(0.13, 0.06, 0.4)
    return _with_toes(smooth_union(leg, paw, k=0.05), 0.13, 0.485).mirrored("x")


def _with_toes(foot: Sdf, x: float, z: float) -> Sdf:
    """Three toes at the front of a foot, which ends at x and z."""
    toes = union(
        *(sphere(0.042).moved(x + side, 0.042, z - 0.5 * abs(side)) for side in (-0.055, 0.0, 0.055))
    )
    return smooth_union(foot, toes, k=0.015)


def _teeth() -> Sdf:
    return box(0.018, 0.035, 0.01, 0.008).moved(0.02, HEAD[1] - 0.17, HEAD[2] + 0.285).mirrored("x")


def _carrot() -> Sdf:
    """Lying before the paws, its leaves to the right."""
    root = round_cone((0.12, 0.075, 0.0), (-0.3, 0.03, 0.0), 0.075, 0.02)
    rings = union(
        torus(0.066, 0.008).turned("z", 90).moved(0.05, 0.068),
        torus(0.055, 0.008).turned("z", 90).moved(-0.05, 0.057),
    )
    leaves = union(
        capsule((0.16, 0.08, 0.0), (0.36, 0.17, 0.05), 0.02),
        capsule((0.16, 0.08, 0.0), (0.4, 0.07, -0.02), 0.02),
        capsule((0.16, 0.08, 0.0), (0.32, 0.12, -0.1), 0.02),
    )
    carrot = smooth_subtraction(root, rings, k=0.01)
    return smooth_union(carrot, leaves, k=0.03).turned("y", 14).moved(-0.06, 0.0, 0.63)

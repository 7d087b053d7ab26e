"""An old car: long bonnet, hollow cabin with windows, swept mudguards, a spare wheel; its nose along +x."""

from prt.scene.sdf import Sdf, smooth_intersection, smooth_subtraction, smooth_union, union
from prt.scene.sdf_primitives import box, capsule, cylinder, ellipsoid, half_space, round_cone, sphere, torus

#: height of the road, the wheels' radius, and where their centres are
ROAD, WHEEL, AXLE, TRACK = -0.42, 0.2, 0.56, 0.34


def car() -> Sdf:
    """Body, cabin, mudguards, wheels and fittings on a rounded slab."""
    parts = union(_body(), _mudguards(), _wheels(), _fittings(), _spare_wheel())
    slab = box(0.98, 0.04, 0.62, 0.03).moved(y=-0.04)
    return union(parts, slab).moved(y=ROAD)


def _body() -> Sdf:
    bonnet = round_cone((0.0, 0.38, 0), (0.62, 0.37, 0), 0.215, 0.165)
    # a flat radiator with a frame, and bars in it
    bonnet = smooth_intersection(bonnet, half_space(x=1, offset=0.68), k=0.05)
    louvres = union(
        *(capsule((at, 0.33, 0.2), (at - 0.03, 0.44, 0.2), 0.012) for at in (0.2, 0.28, 0.36, 0.44))
    )
    bonnet = smooth_subtraction(bonnet, louvres.mirrored("z"), k=0.02)
    radiator = box(0.04, 0.17, 0.125, 0.04).moved(0.67, 0.38)
    radiator = smooth_subtraction(radiator, box(0.04, 0.12, 0.085, 0.02).moved(0.72, 0.37), k=0.02)
    bars = union(
        capsule((0.695, 0.26, 0.0), (0.695, 0.48, 0.0), 0.01),
        capsule((0.695, 0.26, 0.034), (0.695, 0.48, 0.034), 0.01),
        capsule((0.695, 0.26, 0.068), (0.695, 0.48, 0.068), 0.01),
    ).mirrored("z")
    chassis = box(0.72, 0.05, 0.2, 0.04).moved(0.0, 0.2)
    boot = ellipsoid(0.3, 0.24, 0.25).moved(-0.5, 0.34)
    body = smooth_union(_cabin(), boot, k=0.12)
    body = smooth_union(body, bonnet, k=0.06)
    return union(smooth_union(body, chassis, k=0.05), radiator, bars)


def _cabin() -> Sdf:
    shell = smooth_union(
        box(0.31, 0.26, 0.26, 0.11).moved(-0.2, 0.45), box(0.24, 0.08, 0.22, 0.07).moved(-0.22, 0.68), k=0.1
    )
    hollow = box(0.26, 0.22, 0.215, 0.08).moved(-0.2, 0.46)
    doors = union(
        box(0.1, 0.085, 0.5, 0.035).moved(-0.075, 0.575),
        box(0.085, 0.085, 0.5, 0.035).moved(-0.305, 0.575),
    )
    screens = box(0.6, 0.075, 0.17, 0.035).moved(-0.2, 0.575)
    shell = smooth_subtraction(shell, hollow, doors, screens, k=0.015)
    seats = smooth_union(
        box(0.08, 0.08, 0.18, 0.04).moved(-0.24, 0.3), box(0.03, 0.14, 0.18, 0.03).moved(-0.33, 0.42), k=0.04
    )
    steering = torus(0.06, 0.012).turned("z", 60).moved(-0.06, 0.5, 0.09)
    return union(shell, seats, steering)


def _mudguards() -> Sdf:
    arch = torus(0.215, 0.085).turned("x", 90)
    arch = smooth_intersection(arch, half_space(y=-1, offset=0.07), k=0.05)
    arch = smooth_subtraction(arch, cylinder(0.225, 0.065, 0.02).turned("x", 90), k=0.02)
    arch = arch.moved(AXLE, WHEEL, TRACK)
    step = box(0.36, 0.022, 0.07, 0.02).moved(0.0, 0.125, TRACK)
    return smooth_union(arch, step, k=0.07).mirrored("x").mirrored("z")


def _wheel() -> Sdf:
    """A wheel about the z axis, its outside at +z."""
    tyre = torus(WHEEL - 0.055, 0.055).turned("x", 90)
    rim = smooth_subtraction(cylinder(0.115, 0.035, 0.01), cylinder(0.085, 0.03, 0.01).moved(y=0.035), k=0.01)
    hub = ellipsoid(0.045, 0.04, 0.045).moved(y=0.015)
    spokes = union(
        capsule((-0.1, 0.012, 0), (0.1, 0.012, 0), 0.011), capsule((0, 0.012, -0.1), (0, 0.012, 0.1), 0.011)
    )
    return union(tyre, union(rim, smooth_union(hub, spokes, k=0.02)).turned("x", 90))


def _wheels() -> Sdf:
    return _wheel().moved(AXLE, WHEEL, TRACK).mirrored("x").mirrored("z")


def _spare_wheel() -> Sdf:
    return _wheel().turned("y", -90).turned("z", -14).moved(-0.79, 0.36, 0.0)


def _fittings() -> Sdf:
    lamp = round_cone((0.5, 0.47, 0.26), (0.61, 0.47, 0.26), 0.035, 0.075)
    lamp = smooth_subtraction(lamp, sphere(0.085).moved(0.71, 0.47, 0.26), k=0.02)
    bulb = sphere(0.03).moved(0.635, 0.47, 0.26)
    stalk = capsule((0.56, 0.3, 0.2), (0.56, 0.42, 0.26), 0.018)
    bumper = capsule((0.93, 0.2, 0.0), (0.93, 0.2, 0.2), 0.03)
    bumper = smooth_union(bumper, capsule((0.93, 0.2, 0.2), (0.87, 0.2, 0.42), 0.03), k=0.02)
    holder = capsule((0.68, 0.2, 0.12), (0.93, 0.2, 0.12), 0.02)
    handle = capsule((-0.17, 0.46, 0.275), (-0.12, 0.46, 0.275), 0.012)
    mascot = capsule((0.66, 0.54, 0.0), (0.71, 0.6, 0.0), 0.014)
    return union(smooth_union(lamp, stalk, k=0.03), bulb, bumper, holder, handle, mascot).mirrored("z")

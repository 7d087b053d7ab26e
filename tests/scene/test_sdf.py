"""Distance fields: closed forms, the back ends against each other, slopes, and what is refused."""

import math
import re

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.methods import gl_context
from prt.scene import sdf_ops
from prt.scene.mitsuba_setup import find_llvm, mitsuba
from prt.scene.sdf import (
    Sdf,
    intersection,
    smooth_intersection,
    smooth_subtraction,
    smooth_union,
    subtraction,
    union,
)
from prt.scene.sdf_glsl import GlslProgram, literal
from prt.scene.sdf_primitives import (
    box,
    capsule,
    cylinder,
    ellipsoid,
    half_space,
    round_cone,
    sphere,
    torus,
)
from prt.scene.sdf_shapes import car, fish, monster, rabbit

PRIMITIVES = {
    "sphere": sphere(0.5),
    "ellipsoid": ellipsoid(0.6, 0.3, 0.4),
    "box": box(0.5, 0.3, 0.4),
    "round box": box(0.5, 0.3, 0.4, 0.1),
    "cylinder": cylinder(0.4, 0.3, 0.05),
    "torus": torus(0.5, 0.15),
    "capsule": capsule((-0.3, -0.2, 0.1), (0.4, 0.3, -0.2), 0.2),
    "round cone": round_cone((-0.3, -0.2, 0.1), (0.4, 0.3, -0.2), 0.25, 0.05),
    "thickening cone": round_cone((0.0, -0.4, 0.0), (0.0, 0.4, 0.0), 0.05, 0.3),
    "half space": half_space(1.0, 2.0, -1.0, offset=0.1),
}
BOTH = {
    "union": union(sphere(0.4), box(0.2, 0.5, 0.2)),
    "intersection": intersection(sphere(0.4), box(0.2, 0.5, 0.2)),
    "subtraction": subtraction(sphere(0.5), cylinder(0.2, 0.9), torus(0.5, 0.1)),
    "smooth union": smooth_union(
        sphere(0.4), torus(0.5, 0.1).moved(y=0.3), capsule((0, 0, 0), (0.8, 0, 0), 0.1), k=0.2
    ),
    "smooth subtraction": smooth_subtraction(sphere(0.5), box(0.2, 0.9, 0.2), k=0.1),
    "smooth intersection": smooth_intersection(sphere(0.5), half_space(y=1, offset=0.2), k=0.2),
    "transforms": box(0.3, 0.2, 0.1).moved(0.3, 0.2, 0.1).turned("x", 30).turned("y", 90).turned("z", -70)
    .scaled(0.8).mirrored("x").mirrored("z").rounded(0.05).stretched(1.2, 0.7, 1.0),
}  # fmt: skip
SHAPES = {"car": car(), "fish": fish(), "monster": monster(), "rabbit": rabbit()}
ALL = {**PRIMITIVES, **BOTH, **SHAPES}

NO_OPENGL = gl_context.available()
every = pytest.mark.parametrize("name", ALL)


def points(count=4000, seed=0, half=1.2):
    return (torch.rand((count, 3), generator=torch.Generator().manual_seed(seed)) * 2 - 1) * half


def gradients(sdf, position):
    position = position.clone().requires_grad_()
    distance = sdf.distance(position)
    return distance.detach(), torch.autograd.grad(distance.sum(), position)[0]


# --- closed forms --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sdf", "place", "expected"),
    [
        (sphere(0.5), (0.0, 2.0, 0.0), 1.5),
        (sphere(0.5), (0.3, 0.0, 0.0), -0.2),
        (box(1.0, 2.0, 3.0), (4.0, 6.0, 3.0), 5.0),
        (box(1.0, 2.0, 3.0), (0.2, 0.0, 0.0), -0.8),
        (box(1.0, 2.0, 3.0, 0.5), (1.0, 2.0, 0.0), 0.5 * math.sqrt(2) - 0.5),
        (cylinder(1.0, 2.0), (3.0, 2.0, 0.0), 2.0),
        (cylinder(1.0, 2.0), (4.0, 6.0, 0.0), 5.0),
        (cylinder(1.0, 2.0), (0.0, 1.9, 0.0), -0.1),
        (torus(1.0, 0.25), (0.0, 0.0, 2.0), 0.75),
        (torus(1.0, 0.25), (0.0, 1.0, 1.0), 0.75),
        (capsule((0, 0, 0), (0, 0, 2), 0.5), (1.0, 0.0, 1.0), 0.5),
        (capsule((0, 0, 0), (0, 0, 2), 0.5), (3.0, 0.0, 6.0), 4.5),
        (round_cone((0, 0, 0), (0, 3, 0), 1.0, 0.5), (0.0, 5.0, 0.0), 1.5),
        (round_cone((0, 0, 0), (0, 3, 0), 1.0, 0.5), (0.0, -2.0, 0.0), 1.0),
        (half_space(y=2.0, offset=1.0), (5.0, 3.0, 1.0), 2.0),
        (ellipsoid(1.0, 2.0, 3.0), (2.0, 0.0, 0.0), 1.0),
        (sphere(0.5).moved(1.0, 2.0, 3.0), (1.0, 2.0, 4.0), 0.5),
        (sphere(0.5).scaled(2.0), (3.0, 0.0, 0.0), 2.0),
        (sphere(0.5).moved(x=1.0).turned("z", 90), (0.0, 1.0, 0.0), -0.5),
        (sphere(0.5).moved(y=1.0).turned("x", 90), (0.0, 0.0, 1.0), -0.5),
        (sphere(0.5).moved(z=1.0).turned("y", 90), (1.0, 0.0, 0.0), -0.5),
        (sphere(0.5).moved(x=1.0).mirrored("x"), (-1.0, 0.0, 0.0), -0.5),
        (box(0.5, 0.5, 0.5).rounded(0.1), (1.0, 0.0, 0.0), 0.4),
        (union(sphere(0.5), sphere(0.2).moved(x=2)), (1.5, 0.0, 0.0), 0.3),
        (intersection(sphere(1), half_space(y=1)), (0.0, 0.4, 0.0), 0.4),
        (subtraction(sphere(1), sphere(0.5)), (0.0, 0.0, 0.0), 0.5),
        # where both are equally near, Quilez's quadratic minimum is k / 4 below them
        (smooth_union(sphere(1), sphere(1), k=0.4), (2.0, 0.0, 0.0), 0.9),
        (smooth_union(sphere(1).moved(x=-3), sphere(1).moved(x=3), k=0.4), (2.0, 0.0, 0.0), 0.0),
        (smooth_subtraction(sphere(1), half_space(y=1, offset=0.0), k=0.4), (1.0, 0.0, 0.0), 0.1),
    ],
)  # fmt: skip
def test_closed_forms(sdf, place, expected):
    assert float(sdf.distance(torch.tensor([place]))) == pytest.approx(expected, abs=2e-6)


def test_round_cone_is_the_nearest_of_its_balls():
    start, end = torch.tensor([-0.3, -0.2, 0.1]), torch.tensor([0.4, 0.3, -0.2])
    place = points(500)
    share = torch.linspace(0, 1, 2001)[:, None, None]
    balls = (place - (start + share * (end - start))).norm(dim=2) - (0.25 + share[..., 0] * (0.05 - 0.25))
    torch.testing.assert_close(PRIMITIVES["round cone"].distance(place), balls.amin(0), atol=1e-5, rtol=0)


def test_ellipsoid_is_a_lower_bound():
    around = torch.randn((20000, 3), generator=torch.Generator().manual_seed(3))
    surface = around / around.norm(dim=1, keepdim=True) * torch.tensor([0.6, 0.3, 0.4])
    place = points(300)
    nearest = torch.cdist(place, surface).amin(1)
    assert (PRIMITIVES["ellipsoid"].distance(place).abs() <= nearest + 1e-6).all()


# --- back ends -----------------------------------------------------------------------------------------


@every
def test_floats_agree_with_torch(name):
    place = points(25)
    expected = ALL[name].distance(place)
    found = [ALL[name](*row) for row in place.tolist()]
    assert all(isinstance(value, float) for value in found)
    torch.testing.assert_close(torch.tensor(found), expected, atol=3e-6, rtol=0)


@pytest.mark.skipif(find_llvm() is None, reason="no LLVM")
@every
def test_drjit_agrees_with_torch(name):
    mi = mitsuba()
    place = points()
    found = ALL[name](*(mi.Float(column.numpy()) for column in place.T.contiguous()))
    assert isinstance(found, mi.Float)
    np.testing.assert_allclose(np.array(found), ALL[name].distance(place).numpy(), atol=3e-6)


@pytest.fixture(scope="module")
def evaluate():
    """From GLSL source of ``sdf`` and points to distances, drawn by a fragment shader."""
    if NO_OPENGL is not None:
        pytest.skip(NO_OPENGL)
    with gl_context.open_context() as context:

        def drawn(source, place):
            width = 64
            height = len(place) // width
            texture = context.texture((width, height), 3, place.numpy().tobytes(), dtype="f4")
            target = context.framebuffer([context.texture((width, height), 1, dtype="f4")])
            program = context.program(
                "#version 330\nvoid main() { gl_Position = vec4(vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0"
                " - 1.0, 0.0, 1.0); }",
                fragment_shader=f"#version 330\nuniform sampler2D places; out float d;\n{source}"
                "void main() { d = sdf(texelFetch(places, ivec2(gl_FragCoord.xy), 0).xyz); }",
            )
            target.use()
            texture.use(0)
            context.vertex_array(program, []).render(vertices=3)
            return torch.frombuffer(bytearray(target.read(components=1, dtype="f4")), dtype=torch.float32)

        yield drawn
    context.release()


@every
def test_glsl_agrees_with_torch(name, evaluate):
    place = points(64 * 32)
    torch.testing.assert_close(
        evaluate(ALL[name].glsl(), place), ALL[name].distance(place), atol=3e-6, rtol=0
    )


def test_functions_of_every_kind_agree(evaluate):
    def formula(x, y, z):
        return (
            sdf_ops.sin(x)
            + sdf_ops.cos(2.0 * y)
            - 1.0 / (2.0 + sdf_ops.absolute(z))
            + sdf_ops.clamp(-x, -0.2, 0.3)
        )

    sdf, place = Sdf(formula), points(64)
    expected = sdf.distance(place)
    torch.testing.assert_close(evaluate(sdf.glsl(), place), expected, atol=3e-6, rtol=0)
    torch.testing.assert_close(
        torch.tensor([sdf(*row) for row in place.tolist()]), expected, atol=3e-6, rtol=0
    )
    with pytest.raises(TypeError, match="ndarray"):
        sdf(np.zeros(3), np.zeros(3), np.zeros(3))


@every
def test_glsl_names_each_operation_once(name):
    source = ALL[name].glsl("shape_of")
    assert source.startswith("float shape_of(vec3 p) {\n") and source.endswith(";\n}\n")
    lines = source.splitlines()[1:-2]
    found = [re.fullmatch(r"    float (t\d+) = (.*);", line).groups() for line in lines]
    assert [temporary for temporary, _ in found] == [f"t{i}" for i in range(len(found))]
    assert len({expression for _, expression in found}) == len(found)
    for i, (_, expression) in enumerate(found):
        assert all(int(used) < i for used in re.findall(r"\bt(\d+)", expression))
        # at most one operator or call to a line
        assert len(re.findall(r" [-+*/] |\w\(", expression)) <= 1


def test_a_shared_part_is_written_once():
    ball = sphere(0.5).moved(y=0.25)
    assert union(ball, ball).glsl().count("sqrt") == 1


@pytest.mark.parametrize("value", [0.1, -1 / 3, 1e-20, 16777217.0, 3.0, 0, 1e30, -2])
def test_literals_keep_float32(value):
    text = literal(value).strip("()")
    assert np.float32(text) == np.float32(value)
    assert "." in text or "e" in text


@pytest.mark.parametrize("value", [1e39, math.inf, math.nan])
def test_literals_beyond_float32(value):
    with pytest.raises(PrtError, match="no finite float32"):
        GlslProgram().assigned("p.x") + value


# --- slopes --------------------------------------------------------------------------------------------


@every
def test_slope_is_at_most_one(name):
    sdf, place = ALL[name], points(20000)
    # half of them where it matters
    with torch.no_grad():
        place[10000:] *= 0.8
    distance, gradient = gradients(sdf, place)
    assert gradient.norm(dim=1).max() <= 1 + 1e-3
    # what autograd does not see: jumps
    step = torch.randn(place.shape, generator=torch.Generator().manual_seed(5)) * 0.02
    difference = (sdf.distance(place + step) - distance).abs()
    assert (difference <= step.norm(dim=1) * (1 + 1e-3) + 1e-6).all()


@every
def test_gradients_are_finite_at_centres_and_axes(name):
    values = torch.tensor([0.0, 0.1, -0.3, 0.25, 0.5, -0.5, 1e-7, 1e-20])
    distance, gradient = gradients(ALL[name], torch.cartesian_prod(values, values, values))
    assert distance.isfinite().all() and gradient.isfinite().all()
    assert gradient.norm(dim=1).max() <= 1 + 1e-3


@pytest.mark.parametrize("name", PRIMITIVES)
def test_gradients_are_those_of_differences(name):
    place = points(200, seed=1).double()
    _, gradient = gradients(PRIMITIVES[name], place)
    steps = 1e-6 * torch.eye(3, dtype=torch.float64)
    sdf = PRIMITIVES[name].distance
    expected = torch.stack([(sdf(place + s) - sdf(place - s)) / 2e-6 for s in steps], dim=1)
    torch.testing.assert_close(gradient, expected, atol=1e-5, rtol=0)


# --- what is refused -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: sphere(-1), "sphere radius=-1 must be above 0"),
        (lambda: sphere("wide"), "sphere radius='wide' must be a finite number"),
        (lambda: sphere(math.nan), "sphere radius=nan must be a finite number"),
        (lambda: ellipsoid(1, 0, 1), "ellipsoid y=0 must be above 0"),
        (lambda: box(1, 1, -1), "box z=-1 must be above 0"),
        (lambda: box(1, 1, 0.1, 0.2), "box radius=0.2 must lie between 0 and 0.1"),
        (lambda: cylinder(1, 0), "cylinder half=0 must be above 0"),
        (lambda: torus(0, 1), "torus radius=0 must be above 0"),
        (lambda: capsule((0, 0), (1, 0, 0), 1), r"start=\(0, 0\) must be 3 numbers"),
        (lambda: round_cone((0, 0, 0), (0.1, 0, 0), 0.5, 0.1), "must be more than the 0.4 between its radii"),
        (lambda: capsule((0, 0, 0), (0, 0, 0), 1), "must be more than the 0 between"),
        (lambda: half_space(), "must have a length"),
        (lambda: sphere(1).turned("w", 3), "turned axis='w' is not one of x, y, z"),
        (lambda: sphere(1).mirrored(0), "mirrored axis=0 is not one of x, y, z"),
        (lambda: sphere(1).scaled(0), "scaled factor=0 must be above 0"),
        (lambda: sphere(1).stretched(y=-1), "stretched y=-1 must be above 0"),
        (lambda: sphere(1).rounded(-0.1), "rounded radius=-0.1 must be above 0"),
        (lambda: sphere(1).moved(x=math.inf), "moved x=inf must be a finite number"),
        (lambda: smooth_union(sphere(1), sphere(2), k=0), "smooth_union k=0 must be above 0"),
        (lambda: smooth_subtraction(sphere(1), sphere(2), k=-1), "smooth_subtraction k=-1 must be above 0"),
        (lambda: smooth_intersection(sphere(1), k=True), "k=True must be a finite number"),
        (lambda: union(), "union has 0 parts"),
        (lambda: subtraction(sphere(1)), "subtraction has 0 parts"),
        (lambda: sphere(1).glsl("gl_sdf"), "glsl name='gl_sdf'"),
        (lambda: sphere(1).glsl("2d"), "glsl name='2d'"),
        (lambda: sphere(1).distance(torch.zeros(3)), r"shape \(3,\) must be \(N, 3\)"),
    ],
)
def test_bad_settings(made, message):
    with pytest.raises(PrtError, match=message) as caught:
        made()
    assert "\n" not in str(caught.value)

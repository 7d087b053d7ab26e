"""The stage: what moves is where it should be, lights move along, and nothing drifts or is compiled again."""

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.scene.mitsuba_file import MitsubaScene
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene
from prt.scene.shapes import diffuse, sphere_mesh, to_mesh, twosided
from prt.scene.stage import Stage

GREY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}}
#: a unit square at y = 3 that faces down
LAMP = [[0.5, 0, 0, 0], [0, 0, -1, 3], [0, 0.5, 0, 0], [0, 0, 0, 1]]
FLOOR = [[5, 0, 0, 0], [0, 0, 5, -1], [0, -5, 0, 0], [0, 0, 0, 1]]


def area(*radiance) -> dict:
    return {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}}


def parts() -> dict:
    """A cube, a ball and a lamp over a floor, in Mitsuba's dict format; the cube spans -1 to 1."""
    return {
        "wall": {"type": "twosided", "id": "wall", "bsdf": GREY},
        "box": {"type": "cube", "bsdf": GREY},
        "ball": {"type": "sphere", "center": [4, 0, 0], "radius": 0.5, "bsdf": GREY},
        "floor": {"type": "rectangle", "to_world": FLOOR, "bsdf": {"type": "twosided", "bsdf": GREY}},
        "lamp": {"type": "rectangle", "to_world": LAMP, "bsdf": GREY, "emitter": area(4.0, 3.0, 2.0)},
        "spark": {
            "type": "point",
            "position": [0, 4, 0],
            "intensity": {"type": "rgb", "value": [1.0, 1.0, 1.0]},
        },
    }


VARIABLES = {
    "slide": {"translate": {"shapes": ["box"], "start": [0, 0, 0], "end": [2, 0.25, 0]}},
    "turn": {"rotate": {"shapes": ["box"], "axis": [0, 1, 0], "start": 0, "end": 90}},
    "grow": {"scale": {"shapes": ["box"], "start": 1, "end": 2}},
    "roll": {"translate": {"shapes": ["ball"], "start": [0, 0, 0], "end": [0, 0, 1.5]}},
    "lamp": {"translate": {"shapes": ["lamp"], "start": [0, 0, 0], "end": [1.5, 0.5, 0]}},
    "power": {"value": {"parameter": "lamp.emitter.radiance.value", "start": [4, 3, 2], "end": [8, 0, 1]}},
    "paint": {"value": {"parameter": "floor.bsdf.reflectance.value", "start": [0.5] * 3, "end": [0.1, 0.6, 0]}},  # noqa: E501
    "spark": {"value": {"parameter": "spark.position", "start": [0, 4, 0], "end": [1, 4, 2]}},
    "light": {"value": {"parameter": "spark.intensity.value", "start": 1.0, "end": 3.0}},
}  # fmt: skip


def stage(*names: str, content: dict | None = None, more: tuple[dict, ...] = ()) -> Stage:
    """Of these of the variables above, and of others."""
    variables = [{"name": name, **VARIABLES[name]} for name in names] + list(more)
    return Stage(MitsubaScene(path=content or parts(), animation={"variables": variables}))


def hits(where: Stage, origin, direction):
    """The intersection of one ray."""
    mi = mitsuba()
    return where.mi_scene.ray_intersect(mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction)))


def height(where: Stage, x: float, z: float, above: float = 2.5) -> float:
    """Of the first thing below (x, above, z)."""
    return float(np.array(hits(where, (x, above, z), (0, -1, 0)).p).reshape(3)[1])


def everything(where: Stage) -> dict[str, bytes]:
    """All parameters of the live scene."""
    params = mitsuba().traverse(where.mi_scene)
    return {key: np.array(getattr(params[key], "matrix", params[key])).tobytes() for key in params.keys()}


def test_moved_mesh_is_hit_where_it_is():
    where = stage("slide")
    where.set([0.0])
    assert height(where, 0.9, 0.0) == pytest.approx(1.0, abs=1e-6) and height(where, 1.2, 0.0) == -1.0
    where.set([1.0])
    assert height(where, 0.9, 0.0) == -1.0 and height(where, 1.2, 0.0) == pytest.approx(1.25, abs=1e-6)
    where.set([0.5])
    assert height(where, 1.9, 0.0) == pytest.approx(1.125, abs=1e-6) and height(where, 2.1, 0.0) == -1.0
    where.set([1.5])
    assert height(where, 3.9, 0.0) == pytest.approx(1.375, abs=1e-6)


def test_turned_and_scaled_mesh_with_its_normals():
    where = stage("turn", "grow")
    where.set([0.5, 0.0])
    # by 45 degrees a corner points along x, and the sides face between the axes
    assert height(where, 1.4, 0.0) == pytest.approx(1.0, abs=1e-6) and height(where, 1.0, 1.0) == -1.0
    si = hits(where, (3, 0, 0.5), (-1, 0, 0))
    assert float(si.t[0]) == pytest.approx(3 - (2**0.5 - 0.5), abs=1e-5)
    for normal in (si.n, si.sh_frame.n):
        np.testing.assert_allclose(np.array(normal).reshape(3), [0.5**0.5, 0, 0.5**0.5], atol=1e-5)
    where.set([0.0, 1.0])
    assert height(where, 1.9, 1.9) == pytest.approx(2.0, abs=1e-6)


def test_normals_go_with_the_inverse_transpose():
    class Egg(Scene):
        animation = MitsubaScene(
            path=parts(),
            animation={
                "variables": [
                    {"name": "s", "scale": {"shapes": ["ball"], "start": [1, 1, 1], "end": [1, 3, 1]}}
                ]
            },
        ).animation

        def description(self):
            return {"ball": to_mesh("ball", sphere_mesh(1.0, 96, 48), twosided(diffuse((0.5, 0.5, 0.5))))}

        def lights(self):
            return {"sky": {"type": "constant"}}

    where = Stage(Egg("egg", {"train": [lambda p: []], "far": [lambda p: []]}))
    where.set([1.0])
    for y in (-2.0, 0.3, 1.0, 2.5):
        si = hits(where, (3, y, 0), (-1, 0, 0))
        p, n = np.array(si.p).reshape(3), np.array(si.sh_frame.n).reshape(3)
        true = p / np.array([1, 9, 1])
        np.testing.assert_allclose(n, true / np.linalg.norm(true), atol=4e-3)


def test_shapes_that_are_no_meshes_move_too():
    where = stage("roll")
    where.set([0.0])
    assert height(where, 4.0, 0.0) == pytest.approx(0.5, abs=1e-5)
    where.set([1.0])
    assert height(where, 4.0, 0.0) == -1.0 and height(where, 4.0, 1.5) == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize("mesh", [False, True])
def test_a_lamp_moves_with_its_shape(mesh):
    """What is sampled, its density and what a ray sees, for a rectangle and for a mesh."""
    mi, content = mitsuba(), parts()
    import drjit as dr

    del content["spark"]
    if mesh:
        flat = np.array(LAMP, dtype=float)
        flat[:3, 2] *= 1e-4  # a cube, flat: its lower face is the lamp seen from below
        content["lamp"] = {**content["lamp"], "type": "cube", "to_world": flat.tolist()}
    where = stage("lamp", content=content)
    for v in (0.0, 1.0, 0.25):
        where.set([v])
        it = dr.zeros(mi.Interaction3f, 512)
        it.p = mi.Point3f(np.tile(np.array([[0.0], [-0.5], [2.0]]), 512))
        samples = mi.Point2f(np.random.default_rng(0).random((2, 512)))
        ds, _ = where.mi_scene.sample_emitter_direction(it, samples, test_visibility=False)
        p, pdf = np.array(ds.p), np.array(ds.pdf)
        low, high = np.array([1.5 * v - 0.5, 3 + 0.5 * v, -0.5]), np.array([1.5 * v + 0.5, 3 + 0.5 * v, 0.5])
        lower = np.array(ds.n)[1] < -0.99
        assert (p.T >= low - 2e-4).all() and (p.T <= high + 2e-4).all()
        np.testing.assert_allclose(p.T.mean(0), (low + high) / 2, atol=0.06)
        d, area_of = p - np.array(it.p), 1.0 if not mesh else 2.0
        far = np.linalg.norm(d, axis=0)
        if not mesh:
            np.testing.assert_allclose(pdf, far**3 / np.abs(d[1]) / area_of, rtol=1e-3)
        else:
            np.testing.assert_allclose(pdf[lower], (far**3 / np.abs(d[1]) / area_of)[lower], rtol=2e-3)
        for x, seen in ((1.5 * v + 0.45, 4.0), (1.5 * v + 0.55, 0.0), (1.5 * v - 0.55, 0.0)):
            si = hits(where, (x, 2.0, 0.0), (0, 1, 0))
            assert float(si.emitter(where.mi_scene).eval(si)[0][0]) == pytest.approx(seen)


def test_values_of_materials_and_lamps():
    import drjit as dr

    mi = mitsuba()
    where = stage("power", "paint", "spark", "light")
    where.set([0.5, 0.5, 1.0, 0.5])
    si = hits(where, (0, 2, 0), (0, 1, 0))
    np.testing.assert_allclose(
        np.array(si.emitter(where.mi_scene).eval(si)).reshape(3), [6, 1.5, 1.5], rtol=1e-6
    )
    si = hits(where, (3, 2, 3), (0, -1, 0))
    found = si.bsdf().eval_diffuse_reflectance(si)
    np.testing.assert_allclose(np.array(found).reshape(3), [0.3, 0.55, 0.25], rtol=1e-6)
    spark = next(e for e in where.mi_scene.emitters() if not e.is_environment() and e.id() == "spark")
    it = dr.zeros(mi.Interaction3f)
    it.p = mi.Point3f(1, 3, 2)
    ds, weight = spark.sample_direction(it, mi.Point2f(0.5, 0.5))
    np.testing.assert_allclose(np.array(ds.p).reshape(3), [1, 4, 2])
    np.testing.assert_allclose(np.array(weight).reshape(3), 2.0, rtol=1e-5)


def test_the_environment_turns(tmp_path):
    import drjit as dr

    mi = mitsuba()
    image = np.zeros((16, 32, 3), dtype=np.float32)
    image[6:10, 20:23] = (5.0, 2.0, 1.0)
    mi.Bitmap(image + 0.1).write(str(tmp_path / "sky.exr"))
    turn = [[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]
    sky = {"type": "envmap", "filename": str(tmp_path / "sky.exr"), "to_world": turn}
    content = {"box": {"type": "cube", "bsdf": GREY}, "sky": sky}
    where = stage(content=content, more=({"name": "turn", "rotate_environment": {"start": 0, "end": 90}},))
    rng = np.random.default_rng(1)
    d = rng.normal(size=(3, 4096))
    d /= np.linalg.norm(d, axis=0)

    def seen(directions):
        si = mi.SurfaceInteraction3f()
        si.wi = -mi.Vector3f(directions)
        return np.array(where.mi_scene.environment().eval(si))

    where.set([0.0])
    before = seen(d)
    assert before.max() > 4
    for v in (1.0, 0.4):
        where.set([v])
        angle = np.radians(90 * v)
        back = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
        where_now = seen(d)
        where.set([0.0])
        np.testing.assert_allclose(where_now, seen(back @ d), atol=2e-3)
        where.set([v])
        it = dr.zeros(mi.Interaction3f, 4096)
        ds, weight = where.mi_scene.environment().sample_direction(it, mi.Point2f(rng.random((2, 4096))))
        np.testing.assert_allclose(
            np.array(weight) * np.array(ds.pdf), seen(np.array(ds.d)), rtol=2e-2, atol=2e-2
        )


def test_the_same_state_is_the_same_data_whatever_came_before():
    names = [*VARIABLES]
    where, other = stage(*names), stage(*names)
    v, w = np.random.default_rng(0).random((2, len(names))).tolist()
    where.set(v)
    first = everything(where)
    where.set(v)
    assert everything(where) == first
    for _ in range(3):
        where.set(w)
        assert everything(where) != first
        where.set(v)
    assert everything(where) == first
    other.set(w)
    other.set([0.0] * len(names))
    other.set(v)
    assert everything(other) == first
    other.set(torch.tensor(v, dtype=torch.float64))
    assert everything(other) == first and other.state == v


def test_at_the_start_things_stand_as_the_file_says():
    names = [*VARIABLES]
    where, plain = stage(*names), stage()
    where.set([0.0] * len(names))
    before, now = everything(plain), everything(where)
    assert {key for key in before if before[key] != now[key]} == set()


def test_states_that_are_wrong_change_nothing():
    where = stage("slide", "paint")
    where.set([0.25, 0.5])
    before = everything(where)
    for wrong in ([0.5], [0.5, float("nan")], [0.1, 0.2, 0.3]):
        with pytest.raises(PrtError):
            where.set(wrong)
        assert where.state == [0.25, 0.5] and everything(where) == before


def test_only_what_changed_is_moved(monkeypatch):
    where, moved = stage("slide", "roll", "paint"), []
    where.set([0.5, 0.1, 0.2])
    keep = type(where.params).__setitem__
    monkeypatch.setattr(
        type(where.params),
        "__setitem__",
        lambda self, key, value: (moved.append(key), keep(self, key, value)),
    )
    where.set([0.5, 0.1, 0.9])
    assert moved == ["floor.bsdf.reflectance.value"] or moved == ["floor.bsdf.brdf_0.reflectance.value"]
    moved.clear()
    where.set([0.5, 0.7, 0.9])
    assert moved == ["ball.to_world"]
    moved.clear()
    where.set([0.5, 0.7, 0.9])
    assert moved == []


def test_no_kernel_is_compiled_again():
    import drjit as dr

    mi = mitsuba()
    where = stage(*VARIABLES)
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at([0, 4, 8], [1, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16},
        }
    )
    integrator = mi.load_dict({"type": "path", "max_depth": 4})
    rng, images = np.random.default_rng(3), []
    corners = [np.zeros(9), np.ones(9)]
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for v in [*rng.random((3, 9)), *corners, *rng.random((4, 9))]:
            dr.kernel_history_clear()
            where.set(v.tolist())
            images.append(np.array(mi.render(where.mi_scene, sensor=sensor, integrator=integrator, spp=4)))
            history = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
            assert any(kernel["uses_optix"] for kernel in history) or history
            # the first states may meet cases that are new: a mesh whose data were still those of the file
            if len(images) > 2:
                assert [kernel for kernel in history if not kernel["cache_hit"]] == []
    assert all(np.isfinite(image).all() for image in images)
    assert min(np.abs(a - b).mean() for a, b in zip(images, images[1:], strict=False)) > 1e-3


def test_a_moved_scene_looks_like_one_built_there():
    """Same random numbers, same image: in every respect that counts the state is the scene built in it."""
    mi = mitsuba()
    moved = stage("slide", "roll", "lamp", "power", "paint")
    moved.set([1.0, 1.0, 1.0, 1.0, 1.0])
    there = parts()
    there["box"] = {**there["box"], "to_world": [[1, 0, 0, 2], [0, 1, 0, 0.25], [0, 0, 1, 0], [0, 0, 0, 1]]}
    there["ball"] = {**there["ball"], "center": [4, 0, 1.5]}
    lamp = np.array(LAMP, dtype=float)
    lamp[:3, 3] += [1.5, 0.5, 0]
    there["lamp"] = {**there["lamp"], "to_world": lamp.tolist(), "emitter": area(8.0, 0.0, 1.0)}
    green = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.6, 0.0]}}
    there["floor"] = {**there["floor"], "bsdf": {"type": "twosided", "bsdf": green}}
    built = stage(content=there)
    camera = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0, 4, 8], [1, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 32, "height": 32},
    }
    integrator = mi.load_dict({"type": "path", "max_depth": 5})
    a, b = (
        np.array(mi.render(s.mi_scene, sensor=mi.load_dict(camera), integrator=integrator, spp=16, seed=5))
        for s in (moved, built)
    )
    # rays along an edge may fall to either side of it
    assert (np.abs(a - b) > 1e-3 * (1 + b)).any(axis=2).mean() < 0.01
    assert a.mean() == pytest.approx(b.mean(), rel=2e-3)


def value(parameter: str, start, end) -> dict:
    return {"name": parameter, "value": {"parameter": parameter, "start": start, "end": end}}


def zoo(folder) -> tuple[dict, tuple[dict, ...]]:
    """What the scene above lacks: environment map, spot, disk, float parameters, a mesh with odd normals."""
    mi = mitsuba()
    image = np.ones((8, 16, 3), dtype=np.float32)
    image[2:4, 2:5] = (9.0, 4.0, 1.0)
    mi.Bitmap(image).write(str(folder / "sky.exr"))
    lines = ["v -3 -1 -3", "v 3 -1 -3", "v 3 -1 3", "v -3 -1 3", "vn 0.6 0.8 0", "vn 0 0.8 0.6"]
    (folder / "odd.obj").write_text("\n".join([*lines, "f 1//1 3//2 2//1", "f 1//1 4//1 3//2", ""]))
    content = {
        "odd": {"type": "obj", "filename": str(folder / "odd.obj"), "bsdf": GREY},
        "coat": {"type": "cube", "bsdf": {"type": "roughplastic", "alpha": 0.1}},
        "metal": {
            "type": "sphere",
            "center": [2, 1, 0],
            "radius": 0.6,
            "bsdf": {"type": "roughconductor", "alpha": 0.1},
        },
        "disk": {"type": "disk", "to_world": LAMP, "bsdf": GREY, "emitter": area(3.0, 3.0, 3.0)},
        "spot": {"type": "spot", "to_world": LAMP, "intensity": {"type": "rgb", "value": [9.0, 9.0, 9.0]}},
        "sky": {"type": "envmap", "filename": str(folder / "sky.exr")},
    }
    variables = (
        {"name": "turn", "rotate_environment": {"start": 0, "end": 90}},
        value("coat.alpha", 0.05, 0.5),
        value("metal.alpha.value", 0.05, 0.5),
        value("coat.eta", 1.3, 1.9),
        value("sky.scale", 0.5, 1.5),
        value("spot.sampling_weight", 0.5, 2.0),
        value("spot.cutoff_angle", 20, 50),
        {"name": "spot", "translate": {"shapes": ["spot"], "start": [0, 0, 0], "end": [1, 0, 0]}},
        {"name": "disk", "rotate": {"shapes": ["disk"], "axis": [1, 0, 0], "start": 0, "end": 30}},
        {
            "name": "metal",
            "scale": {"shapes": ["metal"], "centre": [2, 1, 0], "start": 0.5, "end": 1.5},
            "rotate": {"shapes": ["metal"], "axis": [0, 1, 0], "start": 0, "end": 50},
        },
        {"name": "odd", "translate": {"shapes": ["odd"], "start": [0, 0, 0], "end": [0, 0.3, 0]}},
    )
    return content, variables


def test_every_kind_of_parameter_changes_the_image_and_compiles_nothing(tmp_path):
    import drjit as dr

    mi = mitsuba()
    content, variables = zoo(tmp_path)
    where, count = stage(content=content, more=variables), len(variables)
    camera = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0, 3, 7], [1, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 24, "height": 24},
    }
    sensor, integrator = mi.load_dict(camera), mi.load_dict({"type": "path", "max_depth": 4})

    def image(v):
        where.set(v.tolist())
        return np.array(mi.render(where.mi_scene, sensor=sensor, integrator=integrator, spp=8, seed=1))

    rng = np.random.default_rng(2)
    for v in rng.random((2, count)):
        image(v)
    base = np.full(count, 0.4)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        first = image(base)
        for i, variable in enumerate(variables):
            other = base.copy()
            other[i] = 0.9
            assert np.abs(image(other) - first).mean() > 1e-5 * first.mean(), variable["name"]
        np.testing.assert_allclose(image(base), first, rtol=1e-4, atol=1e-5)
        history = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert history and [k for k in history if not k["cache_hit"]] == []


def test_normals_of_the_file_are_kept(tmp_path):
    """Moving vertices makes Mitsuba compute smooth normals anew; those of the file must win."""
    content, variables = zoo(tmp_path)
    turn = {"name": "turn", "rotate": {"shapes": ["odd"], "axis": [0, 1, 0], "start": 0, "end": 90}}
    where = stage(content=content, more=(variables[-1], turn))

    def normals():
        return np.array(mitsuba().traverse(where.mi_scene)["odd.vertex_normals"]).reshape(-1, 3)

    where.set([0.0, 0.0])
    rest = normals()
    assert len(np.unique(rest.round(4), axis=0)) == 2
    where.set([1.0, 0.0])
    assert (normals() == rest).all()
    where.set([1.0, 1.0])
    np.testing.assert_allclose(normals(), np.stack([rest[:, 2], rest[:, 1], -rest[:, 0]], axis=1), atol=1e-6)


@pytest.mark.parametrize("mesh", [False, True])
def test_nothing_is_scaled_inside_out(mesh):
    """It is an error that names the shape, and the state stays what it was."""
    shape = "box" if mesh else "ball"
    grow = {"name": "grow", "scale": {"shapes": [shape], "centre": [4, 0, 0], "start": 0.1, "end": 1.1}}
    where = stage("paint", more=(grow,))
    where.set([0.3, 0.0])
    before = everything(where)
    for beyond in (-0.1, -0.5):
        with pytest.raises(PrtError, match=f"'{shape}' to nothing or inside out") as caught:
            where.set([0.8, beyond])
        assert "\n" not in str(caught.value)
        assert everything(where) == before and where.state == [0.3, 0.0]
    where.set([0.3, 1.0])
    where.set([0.3, 0.0])
    assert everything(where) == before


def test_a_sphere_makes_no_egg():
    egg = {"name": "egg", "scale": {"shapes": ["ball"], "start": [1, 1, 1], "end": [1, 2, 1]}}
    with pytest.raises(PrtError, match="'ball' by three different factors, which a sphere") as caught:
        stage(more=(egg,))
    assert "scene.animation" in str(caught.value) and "\n" not in str(caught.value)
    even = {"name": "even", "scale": {"shapes": ["ball"], "centre": [4, 0, 0], "start": 1, "end": [2] * 1}}
    where = stage(more=(even,))
    where.set([1.0])
    assert height(where, 4.9, 0.0) == pytest.approx((1 - 0.81) ** 0.5, abs=1e-4)


def test_rectangles_turn_and_stretch():
    """The floor, with a matrix of its own, tilted by 30 degrees; the lamp twice as long along x."""
    tilt = {
        "name": "tilt",
        "rotate": {"shapes": ["floor"], "axis": [0, 0, 1], "centre": [0, -1, 0], "start": 0, "end": 30},
    }
    long = {
        "name": "long",
        "scale": {"shapes": ["lamp"], "centre": [0, 3, 0], "start": [1, 1, 1], "end": [2, 1, 1]},
    }
    where = stage(more=(tilt, long))
    where.set([1.0, 1.0])
    assert height(where, 3.0, 3.0) == pytest.approx(3 * np.tan(np.radians(30)) - 1, abs=1e-5)
    si = hits(where, (3, 2, 3), (0, -1, 0))
    np.testing.assert_allclose(np.array(si.n).reshape(3), [-0.5, 0.75**0.5, 0], atol=1e-5)
    for x, seen in ((0.95, True), (1.05, False)):
        si = hits(where, (x, 2.0, 0.0), (0, 1, 0))
        assert bool(si.is_valid()[0]) == seen


def test_an_equal_state_updates_nothing(monkeypatch):
    where, updates = stage("slide", "paint"), []
    where.set([0.2, 0.4])
    monkeypatch.setattr(type(where.params), "update", lambda self, *a, **k: updates.append(1))
    where.set([0.2, 0.4])
    where.set(np.array([0.2, 0.4]))
    where.set(torch.tensor([0.2, 0.4], dtype=torch.float64))
    assert updates == []
    where.set([0.2, 0.5])
    assert updates == [1]


def test_what_is_compiled_into_kernels_is_said_beforehand():
    content = {**parts(), "ball": {"type": "cube", "bsdf": {"type": "plastic"}}}
    with pytest.warns(UserWarning, match="'ball.bsdf.eta'.*compiles") as caught:
        where = stage(content=content, more=(value("ball.bsdf.eta", 1.3, 1.7),))
    assert len(caught) == 1 and "\n" not in str(caught[0].message)
    where.set([1.0])
    assert mitsuba().traverse(where.mi_scene)["ball.bsdf.eta"] == pytest.approx(1.7)


@pytest.mark.parametrize(
    ("variable", "named"),
    [
        ({"translate": {"shapes": ["bax"], "start": [0, 0, 0], "end": [1, 0, 0]}}, "'bax'.*box"),
        ({"rotate": {"shapes": ["box", "Ball"], "axis": [0, 1, 0], "start": 0, "end": 1}}, "'Ball'.*ball"),
        (
            {"value": {"parameter": "lamp.emiter.radiance.value", "start": 1, "end": 2}},
            "'lamp.emiter.radiance.value'.*lamp.emitter.radiance.value",
        ),
        (
            {"value": {"parameter": "lamp.emitter.radiance.value", "start": [1, 2], "end": [2, 3]}},
            "lamp.emitter",
        ),
        ({"value": {"parameter": "box.faces", "start": 1, "end": 2}}, "box.faces"),
        ({"rotate_environment": {"start": 0, "end": 9}}, "no environment map"),
    ],
)
def test_names_that_the_scene_lacks(variable, named):
    with pytest.raises(PrtError, match=named) as caught:
        stage(more=({"name": "x", **variable},))
    assert "scene.animation" in str(caught.value) and "\n" not in str(caught.value)


def test_a_scene_without_variables_stands_still():
    where = stage()
    assert where.animation.dimension == 0 and where.state == []
    where.set([])
    with pytest.raises(PrtError):
        where.set([0.5])

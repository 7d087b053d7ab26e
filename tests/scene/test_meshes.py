"""Analytic shapes as meshes, and the meshes of a scene as one."""

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.scene.meshes import as_meshes, one_mesh
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.panels import block, panel
from prt.scene.shapes import to_mesh

KINDS = ("rectangle", "disk", "sphere", "cylinder")
GREY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.4, 0.2]}}


def placement(mirrored: bool = False):
    """Turned, stretched and moved; perhaps mirrored too."""
    place = mitsuba().ScalarTransform4f().translate([0.3, -0.2, 0.5]).rotate([0.36, 0.48, 0.8], 50)
    return place.scale([-0.9 if mirrored else 0.9, 0.9, 0.9])


def shape(kind: str, flipped: bool = False, mirrored: bool = False, bsdf=GREY):
    return mitsuba().load_dict(
        {"type": kind, "id": "it", "flip_normals": flipped, "to_world": placement(mirrored), "bsdf": bsdf}
    )


def sampled(found):
    """500 points on a shape and its normals there, by its own sampling."""
    mi = mitsuba()
    random = np.random.default_rng(0).random((2, 500)).astype(np.float32)
    sample = found.sample_position(0, mi.Point2f(random))
    normals = np.broadcast_to(np.array(sample.n).T, (500, 3)).copy()
    return np.array(sample.p).T, normals


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_vertices_and_normals_of_analytic_shapes(kind, flipped, mirrored):
    found = shape(kind, flipped, mirrored)
    (mesh,) = as_meshes([found])
    whole, uv = one_mesh([mesh])

    matrix = np.array(placement(mirrored).matrix)
    x, y, z = (np.linalg.inv(matrix) @ np.c_[whole.position.numpy(), np.ones(len(whole.position))].T)[:3]
    flat = (np.abs(z) < 1e-5) if kind in ("rectangle", "disk") else True
    on = {
        "rectangle": flat & (np.maximum(abs(x), abs(y)) < 1 + 1e-5),
        "disk": flat & (x * x + y * y < 1 + 1e-5),
        "sphere": np.abs(x * x + y * y + z * z - 1) < 1e-4,
        "cylinder": (np.abs(x * x + y * y - 1) < 1e-4) & (z > -1e-5) & (z < 1 + 1e-5),
    }[kind]
    assert on.all()

    a, b, c = (whole.position[whole.face[:, k]] for k in range(3))
    cross = torch.linalg.cross(b - a, c - a)
    area = float(cross.norm(dim=1).sum()) / 2
    assert area == pytest.approx(float(np.array(found.surface_area()).ravel()[0]), rel=5e-3)
    # winding and vertex normals on one side, and that is the side the shape itself says
    assert bool(((cross[:, None] * whole.normal[whole.face]).sum(2) > 0).all())
    place, normal = sampled(found)
    if kind == "sphere":  # Mitsuba 3.9.1 does not turn the normals it samples with the sphere
        mi = mitsuba()
        outward = (place - np.array(placement().matrix)[:3, 3]) / 0.9
        rays = mi.Ray3f(mi.Point3f((place + outward).T.copy()), mi.Vector3f(-outward.T.copy()))
        hit = mi.load_dict({"type": "scene", "it": found}).ray_intersect(rays)
        normal = np.array(hit.n).T.astype(np.float32)
    for number in range(0, 500, 25):
        nearest = int((whole.position - torch.from_numpy(place[number])).norm(dim=1).argmin())
        assert float(whole.normal[nearest] @ torch.from_numpy(normal[number])) > 0.97
    assert uv is not None and uv.shape == (len(whole.face), 3, 2)


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_mesh_looks_like_the_shape_it_is_made_of(kind, flipped):
    # one-sided: a mesh that is inside out would be black
    mi = mitsuba()
    found = shape(kind, flipped)
    sensor = {
        "type": "perspective", "fov": 40.0, "sampler": {"type": "independent", "sample_count": 16},
        "to_world": mi.ScalarTransform4f().look_at([2.5, 1.5, 3.0], [0.3, -0.2, 0.6], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"},
                 "pixel_format": "rgb"},
    }  # fmt: skip
    lamp = {"type": "point", "position": [2.0, 2.0, 2.0], "intensity": {"type": "rgb", "value": 10.0}}
    integrator, images = mi.load_dict({"type": "path", "max_depth": 2}), []
    for one in (found, as_meshes([found])[0]):
        scene = mi.load_dict({"type": "scene", "shape": one, "lamp": lamp, "sensor": sensor})
        images.append(np.array(mi.render(scene, integrator=integrator, seed=3)))
    exact, mesh = images
    if not flipped or kind == "cylinder":
        assert exact.mean() > 0.005
    assert np.abs(exact - mesh).mean() < 0.02 * max(exact.mean(), 1e-3)


def test_meshes_and_cubes_stay_as_they_are():
    cube, panel_mesh = shape("cube"), to_mesh("p", panel((0, 0, 0), (1, 0, 0), (0, 1, 0)), GREY)
    assert as_meshes([cube, panel_mesh]) == [cube, panel_mesh]


def test_what_is_within_a_shape_stays_within_it():
    medium = {"type": "homogeneous", "sigma_t": 2.0, "albedo": 0.8}
    found = mitsuba().load_dict({"type": "sphere", "bsdf": {"type": "null"}, "interior": medium})
    (mesh,) = as_meshes([found])
    assert mesh.is_medium_transition() and mesh.interior_medium() is not None
    plain = as_meshes([shape("sphere")])[0]
    assert plain.interior_medium() is None and plain.id() == "it"


def test_shapes_without_triangles_are_refused_in_one_line(tmp_path):
    (tmp_path / "curve.txt").write_text("0 0 0 0.1\n1 0 0 0.1\n2 0 0 0.1\n3 0 0 0.1\n")
    curve = mitsuba().load_dict(
        {"type": "bsplinecurve", "id": "lock", "filename": str(tmp_path / "curve.txt")}
    )
    with pytest.raises(
        PrtError, match="'lock' is a BSplineCurve.*rectangle, disk, sphere, cylinder"
    ) as caught:
        as_meshes([curve])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("flipped", [False, True])
def test_flipped_normals_of_meshes_are_flipped(flipped):
    mi = mitsuba()
    cube = mi.load_dict({"type": "cube", "flip_normals": flipped})
    mesh, _ = one_mesh([cube])
    outward = (mesh.position * mesh.normal).sum(1)
    a, b, c = (mesh.position[mesh.face[:, k]] for k in range(3))
    wound = (torch.linalg.cross(b - a, c - a) * a).sum(1)
    assert bool(((outward < 0) == flipped).all()) and bool(((wound < 0) == flipped).all())


def test_face_normals_make_flat_triangles():
    mi = mitsuba()
    ball = as_meshes([shape("sphere")])[0]
    smooth, _ = one_mesh([ball])
    flat_cube = mi.load_dict({"type": "cube", "face_normals": True})
    mesh, _ = one_mesh([flat_cube])
    assert len(mesh.position) == 3 * len(mesh.face) == 36
    a, b, c = (mesh.position[mesh.face[:, k]] for k in range(3))
    normal = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1)
    for k in range(3):
        assert torch.allclose(mesh.normal[mesh.face[:, k]], normal, atol=1e-6)
    assert len(smooth.position) < len(smooth.face)


def test_one_mesh_of_several_counts_through():
    cube, ball = shape("cube"), as_meshes([shape("sphere")])[0]
    mesh, uv = one_mesh([cube, ball])
    faces = [cube.face_count(), ball.face_count()]
    assert uv is None and len(mesh.face) == sum(faces)
    assert mesh.shape.tolist() == [0] * faces[0] + [1] * faces[1]
    alone, own = one_mesh([ball])
    assert torch.equal(mesh.position[mesh.face[faces[0] :]], alone.position[alone.face]) and own is not None
    assert torch.equal(mesh.normal[mesh.face[faces[0] :]], alone.normal[alone.face])


def test_normals_that_are_not_finite_are_mended():
    data = block((0, 0, 0), (1, 1, 1))
    normal = data.normal.copy()
    normal[:2] = np.nan
    normal[2] = 0.0
    broken = to_mesh("it", type(data)(data.position, normal, data.uv, data.face), GREY)
    mesh, _ = one_mesh([broken])
    assert torch.allclose(mesh.normal, torch.from_numpy(data.normal).float(), atol=1e-5)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_that_are_not_finite_are_refused(value):
    data = block((0, 0, 0), (1, 1, 1))
    position = data.position.copy()
    position[3, 1] = value
    mesh = to_mesh("it", type(data)(position, data.normal, data.uv, data.face), GREY)
    mesh.set_id("it")
    with pytest.raises(PrtError, match="shape 'it' has vertices that are not finite") as caught:
        one_mesh([mesh])
    assert "\n" not in str(caught.value)
    with pytest.raises(PrtError, match="no shapes"):
        one_mesh([])

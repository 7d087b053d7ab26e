"""Bending and closing meshes."""

import dataclasses

import numpy as np
import pytest

from prt.errors import PrtError
from prt.scene.closing import capped, mesh_data, open_edges
from prt.scene.deform import bend, deformed
from prt.scene.panels import block, joined, panel
from prt.scene.shapes import diffuse, sphere_mesh, to_mesh


def volume(data) -> float:
    a, b, c = (data.position[data.face[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0


def test_normals_of_a_stretched_sphere_are_those_of_the_ellipsoid():
    half = np.array([2.0, 0.5, 1.0])
    data = deformed(sphere_mesh(1.0), lambda p: half * p + [1.0, 2.0, 3.0])
    exact = (data.position - [1.0, 2.0, 3.0]) / half**2
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    assert (data.normal * exact).sum(axis=1).min() > 0.999


@pytest.mark.parametrize("angle", [0.0, 1e-6, 35.0, 60.0])
@pytest.mark.parametrize("side", [0.0, 90.0, 200.0])
def test_bending_keeps_the_foot_and_the_length_of_the_axis(angle, side):
    change = bend(angle, side, 1.5)
    axis = np.stack([np.zeros(301), np.linspace(0.0, 1.5, 301), np.zeros(301)], 1)
    bent = change(axis)
    assert np.linalg.norm(np.diff(bent, axis=0), axis=1).sum() == pytest.approx(1.5, rel=1e-4)
    ground = np.array([[0.3, 0.0, -0.2], [-0.1, 0.0, 0.3]])
    assert np.allclose(change(ground), ground)
    tip = bent[-1] - bent[-2]
    lean = np.degrees(np.arccos(np.clip(tip[1] / np.linalg.norm(tip), -1, 1)))
    assert lean == pytest.approx(angle, abs=0.15)
    if angle > 1.0:
        cosine, sine = np.cos(np.radians(side)), np.sin(np.radians(side))
        assert bent[-1, [0, 2]] @ [cosine, -sine] == pytest.approx(np.linalg.norm(bent[-1, [0, 2]]))


def test_holes_are_found_and_closed():
    whole = block((0, 0, 0), (1, 2, 3))
    assert len(open_edges(whole)) == 0 and len(capped(whole).face) == 12
    holed = block((0, 0, 0), (1, 2, 3), without=("top", "bottom"))
    assert len(open_edges(holed)) == 8
    closed = capped(holed)
    assert len(open_edges(closed)) == 0 and volume(closed) == pytest.approx(6.0)
    lids = closed.normal[len(holed.position) :]
    assert {tuple(n) for n in lids.round(6).tolist()} == {(0.0, 1.0, 0.0), (0.0, -1.0, 0.0)}


def test_a_face_wound_the_wrong_way_is_open():
    whole = block((0, 0, 0), (1, 1, 1))
    face = whole.face.copy()
    face[0] = face[0][::-1]
    assert len(open_edges(dataclasses.replace(whole, face=face))) > 0


def test_rims_that_meet_in_a_point_are_refused():
    two = joined([panel((0, 0, 0), (1, 0, 0), (0, 1, 0)), panel((1, 1, 0), (1, 0, 0), (0, 1, 0))])
    with pytest.raises(PrtError, match="wings: its 8 open edges form no simple loops"):
        capped(two, "wings")


def test_mesh_data_reads_back_what_was_written():
    data = sphere_mesh(0.5)
    read = mesh_data(to_mesh("ball", data, diffuse((0.5, 0.5, 0.5))))
    for field in ("position", "normal", "uv"):
        assert np.allclose(getattr(read, field), getattr(data, field), atol=1e-6)
    assert np.array_equal(read.face, data.face)

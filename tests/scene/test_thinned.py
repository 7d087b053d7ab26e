"""Kept vertices are apart, cover the rest, and carry smooth functions to it."""

import numpy as np
import torch

from prt.scene.lightmap_points import TriangleMesh
from prt.scene.shapes import sphere_mesh
from prt.scene.thinned import thinned


def ball(centre=(0.0, 0.0, 0.0), shape: int = 0, first: int = 0) -> TriangleMesh:
    data = sphere_mesh(1.0, 64, 32)
    position = torch.tensor(data.position + np.asarray(centre)).float()
    face = torch.from_numpy(data.face.astype(np.int64)) + first
    return TriangleMesh(position, torch.tensor(data.normal).float(), face, torch.full((len(face),), shape))


def test_kept_vertices_are_apart_and_stand_for_all():
    mesh = ball()
    some = thinned(mesh, 0.2)
    assert 50 < len(some.kept) < len(mesh.position) / 4
    place = torch.cat([mesh.position / 0.2, mesh.normal], 1)
    seen = torch.unique(mesh.face)  # poles leave vertices that no triangle uses
    kept = some.kept[torch.isin(some.kept, seen)]
    apart = torch.cdist(place[kept], place[kept]).fill_diagonal_(9)
    assert apart.min() > 1
    assert torch.cdist(place[seen], place[kept]).min(1).values.max() <= 1
    torch.testing.assert_close(some.weights.sum(1), torch.ones(len(place)))
    assert some.weights.min() >= 0


def test_smooth_functions_are_carried_over_and_exact_at_kept_vertices():
    mesh = ball()
    some = thinned(mesh, 0.2)
    values = mesh.position @ torch.tensor([1.0, -2.0, 0.5])
    found = (values[some.kept][some.rows] * some.weights).sum(1)
    torch.testing.assert_close(found[some.kept], values[some.kept], rtol=1e-4, atol=1e-4)
    assert (found - values).square().mean().sqrt() < 0.06 * values.std()


def test_shapes_and_sides_do_not_stand_for_each_other():
    one, other = ball(), ball(shape=1, first=len(ball().position))
    inside = TriangleMesh(other.position, -other.normal, other.face, other.shape)
    both = TriangleMesh(
        torch.cat([one.position, inside.position]), torch.cat([one.normal, inside.normal]),
        torch.cat([one.face, inside.face]), torch.cat([one.shape, inside.shape]),
    )  # fmt: skip
    some = thinned(both, 1.0)
    first = torch.arange(len(both.position)) < len(one.position)
    seen = torch.unique(both.face)
    used = some.weights[seen] > 0
    assert (first[some.kept][some.rows[seen]] == first[seen, None])[used].all()
    # the same place, and the same normal but for its sign, in one shape
    turned = TriangleMesh(both.position, both.normal, both.face, 0 * both.shape)
    some = thinned(turned, 1.0)
    facing = turned.normal[some.kept][some.rows] @ turned.normal[:, :, None]
    assert facing[..., 0][some.weights > 1e-3].min() > -0.99


def test_no_spacing_keeps_all():
    mesh = ball()
    some = thinned(mesh, 0.0)
    assert torch.equal(some.kept, torch.arange(len(mesh.position)))
    assert torch.equal(some.rows[:, 0], some.kept) and (some.weights == 1).all()

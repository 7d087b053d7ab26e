"""The scenes that transfer of direct light is learnt on: closed solids that stand where they should."""

import dataclasses

import numpy as np
import pytest
from data_scenes import check_missing_data_is_named, need_data, scene

from prt.errors import PrtError
from prt.scene import foliage, tableware, teaset
from prt.scene.capture import camera_rays
from prt.scene.closing import mesh_data, open_edges
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.rounded import rounded
from prt.scene.shapes import sphere_mesh
from prt.scene.swept import spline, swept_mesh

WITH_DATA = ("teaset", "head", "dining_table")
ALL = ("plants", *WITH_DATA)


@pytest.fixture(scope="module")
def data():
    need_data()


def volume(mesh) -> float:
    """Enclosed volume by the divergence theorem: negative if the faces are wound inwards."""
    a, b, c = (mesh.position[mesh.face[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0


def assert_solid(mesh, what: str = "") -> None:
    """Closed, with unit normals on the outside."""
    assert len(open_edges(mesh)) == 0, what
    assert volume(mesh) > 0.0, what
    a, b, c = (mesh.position[mesh.face[:, k]] for k in range(3))
    agree = np.einsum("ij,ij->i", np.cross(b - a, c - a), mesh.normal[mesh.face].mean(axis=1))
    assert (agree > 0).mean() > 0.999, what
    assert np.allclose(np.linalg.norm(mesh.normal, axis=1), 1.0), what


# ---- swept solids and rounded meshes


def test_a_straight_sweep_is_a_rod():
    rod = swept_mesh([(0, 0, 0), (1, 0, 0), (2, 0, 0)], 0.1, 0.1, 48, 60, cap=0.01, across=(0, 0, -1))
    assert_solid(rod)
    assert volume(rod) == pytest.approx(np.pi * 0.01 * 2, rel=0.02)
    assert rod.position[:, 0].min() == 0.0 and rod.position[:, 0].max() == 2.0
    assert np.hypot(rod.position[:, 1], rod.position[:, 2]).max() == pytest.approx(0.1)


def test_splines_meet_their_ends_and_know_their_slope():
    control = np.array([(0, 0, 0), (1, 2, 0), (2, 1, 1), (4, 0, 0.5)], dtype=float)
    place = np.array([0.0, 0.3, 0.7, 1.0])
    point, slope = spline(control, place)
    assert np.array_equal(point[[0, -1]], control[[0, -1]])
    ahead, behind = spline(control, place[1:3] + 1e-5)[0], spline(control, place[1:3] - 1e-5)[0]
    assert np.allclose((ahead - behind) / 2e-5, slope[1:3], atol=1e-6)


def test_rounding_stays_closed_and_nears_the_smooth_shape():
    coarse = sphere_mesh(1.0, 10, 6)
    _, first, weld = np.unique(coarse.position.round(9), axis=0, return_index=True, return_inverse=True)
    coarse = dataclasses.replace(
        coarse, position=coarse.position[first], normal=coarse.position[first], uv=coarse.uv[first],
        face=weld.reshape(-1)[coarse.face],
    )  # fmt: skip
    fine = rounded(coarse, levels=2)
    assert len(fine.face) == 16 * len(coarse.face)
    assert np.array_equal(fine.position[: len(coarse.position)], coarse.position)
    assert_solid(fine)
    whole = 4 / 3 * np.pi
    assert whole - volume(fine) < 0.3 * (whole - volume(coarse))


# ---- plants


@pytest.mark.parametrize("kind", [foliage.BROAD_LEAF, foliage.BLADE, foliage.LEAFLET])
@pytest.mark.parametrize("thickness", [0.001, 0.007, 0.03])
def test_a_leaf_is_a_thin_solid_with_two_sides(kind, thickness):
    at, forward = np.array([0.1, 0.2, 0.3]), foliage.direction(0.7, 0.5)
    leaf = foliage.leaf(kind, at, forward, 0.4, 0.8, thickness, roll=0.2)
    assert_solid(leaf)
    grid = leaf.position.reshape(kind.rows + 1, kind.columns + 1, 3)
    normal = leaf.normal.reshape(grid.shape)
    assert np.allclose(grid[0], at)
    middle = kind.rows // 2 + 1
    quarter = kind.columns // 4
    opposite = (kind.columns - quarter) % kind.columns
    over, under = grid[middle, quarter], grid[middle, opposite]
    if kind.columns % 4 == 0:
        assert np.linalg.norm(over - under) == pytest.approx(thickness, rel=0.01)
    assert (normal[middle, quarter] * normal[middle, opposite]).sum() < -0.5
    assert normal[middle, quarter, 1] > 0, "the upper side faces up"


@pytest.fixture(scope="module")
def plants():
    found = scene("plants")
    return found, found.meshes()


def test_plants_are_solids_on_a_base(plants):
    _, meshes = plants
    for name, (mesh, _) in meshes.items():
        assert_solid(mesh, name)
    assert 30_000 < sum(len(mesh.face) for mesh, _ in meshes.values()) < 120_000
    pots = {name.removesuffix("_pot"): mesh for name, (mesh, _) in meshes.items() if name.endswith("_pot")}
    assert len(pots) == 3
    base = meshes["base"][0].position
    assert base[:, 1].max() == pytest.approx(0.0, abs=1e-9)
    for name, pot in pots.items():
        low, high = pot.position.min(0), pot.position.max(0)
        assert low[1] == pytest.approx(0.0, abs=1e-9)
        middle, radius = (low + high) / 2, (high[0] - low[0]) / 2
        assert np.hypot(pot.position[:, 0], pot.position[:, 2]).max() < base[:, 0].max() - 0.1
        for other in pots:
            leaf = meshes[f"{other}_leaves"][0].position - middle
            away = np.hypot(leaf[:, 0], leaf[:, 2])
            outside = (away > radius) | (leaf[:, 1] + middle[1] > 0.8 * high[1])
            assert outside.all(), f"leaves of {other} pass through the pot of {name}"
    for leaf in (mesh for name, (mesh, _) in meshes.items() if name.endswith("leaves")):
        assert leaf.position[:, 1].min() > 0.2


def test_there_are_as_many_leaves_as_asked_for(plants):
    kinds = {"broad": foliage.BROAD_LEAF, "tuft": foliage.BLADE, "feathered": foliage.LEAFLET}
    counts = {
        name: len(plants[1][f"{name}_leaves"][0].position) / ((kind.rows + 1) * (kind.columns + 1))
        for name, kind in kinds.items()
    }
    assert sum(counts.values()) == plants[0].leaves == 300
    assert all(count > 30 and count.is_integer() for count in counts.values())


def test_thickness_changes_nothing_but_the_thickness(plants):
    thick = scene("plants", "scene.leaf_thickness=0.02").meshes()
    for name, (mesh, _) in plants[1].items():
        other = thick[name][0]
        assert np.array_equal(mesh.face, other.face)
        if name.endswith("leaves"):
            assert 0.001 < np.abs(mesh.position - other.position).max() < 0.01
        else:
            assert np.array_equal(mesh.position, other.position)


def test_plants_are_the_same_every_time(plants):
    found, meshes = plants
    again = scene("plants")
    assert again.fingerprint() == found.fingerprint()
    for name, (mesh, _) in again.meshes().items():
        assert np.array_equal(mesh.position, meshes[name][0].position)
    for other in ("scene.leaves=299", "scene.leaf_thickness=0.008"):
        assert scene("plants", other).fingerprint() != found.fingerprint()


def test_few_and_many_leaves():
    for count in (12, 61):
        meshes = scene("plants", f"scene.leaves={count}").meshes()
        for name, (mesh, _) in meshes.items():
            assert_solid(mesh, name)


@pytest.mark.parametrize(
    "name, override, message",
    [
        ("plants", "scene.leaves=3", "scene.leaves=3 must be an integer between 12 and 2000"),
        ("plants", "scene.leaves=40.5", r"scene\.leaves=40\.5"),
        ("plants", "scene.leaves=true", r"scene\.leaves=True"),
        ("plants", "scene.leaf_thickness=0", r"scene\.leaf_thickness=0"),
        ("plants", "scene.leaf_thickness=thin", r"scene\.leaf_thickness='thin'"),
        ("plants", "scene.leafs=40", "leafs.*leaves"),
        ("plants", "scene.max_depth=1", r"scene\.max_depth=1"),
        ("head", "scene.albedo=1.0", r"scene\.albedo=1\.0"),
        ("teaset", "scene.cups=3", "cups"),
        ("dining_table", "scene.chairs=4", "chairs"),
    ],
)
def test_wrong_settings_are_refused(name, override, message):
    with pytest.raises(PrtError, match=message) as caught:
        scene(name, override)
    assert "\n" not in str(caught.value)


def test_an_asset_of_plants_shows_both_sides_of_leaves(monkeypatch, tmp_path):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path))
    found = scene("plants", "scene.leaves=12")
    asset = found.asset(256)
    mesh = asset.mesh(0)
    assert not asset._turned.any(), "closed solids have their outside outside"
    assert asset.atlas.corner.shape == (len(mesh.face), 3, 2)
    for view in found.views("far", 2, 24):
        g = asset.capture(asset.load({}), view)
        assert g.uv.min() >= 0 and g.uv.max() <= 1 and g.specular.max() == 0
        assert (g.normal * asset.face_normal(0)[g.triangle]).sum(1).min() > -0.2


# ---- tableware


@pytest.mark.parametrize("make", ["cup", "tea", "saucer", "spoon"])
def test_tableware_is_solid(make):
    mesh = getattr(tableware, make)()
    assert_solid(mesh, make)
    if make != "tea":
        assert mesh.position[:, 1].min() == pytest.approx(0.0, abs=1e-9)


def test_vessels_and_their_contents_are_solid():
    for part in (*tableware.sugar_bowl(), *tableware.biscuit_plate(), tableware.tray(1.7)):
        assert_solid(part)
    assert tableware.tray(1.7).position[:, 1].min() == pytest.approx(-0.022)
    flat, biscuits = tableware.biscuit_plate()
    assert biscuits.position[:, 1].min() == pytest.approx(tableware.top_at_axis(flat))


def test_cups_are_thin_and_their_handles_end_in_the_wall():
    cup, tea = tableware.cup(), tableware.tea()
    body = 49 * 65  # vertices of the turned part
    turned = dataclasses.replace(
        cup, position=cup.position[:body], normal=cup.normal[:body], uv=cup.uv[:body],
        face=cup.face[(cup.face < body).all(axis=1)],
    )  # fmt: skip
    assert_solid(turned)
    for height in (0.08, 0.12, 0.2):
        inner, outer = tableware.wall(turned, height)
        assert 0.008 < outer - inner < 0.03
        edge = tea.position[np.abs(tea.position[:, 1] - height) < 0.01]
        if len(edge):
            assert np.hypot(edge[:, 0], edge[:, 2]).max() < outer - 0.002, "tea seeps through the wall"
    level = tea.position[:, 1].max()
    assert np.hypot(tea.position[:, 0], tea.position[:, 2]).max() > tableware.wall(turned, level)[0]
    handle = cup.position[body:]
    inner = np.array([tableware.wall(turned, y)[0] for y in handle[:, 1]])
    assert (np.hypot(handle[:, 0], handle[:, 2]) > inner).all(), "the handle comes out inside"
    assert handle[:, 0].max() > 0.33


def test_nothing_on_the_tray_runs_into_anything():
    parts = {name: mesh for name, (mesh, _) in teaset.tableware().items()}
    flat = 0.9 * parts.pop("tray").position[:, 0].max()
    alone = [name for name in parts if name.split("_")[0] in ("saucer", "sugar", "plate", "spoon")]
    for name in alone:
        p = parts[name].position
        assert np.hypot(p[:, 0], p[:, 2]).max() < flat + 0.05, name
        if name != "sugar":
            assert p[:, 1].min() == pytest.approx(0.0, abs=1e-9)
    grid = {
        name: {tuple(cell) for cell in np.floor(parts[name].position[:, [0, 2]] / 0.02).astype(int)}
        for name in alone
        if name != "sugar"
    }
    names = list(grid)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            assert not grid[first] & grid[second], f"{first} meets {second}"


# ---- scenes with data


@pytest.fixture(scope="module")
def loaded(data, plants):
    return {"plants": plants[0], **{name: scene(name) for name in WITH_DATA}}


@pytest.mark.parametrize("name", ALL)
def test_cameras_see_the_object_from_a_clear_place(request, name):
    found = scene(name) if name == "plants" else request.getfixturevalue("loaded")[name]
    mi_scene, mi = found.load(), mitsuba()
    for view in found.views("train", 5, 32) + found.views("far", 6, 32):
        ray = camera_rays(view)
        si = mi_scene.ray_intersect(ray)
        hit = np.array(si.is_valid())
        assert 0.18 < hit.mean() < 0.75
        assert np.array(si.t)[hit].min() > 1.5
        behind = (np.array(mi.Vector3f(si.n)) * np.array(ray.d)).sum(0)[hit] > 1e-3
        assert behind.mean() < 0.02, "what is looked at has its outside outside"
    assert len({view.origin for view in found.views("far", 30, 8)}) == 30


def test_teapot_stands_closed_on_the_tray(loaded):
    content = loaded["teaset"].description()
    pot = mesh_data(content["teapot"])
    assert len(open_edges(pot)) == 0 and volume(pot) > 0.1
    assert pot.position[:, 1].min() == pytest.approx(0.0, abs=1e-3)
    assert pot.position[:, 1].max() == pytest.approx(teaset.Teaset.TALL, rel=0.01)
    others = [mesh_data(shape) for name, shape in content.items() if name not in ("tray", "teapot")]
    near = {tuple(cell) for cell in np.floor(pot.position / 0.03).astype(int)}
    for other in others:
        assert not near & {tuple(cell) for cell in np.floor(other.position / 0.03).astype(int)}


def test_bust_stands_in_its_plinth(loaded):
    shapes = {shape.id(): shape for shape in loaded["head"].load().shapes()}
    bust, plinth = mesh_data(shapes["bust"]), mesh_data(shapes["plinth"])
    assert len(open_edges(bust)) == 0 == len(open_edges(plinth))
    assert -0.05 < bust.position[:, 1].min() < 0.0 and bust.position[:, 1].max() == pytest.approx(1.47)
    foot = bust.position[bust.position[:, 1] < 0.05]
    low, high = plinth.position.min(0), plinth.position.max(0)
    assert (foot[:, [0, 2]] > low[[0, 2]] + 0.05).all() and (foot[:, [0, 2]] < high[[0, 2]] - 0.05).all()


def test_dining_table_is_cut_out_of_its_room(loaded):
    found = loaded["dining_table"]
    content = found.description()
    assert list(content) == ["floor", *sorted(name for name in content if name != "floor")]
    assert len(content) == 1 + 6 * 3 + 20 + 2
    assert sum(name.startswith("WhitePlastic") for name in content) == 6
    low, high = found.bounds
    assert low[1] == pytest.approx(-0.06, abs=1e-3) and 1.2 < high[1] < 1.5
    assert -2.0 < low[0] and high[0] < 2.0
    feet = [mitsuba().load_dict(content[f"BlackRubber_000{i}"]).bbox() for i in range(1, 7)]
    assert all(abs(box.min.y) < 1e-3 for box in feet), "chairs stand on the floor"
    assert found.fingerprint() == scene("dining_table").fingerprint()


@pytest.mark.parametrize("name", WITH_DATA)
def test_missing_data_is_named(name, tmp_path, monkeypatch):
    check_missing_data_is_named(name, tmp_path, monkeypatch)


def test_dining_table_takes_no_other_scene(tmp_path):
    other = tmp_path / "scene.yaml"
    other.write_text("ball:\n  type: sphere\n")
    with pytest.raises(PrtError, match=r"no shape of .* is called 'Walls_\*'"):
        scene("dining_table", f"scene.path={other}").load()

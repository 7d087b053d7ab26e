"""Animation as data: exact ends, linear between and beyond, order, both formats, one-line errors."""

import json

import numpy as np
import pytest
from data_scenes import need_data
from scipy.spatial.transform import Rotation

from prt.errors import PrtError
from prt.paths import data_file
from prt.scene.animation import Animation, rotation
from prt.scene.animation_file import read_animation

MOVE = {
    "name": "move",
    "translate": {"shapes": ["a", "b"], "start": [0.1, -0.7, 1 / 3], "end": [0.3, 0.2, 1e-3]},
}
TURN = {
    "name": "turn",
    "rotate": {"shapes": ["a"], "axis": [0, 2, 0], "centre": [1, 0, 0], "start": 0, "end": 90},
}
GROW = {"name": "grow", "scale": {"shapes": ["b"], "centre": [1, 2, 3], "start": 0.5, "end": 1.7}}
PAINT = {
    "name": "paint",
    "value": {"parameter": "W.reflectance.value", "start": [0.2, 0.2, 0.2], "end": [0.5, 0.05, 0.3]},
}
SKY = {"name": "sky", "rotate_environment": {"start": 90, "end": 120}}


def of(*variables) -> Animation:
    return read_animation({"variables": list(variables)})


def moved(matrix, point):
    return (matrix @ [*point, 1.0])[:3]


def test_both_ends_are_exact():
    for end, v in (("start", 0.0), ("end", 1.0)):
        assert of(MOVE).transforms([v])["a"][:3, 3].tolist() == MOVE["translate"][end]
        assert of(PAINT).values([v])["W.reflectance.value"] == tuple(PAINT["value"][end])
        assert np.diag(of(GROW).transforms([v])["b"]).tolist()[:3] == [GROW["scale"][end]] * 3
    still, quarter = (of(TURN).transforms([v])["a"] for v in (0, 1))
    assert (still == np.eye(4)).all()
    assert quarter[:3, :3].tolist() == [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    half_turn = {"name": "t", "rotate": {"shapes": ["a"], "axis": [0, 1, 0], "start": -90, "end": 180}}
    assert (of(half_turn).transforms([1])["a"] == np.diag([-1, 1, -1, 1])).all()


def test_linear_between_and_beyond():
    start, end = (np.array(MOVE["translate"][key]) for key in ("start", "end"))
    for v in (-0.25, 0.3, 0.5, 1.25):
        np.testing.assert_allclose(
            of(MOVE).transforms([v])["b"][:3, 3], start + v * (end - start), atol=1e-15
        )
    np.testing.assert_allclose(of(PAINT).values([2.0])["W.reflectance.value"], [0.8, -0.1, 0.4], atol=1e-15)
    np.testing.assert_allclose(of(TURN).transforms([1.5])["a"][:3, :3], rotation([0, 1, 0], 135), atol=1e-15)


def test_turning_keeps_the_centre_and_follows_the_right_hand():
    turn = of(TURN).transforms([0.5])["a"]
    np.testing.assert_allclose(moved(turn, (1, 5, 0)), (1, 5, 0), atol=1e-15)
    # about +y, +z goes towards +x
    np.testing.assert_allclose(moved(turn, (1, 0, 2)), (1 + 2**0.5, 0, 2**0.5), atol=1e-14)
    r = rotation([1, -2, 0.5], 77.0)
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(r) == pytest.approx(1.0) and np.trace(r) == pytest.approx(
        1 + 2 * np.cos(np.radians(77))
    )
    np.testing.assert_allclose(r @ [1, -2, 0.5], [1, -2, 0.5], atol=1e-14)


def test_rotation_is_that_of_scipy():
    rng = np.random.default_rng(0)
    for axis, degrees in [*zip(rng.normal(size=(20, 3)), rng.uniform(-720, 720, 20), strict=True)]:
        unit = axis / np.linalg.norm(axis)
        expected = Rotation.from_rotvec(np.radians(degrees) * unit).as_matrix()
        np.testing.assert_allclose(rotation(axis.tolist(), degrees), expected, atol=1e-13)
    for quarter in range(-8, 9):  # exact, not nearly
        turn = rotation([0, 0, 3], 90.0 * quarter)
        assert (turn == np.round(turn)).all()
        expected = Rotation.from_euler("z", 90 * quarter, degrees=True).as_matrix()
        np.testing.assert_allclose(turn, expected, atol=1e-13)


def test_order_of_motions_against_matrices_by_hand():
    """Scaled about (1, 0, 0), then turned by 90 degrees about z, then moved: one variable, three motions."""
    steps = [
        {"scale": {"shapes": ["a"], "centre": [1, 0, 0], "start": 1, "end": 2}},
        {"rotate": {"shapes": ["a"], "axis": [0, 0, 1], "start": 0, "end": 90}},
        {"translate": {"shapes": ["a"], "start": [0, 0, 0], "end": [0, 0, 5]}},
    ]
    scale = np.array([[2, 0, 0, -1], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1.0]])
    turn = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    move = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1.0]])
    one = of({"name": "all", **{key: value for step in steps for key, value in step.items()}})
    three = of(*({"name": str(i), **step} for i, step in enumerate(steps)))
    for found in (one.transforms([1.0]), three.transforms([1.0, 1.0, 1.0])):
        assert (found["a"] == move @ turn @ scale).all()
    assert moved(one.transforms([1.0])["a"], (2, 0, 0)).tolist() == [0, 3, 5]
    backwards = of(*({"name": str(i), **step} for i, step in enumerate(steps[::-1])))
    assert (backwards.transforms([1.0, 1.0, 1.0])["a"] == scale @ turn @ move).all()


def test_scale_is_even_or_by_axis_about_its_centre():
    np.testing.assert_allclose(moved(of(GROW).transforms([0])["b"], (3, 2, 3)), (2, 2, 3))
    by_axis = {"name": "s", "scale": {"shapes": ["b"], "start": [1, 1, 1], "end": [2, 1, 0.5]}}
    np.testing.assert_allclose(moved(of(by_axis).transforms([1])["b"], (1, 1, 1)), (2, 1, 0.5))


def test_motions_of_one_shape_follow_each_other_in_order():
    first, second = {**MOVE}, {**TURN}
    one, two = of(first).transforms([0.4])["a"], of(second).transforms([0.7])["a"]
    np.testing.assert_allclose(of(first, second).transforms([0.4, 0.7])["a"], two @ one, atol=1e-15)
    np.testing.assert_allclose(of(second, first).transforms([0.7, 0.4])["a"], one @ two, atol=1e-15)
    assert not np.allclose(one @ two, two @ one)
    # what only one of them moves
    assert (of(first, second).transforms([0.4, 0.7])["b"] == one).all()


def test_a_variable_may_do_several_things():
    both = {**MOVE, "value": PAINT["value"], "rotate_environment": SKY["rotate_environment"]}
    a = of(both)
    assert a.dimension == 1 and a.names == ["move"]
    assert a.values([1])["W.reflectance.value"] == (0.5, 0.05, 0.3)
    np.testing.assert_allclose(a.environment([0])[:3, :3], rotation([0, 1, 0], 90), atol=0)


def test_environment_turns_or_is_none():
    assert of(MOVE).environment([0.5]) is None
    twice = of(SKY, {"name": "more", "rotate_environment": {"start": 0, "end": 45, "axis": [1, 0, 0]}})
    expected = rotation([1, 0, 0], 45) @ rotation([0, 1, 0], 120)
    np.testing.assert_allclose(twice.environment([1, 1])[:3, :3], expected, atol=1e-15)


@pytest.mark.parametrize("v", [[], [0.1], [0.1, 0.2, 0.3], [0.1, float("nan")], [float("inf"), 0.0]])
def test_states_are_checked(v):
    with pytest.raises(PrtError) as caught:
        of(MOVE, TURN).check(v)
    assert "\n" not in str(caught.value)
    assert of(MOVE, TURN).check(np.array([1.25, -0.25], dtype=np.float32)) == [1.25, -0.25]


def test_subset_leaves_the_rest_standing():
    a = of(MOVE, TURN, PAINT)
    for rest in (0.0, 0.5):
        one = a.subset(1, rest)
        assert one.dimension == 1 and one.names == ["move"]
        full = [0.3, rest, rest]
        for name, matrix in a.transforms(full).items():
            assert (one.transforms([0.3])[name] == matrix).all()
        assert one.values([0.3]) == a.values(full)
    assert a.subset(None) is a and a.subset(3).transforms([0, 0, 0]).keys() == {"a", "b"}
    # in two steps as in one: what stands still keeps its place in the order
    twice, once = a.subset(1, 0.5).subset(0, 0.5).transforms([]), a.subset(0, 0.5).transforms([])
    assert all((twice[name] == once[name]).all() for name in once)
    for wrong in (-1, 4, 1.5, True, "two"):
        with pytest.raises(PrtError, match=r"scene\.variables=.*from 0 to 3"):
            a.subset(wrong)


def test_fingerprint_is_json_and_follows_the_content():
    a = of(MOVE, TURN, PAINT)
    found = a.fingerprint()
    assert json.loads(json.dumps(found)) == found == of(MOVE, TURN, PAINT).fingerprint()
    assert found != of(TURN, MOVE, PAINT).fingerprint()
    assert found != a.subset(2).fingerprint() != a.subset(2, 0.5).fingerprint()
    other = json.loads(json.dumps(PAINT))
    other["value"]["end"][0] = 0.6
    assert found != of(MOVE, TURN, other).fingerprint()


def test_nothing_moves_in_none():
    none = read_animation(None)
    assert none.dimension == 0 and none.transforms([]) == {} and none.values([]) == {}
    assert none.environment([]) is None and none.shapes() == [] and read_animation(none) is none


def test_yaml_and_json_files(tmp_path):
    content = {"variables": [MOVE, TURN, PAINT, SKY]}
    for name in ("a.yaml", "a.json"):
        (tmp_path / name).write_text(json.dumps(content))
        assert read_animation(tmp_path / name) == of(MOVE, TURN, PAINT, SKY)
        assert read_animation(str(tmp_path / name)) == of(MOVE, TURN, PAINT, SKY)


PAPER = {
    "common": [{"param_name": "W.reflectance.value", "start": [0.2, 0.2, 0.2], "end": [0.5, 0.05, 0.3]}],
    "translate": [
        {"shape_names": ["A", "B"], "start": [0, 0, -0.4], "end": [0, 0, 0.2]},
        {"shape_names": ["A", "B"], "start": [-0.6, 0, 0], "end": [0.6, 0, 0]},
    ],
    "scale": [{"shape_names": ["C"], "start": 1, "end": 2}],
    "rotate": [
        {"shape_names": ["C"], "axis": [0, 1, 0], "translation": [1, 0, 0], "start": 0, "end": 90},
        {"shape_names": ["EnvironmentMapEmitter"], "axis": [0, 1, 0], "start": 90, "end": 120},
    ],
    "camera": {"active": False, "pos_start": [0, 0, 0]},
}  # fmt: skip


def test_the_papers_format(tmp_path):
    (tmp_path / "animation.json").write_text(json.dumps(PAPER))
    a = read_animation(tmp_path / "animation.json")
    assert a.dimension == 6 and len(set(a.names)) == 6
    v = [1.0, 0.0, 1.0, 1.0, 0.5, 0.0]  # common, translate, rotate, scale, as the authors number them
    assert a.values(v) == {"W.reflectance.value": (0.5, 0.05, 0.3)}
    assert a.transforms(v)["B"][:3, 3].tolist() == [0.6, 0.0, -0.4]
    np.testing.assert_allclose(moved(a.transforms(v)["C"], (1, 0, 1)), (2, 0, 0), atol=1e-15)
    np.testing.assert_allclose(a.environment(v)[:3, :3], rotation([0, 1, 0], 105))
    with pytest.raises(PrtError, match=r"camera\.active"):
        read_animation({**PAPER, "camera": {"active": True}})
    with pytest.raises(PrtError, match="unknown key 'translat'"):
        read_animation({"translat": []})


def test_the_papers_own_dining_room():
    need_data()
    a = read_animation(data_file("scenes/dining-room/animation.json"))
    assert a.dimension == 7 and len(set(a.names)) == 7
    start, end = np.zeros(7), np.ones(7)
    assert a.values(start) == {"WallsBSDF.reflectance.value": (0.2, 0.2, 0.2)}
    assert a.values(end) == {"WallsBSDF.reflectance.value": (0.5, 0.05, 0.3)}
    assert a.transforms(end)["Ceramic_0005"][:3, 3].tolist() == [0.6, 0.0, 0.2]
    assert a.transforms(start)["Artwork"][:3, 3].tolist() == [0.0, -0.4, 0.0]
    assert (a.environment(start)[:3, :3] == rotation([0, 1, 0], 90)).all()


def changed(entry: dict, kind: str, **keys) -> dict:
    out = json.loads(json.dumps(entry))
    out[kind].update(keys)
    for key in [key for key, value in keys.items() if value is None]:
        del out[kind][key]
    return out


@pytest.mark.parametrize(
    ("entry", "named"),
    [
        ({"name": "x"}, "moves nothing"),
        ({"name": "x", "trnslate": {}}, "trnslate"),
        ("not a mapping", "mapping"),
        ({"name": "x", "translate": 3}, "mapping"),
        (changed(MOVE, "translate", start=[0, 0]), "start has 2"),
        (changed(MOVE, "translate", end="far"), "number"),
        (changed(MOVE, "translate", end=[0, 0, float("inf")]), "finite"),
        (changed(MOVE, "translate", centre=[0, 0, 0]), "centre"),
        (changed(MOVE, "translate", shapes=None), "missing key 'shapes'"),
        (changed(MOVE, "translate", shapes=[]), "empty"),
        (changed(MOVE, "translate", shapes="a"), "list of shape ids"),
        (changed(MOVE, "translate", shapes=5), "list of shape ids"),
        (changed(MOVE, "translate", shapes=["a", 5]), "list of shape ids"),
        (changed(MOVE, "translate", end=[0, 0, float("nan")]), "finite"),
        (changed(MOVE, "translate", end=None), "missing key 'end'"),
        (changed(MOVE, "translate", end=True), "number"),
        (changed(TURN, "rotate", axis=None), "missing key 'axis'"),
        (changed(TURN, "rotate", centre=[0, 0]), "centre must have 3"),
        (changed(GROW, "scale", start=0), "above 0"),
        (changed(GROW, "scale", start=[1, 1, 1], end=[1, -1, 1]), "above 0"),
        (changed(PAINT, "value", parameter=None), "missing key 'parameter'"),
        (changed(PAINT, "value", start="123", end="456"), "number"),
        (changed(SKY, "rotate_environment", shapes=["a"]), "unknown key 'shapes'"),
        (changed(TURN, "rotate", axis=[0, 0, 0]), "axis"),
        (changed(TURN, "rotate", axis=[0, 1]), "axis"),
        (changed(TURN, "rotate", start=[0, 0, 0], end=[0, 0, 0]), "rotate"),
        (changed(GROW, "scale", start=[1, 1], end=[2, 2]), "1 or 3"),
        (changed(PAINT, "value", end=[0.5]), "paint"),
        (changed(PAINT, "value", parameter=""), "parameter"),
        (changed(PAINT, "value", start=[], end=[]), "paint"),
    ],
)
def test_mistakes_are_named_in_one_line(entry, named):
    with pytest.raises(PrtError, match="scene.animation") as caught:
        of(entry)
    assert named in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("entry", "named"),
    [
        ({"translate": [{"shape_names": "Door", "start": [0, 0, 0], "end": [1, 0, 0]}]}, "list of shape ids"),
        ({"translate": [{"start": [0, 0, 0], "end": [1, 0, 0]}]}, "empty"),
        ({"common": [{"start": 0, "end": 1}]}, "parameter is empty"),
        ({"rotate": [{"shape_names": ["A"], "start": 0, "end": 1}]}, "missing key 'axis'"),
        ({"rotate": {"shape_names": ["A"]}}, "list of mappings"),
        ({"translate": ["A"]}, "list of mappings"),
        ({"camera": {"active": 1}}, "views are free"),
        ({"variables": [], "camera": {}}, "unknown key 'camera'"),
    ],
)
def test_mistakes_in_the_papers_format(entry, named):
    with pytest.raises(PrtError, match=r"scene\.animation") as caught:
        read_animation(entry)
    assert named in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "source", [3, [MOVE], {"variables": MOVE}, {"variables": 5}, {"variables": [MOVE, MOVE]}]
)
def test_wrong_sources(source):
    with pytest.raises(PrtError, match=r"scene\.animation"):
        read_animation(source)


def test_wrong_files(tmp_path):
    with pytest.raises(PrtError, match="does not exist"):
        read_animation(tmp_path / "nowhere.yaml")
    for name, text in (("a.json", "{"), ("a.yaml", "variables: [")):
        (tmp_path / name).write_text(text)
        with pytest.raises(PrtError, match=r"cannot read scene\.animation") as caught:
            read_animation(tmp_path / name)
        assert "\n" not in str(caught.value)

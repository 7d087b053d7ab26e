"""``prt needs``: what is measured of scenes whose answer is known, and what is recommended."""

import pytest
import torch

from prt.bench import needs as command
from prt.bench.compose import compose
from prt.bench.run import build_task, fitted
from prt.cli import main
from prt.errors import PrtError
from prt.methods.advice import NOTHING, advise
from prt.tasks import needs
from prt.tasks.needs import Need, measure
from prt.tasks.variable_effects import effects

#: a lamp that grows dim, and a ball that moves inside of a closed box
SCENE = """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective" id="camera"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0, 2, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/></film></sensor>
  <shape type="rectangle" id="Floor"><transform name="to_world"><scale value="4"/>
    <rotate x="1" angle="-90"/><translate y="-1"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>
  <shape type="cube" id="Box"><transform name="to_world"><scale value="0.6"/><translate y="-0.4"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.4, 0.2, 0.2"/></bsdf></shape>
  <shape type="sphere" id="Hidden"><float name="radius" value="0.1"/><transform name="to_world">
    <translate y="-0.4"/></transform><bsdf type="diffuse"/></shape>
  <shape type="rectangle" id="Lamp"><transform name="to_world"><rotate x="1" angle="90"/>
    <translate y="3"/></transform><emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>
</scene>"""
ANIMATION = """
variables:
  - {name: lamp, value: {parameter: Lamp.emitter.radiance.value, start: [8, 8, 8], end: [2, 2, 2]}}
  - {name: hidden, translate: {shapes: [Hidden], start: [-0.2, 0, 0], end: [0.2, 0, 0]}}
"""


@pytest.fixture
def moving(tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path / "cache"))
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "moves.yaml").write_text(ANIMATION)
    return [
        "task=animate", "scene=mitsuba", f"scene.path={tmp_path / 'scene.xml'}",
        f"scene.animation={tmp_path / 'moves.yaml'}", "budget=smoke", "device=cpu", "task.size=16",
        "task.states=1", "task.spp=16", f"run.folder={tmp_path / 'runs'}",
    ]  # fmt: skip


def test_a_variable_with_no_effect_needs_no_plane(moving):
    found = effects(build_task(compose(moving)), states=1, spp=32, size=16)
    assert found["lamp"] > 0.3 and found["hidden"] < NOTHING
    words = [a.override for a in advise("animate", [Need(f"variable/{k}", v, "") for k, v in found.items()])]
    assert "method.ignored=[hidden]" in words

    cfg = compose([*moving, "method.ignored=[hidden]", "method.training.steps=4"])
    model = fitted(cfg, build_task(cfg))
    whole = compose([*moving, "method.training.steps=1"])
    both = fitted(whole, build_task(whole))
    assert model.net.encodings[1].variables == 1 and both.net.encodings[1].variables == 2
    assert model.nbytes() < both.nbytes()
    states = [torch.tensor([0.3, hidden]) for hidden in (0.0, 1.0)]
    assert torch.equal(*(model.net.at(v).bias for v in states))
    assert not torch.equal(model.net.at(states[0]).bias, model.net.at(torch.tensor([0.9, 0.0])).bias)


def test_figures_are_kept_until_a_file_of_the_scene_changes(moving, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(
        needs, "measure", lambda task: calls.append(task) or [Need("variable/lamp", 0.5, "x")]
    )
    first = command.measured(compose(moving))
    assert command.measured(compose(moving)) == first and len(calls) == 1
    path = tmp_path / "moves.yaml"
    path.write_text(path.read_text().replace("end: [2, 2, 2]", "end: [3, 3, 3]"))
    command.measured(compose(moving))
    assert len(calls) == 2


def test_an_unknown_variable_is_an_error(moving):
    cfg = compose([*moving, "method.ignored=[lamb]"])
    with pytest.raises(PrtError, match="has no variable 'lamb'; it has lamp, hidden"):
        fitted(cfg, build_task(cfg))


def test_of_a_relighting_task(tiny_task, monkeypatch):
    monkeypatch.setattr(needs, "VIEWS", 2)
    monkeypatch.setattr(needs, "SIZE", 16)
    monkeypatch.setattr(needs, "SPP", 16)
    found = {need.name: need for need in measure(tiny_task)}
    assert (
        0 < found["share/indirect"].value < 1
        and 0 <= found["share/mirror"].value <= found["share/glossy"].value
    )
    assert found["transport/wavelets"].value <= found["lighting/wavelets"].value, "fine wavelets reach little"
    assert 1 <= found["transport/rank"].value and found["surface/cells"].value > 4
    words = [a.override for a in advise("relight_indirect", list(found.values()))]
    assert words[0] == "task=relight_indirect"
    compose([*words, "budget=smoke"])


def of_relighting(**changes):
    values = {
        "lighting/wavelets": 100, "lighting/bands": 9, "transport/wavelets": 50, "transport/rank": 14,
        "transport/rank_fine": 80, "share/indirect": 0.3, "share/glossy": 0.4, "share/mirror": 0.0,
        "surface/cells": 5000,
    } | changes  # fmt: skip
    return advise("relight_indirect", [Need(k, v, "what it is", 100) for k, v in values.items()])


def test_advice_follows_the_figures():
    words = [a.override for a in of_relighting()]
    assert {"method.wavelets=64", "method.grid.log2_table=13"} <= set(words)
    assert not any("secondary" in word for word in words)
    assert any("secondary" in a.override for a in of_relighting(**{"share/mirror": 0.2}))
    smooth = of_relighting(**{"share/indirect": 0.02, "lighting/bands": 3})
    assert [a.override for a in smooth] == ["task=relight_direct", "method=learnt_sh", "task.order=3"]
    unknown = of_relighting(**{"transport/wavelets": None})
    assert "method.wavelets=256" in [a.override for a in unknown]
    for advice in (of_relighting(), smooth, unknown):
        assert all(a.reason and "\n" not in a.reason for a in advice)
        compose([a.override for a in advice])


def test_the_rank_of_lightmaps(monkeypatch, tmp_path):
    """Three lamps that only change their brightness: every lightmap is a mixture of three."""
    first = torch.rand((12, 3), generator=torch.Generator().manual_seed(0)) @ torch.rand((3, 60))

    class Task:
        name = "local_lights"
        scene = type("Scene", (), {"name": "box"})

        def rigs(self, split, count):
            return [], list(range(12))

        def baked_twice(self, rig, spp, seed):
            return tuple(first[rig].view(20, 3) + 1e-6 * torch.randn(20, 3) for _ in range(2))

    found = measure(Task())
    assert found[1].value == 3 and found[0].value <= 3
    words = [a.override for a in advise("local_lights", found)]
    assert words[-1] == f"method.basis={found[0].value}"


def test_the_command_chooses_the_task(monkeypatch, capsys):
    assert "task=animate" in command.with_task(["scene=cornell_animated"])
    assert "task=local_lights" in command.with_task(["scene=cornell_box", "lighting=spots"])
    assert "task=relight_indirect" in command.with_task(["scene=cornell_glossy"])
    asked = command.with_task(["task=relight_direct", "scene=cornell_glossy"])
    assert asked == ["task=relight_direct", "scene=cornell_glossy"]
    monkeypatch.setattr(needs, "MEASURES", {"animate": lambda task: [Need("variable/lamp", 0.5, "change")]})
    assert main(["needs", "scene=cornell_animated", "scene.variables=1"]) == 0
    out = capsys.readouterr().out
    assert "prt run scene=cornell_animated scene.variables=1 task=animate method=dynamic_radiosity" in out
    assert main(["needs", "scene=cornell_glossi"]) == 2
    assert "cornell_glossy" in capsys.readouterr().err

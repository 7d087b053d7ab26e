"""Broken and extreme input: what `prt table stability/inputs` counts, and that real methods withstand it."""

import pytest
import tiny
import torch

from prt.bench.compose import compose
from prt.bench.run import fitted
from prt.errors import PrtError
from prt.light.local import LightRig, LocalLight
from prt.methods.base import Component, check_lighting
from prt.methods.benchmark_inputs import EXTREME, WRONG, bad_inputs, spoilt


class Careless:
    """A method that takes whatever it is given."""

    component = Component.INDIRECT

    def light(self, lighting):
        return lighting.mean()

    def shade(self, gbuffer, code, v=None):
        return torch.ones((len(gbuffer), 3)) * code


def figures(rows):
    return {row["variant"].removeprefix("input="): row["value"] for row in rows}


def test_harm_in_silence_is_counted(tiny_task):
    found = figures(bad_inputs(tiny_task, Careless()))
    assert found == dict.fromkeys(WRONG, 1.0) | dict.fromkeys(EXTREME, 0.0) | {"any": 1.0}

    class Glowing(Careless):
        def shade(self, gbuffer, code, v=None):
            return super().shade(gbuffer, code) + 0.1

    assert figures(bad_inputs(tiny_task, Glowing()))["black"] == 1.0


@pytest.mark.parametrize("method", ["wavelet_neural", "neural_prt", "basis_neural"])
def test_methods_of_environments_withstand_it(method, tiny_task, maps, own_cache, tmp_path):
    words = [*tiny.TASK, *tiny.lights(maps), f"method={method}", "method.training.steps=3"]
    model = fitted(compose([*words, f"run.folder={tmp_path}"]), tiny_task)
    assert set(figures(bad_inputs(tiny_task, model)).values()) == {0.0}


def test_what_no_light_can_be_is_refused():
    good = tiny.random_cubemap()
    check_lighting(good, tiny.RESOLUTION)
    check_lighting(torch.zeros_like(good))
    for kind in WRONG:
        with pytest.raises(PrtError, match="1 (NaN|infinite|negative) of .* texels"):
            check_lighting(spoilt(good, kind))
    with pytest.raises(PrtError, match="task.resolution=16"):
        check_lighting(good, 16)


def test_rigs_and_states_are_spoilt_too():
    rig = LightRig((LocalLight("point", (1.0, 1.0, 1.0)), LocalLight("point", (2.0, 1.0, 1.0))))
    for kind in WRONG:
        with pytest.raises(PrtError, match="finite and not negative"):
            spoilt(rig, kind)
    assert spoilt(rig, "black").lights == () and len(spoilt(rig, "one").lights) == 1
    assert spoilt(rig, "huge").lights[0].color == (1e6, 1e6, 1e6)
    state = torch.tensor([0.2, 0.4, 0.6])
    assert spoilt(state, "nan").isnan().sum() == 1 and not spoilt(state, "negative").isfinite().all()

"""Active exploration: the furnace that a variable dims, and what a checkpoint brings back."""

import numpy as np
import pytest
import torch
from test_dynamic_radiosity import INSIDE, rendered
from test_dynamic_radiosity import task as furnace

from prt.errors import PrtError
from prt.methods.active_exploration import ActiveExploration, Explorer
from prt.methods.base import Silent
from prt.scene.capture import sensor_description
from prt.scene.mitsuba_setup import mitsuba


def task():
    """The furnace with images of it."""
    where = furnace()

    def render(v, view, spp, seed):
        where.stage.set(v)
        mi = mitsuba()
        sensor, path = mi.load_dict(sensor_description(view)), mi.load_dict({"type": "path", "max_depth": 24})
        image = mi.render(where.stage.mi_scene, sensor=sensor, integrator=path, spp=spp, seed=seed)
        return torch.from_numpy(np.array(image))

    where.render = render
    where.training_views = lambda count, size: [INSIDE.resized(size, size)] * count
    return where


def method(**changes):
    training = {
        "steps": 250, "images": 40, "size": 12, "spp": 4, "batch": 2, "rate": 3e-3, "average": 0.9,
        "small_step": 0.1, "large_steps": 0.3, "uniform": False,
    }  # fmt: skip
    return ActiveExploration(32, 2, 2, training | changes)


@pytest.mark.parametrize("uniform", [False, True])
def test_a_furnace_that_is_dimmed_is_learnt_from_images(uniform):
    where, found = task(), method(uniform=uniform)
    found.fit(where, Silent(), 0, "cpu")
    for v in (0.1, 0.5, 0.9):
        assert rendered(found, where, [v]).mean() == pytest.approx(2 * (0.5 + v), rel=0.1)


def test_a_resumed_explorer_has_the_same_images_and_chain():
    where, found = task(), method()
    found.build(where, "cpu")
    first = Explorer(found, where, torch.Generator().manual_seed(0))
    for _ in range(40):
        first.loss()
    again = Explorer(found, where, torch.Generator().manual_seed(0))
    again.load_state_dict(first.state_dict())
    assert len(again.examples) == len(first.examples) > 2
    for a, b in zip(again.examples, first.examples, strict=True):
        assert torch.equal(a.v, b.v) and torch.equal(a.target, b.target)
    assert again.step == first.step and torch.equal(again.chain.current, first.chain.current)


def test_settings_out_of_range_are_refused():
    with pytest.raises(PrtError, match="method.training.images=0"):
        method(images=0)

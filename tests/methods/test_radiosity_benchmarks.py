"""Benchmarks of dynamic radiosity on a small animated box: what they report, and in which direction."""

import copy

import pytest
import torch
from test_dynamic_radiosity import settings

from prt.bench.compose import compose
from prt.bench.run import build_task
from prt.errors import PrtError
from prt.methods import benchmark_radiosity
from prt.methods.dynamic_radiosity import DynamicRadiosity
from prt.metrics.diagnostics import diagnostic_of


def task(*more):
    return build_task(
        compose(["task=animate", "budget=smoke", "task.size=16", "task.spp=64", "task.states=1", *more])
    )


def found(rows, metric):
    return {row["variant"]: row["value"] for row in rows if row["metric"] == metric}


def test_the_right_hand_side_costs_more_and_errs_less(tmp_path):
    where = task()
    model = benchmark_radiosity.fitted(where, settings(steps=40))
    rows = benchmark_radiosity.renderings(where, model, tmp_path, [64], [4])
    error, taken = found(rows, "mape"), found(rows, "time/shade")
    assert set(error) == {"left_hand=1", "right_hand=64", "pixel_samples=4"} == set(taken)
    assert error["right_hand=64"] < error["left_hand=1"]
    assert taken["right_hand=64"] > taken["left_hand=1"]
    assert (tmp_path / "renderings.png").stat().st_size > 1000


def test_fine_tuning_brings_a_static_network_to_another_state():
    where = task("task.states=0", "task.given=[[0.9,0.9]]")
    model = benchmark_radiosity.fitted(where, settings(steps=40))
    rows = benchmark_radiosity.fine_tuning(where, model, settings(steps=40), 0.4, [0, 40])
    error = {(row["method"], row["variant"]): row["value"] for row in rows if row["metric"] == "mape"}
    assert error["static_radiosity", "steps=40"] < error["static_radiosity", "steps=0"]
    assert ("dynamic_radiosity", "") in error
    assert all(diagnostic_of(row["metric"]) or row["metric"].startswith(("time/", "mape")) for row in rows)
    with pytest.raises(PrtError, match="set task.given"):
        benchmark_radiosity.fine_tuning(task(), model, settings(steps=2), 0.4, [0])


def test_each_variable_changes_the_image_and_costs_a_move():
    rows = benchmark_radiosity.variables(task("scene.variables=2"), states=1, spp=16, size=16)
    change, cost = found(rows, "change/image"), found(rows, "time/move")
    assert set(change) == {"variable=box", "variable=ball"} == set(cost)
    assert min(change.values()) > 0 and min(cost.values()) > 0


@pytest.mark.parametrize("encoding", ["decomposed", "conditioned", "kplanes"])
def test_parts_of_a_frame_are_timed_and_sized(encoding):
    where = task()
    changes = copy.deepcopy(settings(steps=1, encoding=encoding))
    if encoding == "kplanes":
        changes["planes"] |= {"variable_resolution": 4}
    model = DynamicRadiosity(**changes)
    model.build(where, "cpu")
    item = where.tests()[0]
    parts = model.timed_parts(item.lighting, item.gbuffer)
    assert {"move_twice", "trace", "network", "state", "features", "variables", "decoder"} == set(parts)
    for work in parts.values():
        work()
    assert sum(model.sized_parts().values()) == model.nbytes()
    with torch.no_grad():
        values = model.shade(item.gbuffer, model.light(item.lighting))
    assert values.shape == (256, 3)

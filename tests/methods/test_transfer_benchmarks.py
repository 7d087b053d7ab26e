"""What the tables of Dhawal 2022 measure: every figure is there, and moves the way it must."""

import pytest

from prt.bench.compose import compose
from prt.bench.run import build_task
from prt.errors import PrtError
from prt.methods import benchmark_transfer, gl_context, stability_transfer
from prt.methods.partition_pictures import figure5
from prt.trace.surface import MeshSurface

SMALL = ["task=relight_direct", "budget=smoke", "task.train_points=2000", "task.directions=64",
         "task.texels=0", "task.size=24", "task.views=1", "task.split_views=0",
         "task.reference_directions=32", "task.truth_samples=32"]  # fmt: skip
METHOD = {
    "neurons": 16, "layers": 2, "position_frequencies": 3, "normal_frequencies": 0,
    "training": {"steps": 150, "batch": 512, "rate": 5e-3, "average": 0.9, "loss": "l1",
                 "scale_outputs": True},
}  # fmt: skip


@pytest.fixture(scope="module")
def words(module_lights):
    return [*SMALL, *module_lights]


@pytest.fixture(scope="module")
def mesh(words):
    return build_task(compose([*words, "scene=four_shapes"]))


@pytest.fixture(scope="module")
def field(words):
    return build_task(compose([*words, "scene=sdf_rabbit"]))


def figures(rows, metric):
    """Variant (and split) to value."""
    return {row["variant"] + row["split"]: row["value"] for row in rows if row["metric"] == metric}


def test_capacity_names_the_smallest_size_that_is_enough(mesh):
    rows = benchmark_transfer.capacity(mesh, METHOD, [[2, 1], [16, 2]], [0.5, 1e-9], [1, 4], views=1)
    error = figures(rows, "error/held_out")
    assert error["neurons=16,layers=2"] < 0.5 < error["neurons=2,layers=1"]
    assert figures(rows, "neurons/chosen") == {"target=0.5": 16}  # 1e-9 is met by none
    noise = figures(rows, "error/noise")[""]
    assert 0 < noise < error["neurons=16,layers=2"]
    bands = figures(rows, "error/bands")
    assert bands["order=4diffuse"] < bands["order=1diffuse"]


def test_failures_of_a_mesh(mesh):
    rows = stability_transfer.measure_failures(mesh, METHOD, [0.0, 0.3], [[2, 1]], [0.0, 0.1], [0, 20])
    error = figures(rows, "error/relative")
    assert error["off_surface=0"] < error["off_surface=0.3"]
    assert (
        error["normals=right"] < error["normals=flipped"]
        and error["normals=missing"] > error["normals=right"]
    )
    assert error["off_surface=0"] == pytest.approx(error["normals=right"])
    assert error["neurons=2,layers=1"] > error["normals=right"]
    negative = figures(rows, "negative/energy")
    assert negative["window=0.1,exponent=20"] < negative["window=0,exponent=20"]
    near = [row for row in rows if row["variant"].startswith("distance=")]
    # almost nothing else is near the points of this one: they are in the last bin, of two figures, and
    # bins with fewer points than say anything are left out
    assert [row["variant"] for row in near] == ["distance=1"] * 2
    assert all(150 <= row["n"] <= 200 for row in near)


def test_the_distance_to_another_surface(words):
    surface = MeshSurface(build_task(compose([*words, "scene=four_shapes"])).scene, 0)
    points = surface.sample(300, 0)
    found = stability_transfer.other_surface(surface, points.position, points.normal)
    assert float(found.min()) > 0 and float(found.max()) <= 2.0001 * surface.extent
    # above the middle of a floor there is nothing, below neither
    assert float(found.max()) == pytest.approx(2 * surface.extent)


def test_a_margin_closes_seams(mesh):
    method = {**METHOD, "cells": [2, 1, 2], "networks": 4}
    method["training"] = {**METHOD["training"], "steps": 300, "batch": 2048}
    rows = stability_transfer.seams(mesh, method, [0.0, 0.1], reach=0.02)
    seam = figures(rows, "seam/transfer")
    assert seam["margin=0.1"] < seam["margin=0"]
    assert figures(rows, "networks/used") == {"margin=0": 4, "margin=0.1": 4}
    with pytest.raises(PrtError, match="there are no seams"):
        stability_transfer.seams(mesh, METHOD, [0.0])


def test_step_limits_are_counted(field, mesh):
    rows = stability_transfer.step_limits(field, [4, 512])
    lost = figures(rows, "rays/exhausted")
    assert lost["steps=4"] > 0.2 and lost["steps=512"] < 0.01
    assert figures(rows, "error/relative")["steps=4"] > figures(rows, "error/relative")["steps=512"]
    with pytest.raises(PrtError, match="is a mesh"):
        stability_transfer.step_limits(mesh, [4])


def test_frames_a_second(mesh, field):
    problem = gl_context.available()
    if problem:
        pytest.skip(problem)
    sizes = [[8, 1], [700, 4]]  # the second does not fit in a shader: no row, but one for torch
    for rows in (benchmark_transfer.mesh_frames(mesh, METHOD, sizes, 3),
                 benchmark_transfer.sdf_frames(field, METHOD, sizes[:1], 3)):  # fmt: skip
        rates = figures(rows, "frames/glsl")
        assert set(rates) == {"neurons=8,layers=1diffuse", "neurons=8,layers=1glossy"}
        assert all(rate > 0 for rate in rates.values())
    rates = figures(benchmark_transfer.mesh_frames(mesh, METHOD, sizes[1:], 1), "frames/torch")
    assert set(rates) == {"neurons=700,layers=4diffuse", "neurons=700,layers=4glossy"}
    with pytest.raises(PrtError, match="has no GLSL"):
        benchmark_transfer.sdf_frames(mesh, METHOD, [[8, 1]], 1)


def test_a_field_in_plain_torch_has_no_glsl():
    class Scene:
        name, sdf = "mine", None

    with pytest.raises(PrtError, match="scene=mine has no GLSL"):
        benchmark_transfer.sdf_glsl(Scene())


def test_figure_5_is_drawn(mesh, tmp_path):
    method = {**METHOD, "cells": [2, 1, 2], "networks": 3}
    rows = figure5(mesh, method, tmp_path, larger=24, views=1)
    assert figures(rows, "networks/used") == {
        "networks=one": 1, "networks=larger": 1, "networks=cells": 4, "networks=merged": 3,
    }  # fmt: skip
    size = figures(rows, "bytes/model")
    assert size["networks=one"] < size["networks=merged"] < size["networks=cells"]
    for name in ("plan.png", "render.png"):
        assert (tmp_path / name).stat().st_size > 10_000
    with pytest.raises(PrtError, match="must both be set"):
        figure5(mesh, METHOD, tmp_path, larger=24)

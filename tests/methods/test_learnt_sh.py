"""Learnt transfer: it learns, resumes to the same numbers, is cut into cells, is stored; what is refused."""

import dataclasses
import math
import types

import pytest
import torch
from tiny import Log

from prt.errors import PrtError
from prt.methods.gl_context import available
from prt.methods.irradiance_volume import times_cosine
from prt.methods.learnt_sh import LearntSh, held_out_error
from prt.nn.encodings import frequencies
from prt.nn.transfer_network import TransferNetwork
from prt.scene.gbuffer import GBuffer
from prt.scene.view import View
from prt.tasks.relight_direct import TransferPoints
from prt.trace.surface import SurfacePoints

BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))


def field(count=4000, seed=0):
    """Points of a ball in the light of a soft gradient: transfer that depends on both inputs."""
    normal = torch.nn.functional.normalize(
        torch.randn((count, 3), generator=torch.Generator().manual_seed(seed)), dim=1
    )
    visible = torch.zeros((count, 16))
    visible[:, 0] = math.sqrt(4 * math.pi) * (0.6 + 0.4 * normal[:, 1])
    return SurfacePoints(normal, normal), times_cosine(visible, normal)


def task_of(order=4):
    points, transfer = field()
    data = TransferPoints(points, transfer[:, : order**2], BOX)
    return types.SimpleNamespace(order=order, windowing=0.0, training=lambda: data)


def method_of(steps=300, **changes):
    training = {
        "steps": steps,
        "batch": 256,
        "rate": 5e-3,
        "average": 0.9,
        "loss": "l1",
        "scale_outputs": True,
    }
    training |= {k: changes.pop(k) for k in ("loss", "scale_outputs", "average") if k in changes}
    return LearntSh(**{"neurons": 24, "layers": 2, "position_frequencies": 1, "normal_frequencies": 0,
                       "training": training, **changes})  # fmt: skip


def gbuffer_of(points):
    one = torch.ones_like(points.position)
    return GBuffer(points.position, points.normal, points.normal, points.normal, one, 0 * one, one[:, :1],
                   one[:, :2], torch.ones(len(one), dtype=torch.bool))  # fmt: skip


def error(method, seed=9):
    points, transfer = field(500, seed)
    with torch.no_grad():
        return float((method.transfer(gbuffer_of(points)) - transfer).norm() / transfer.norm())


@pytest.mark.parametrize("changes", [{}, {"loss": "l2"}, {"scale_outputs": False}, {"average": 0.0}])
def test_it_learns_the_transfer(changes):
    method, log = method_of(**changes), Log()
    method.fit(task_of(), log, 0, "cpu")
    assert log.losses[-1] < 0.3 * log.losses[0]
    # without the scale the tanh learns small numbers at a slower pace
    assert error(method) < (0.15 if changes.get("scale_outputs", True) else 0.4)


def test_an_interrupted_fit_ends_with_the_same_weights():
    whole = method_of(40)
    whole.fit(task_of(), Log(), 3, "cpu")
    log = Log(every=10, stop_at=25)
    with pytest.raises(InterruptedError):
        method_of(40).fit(task_of(), log, 3, "cpu")
    resumed = method_of(40)
    resumed.fit(task_of(), Log(kept=log.kept), 3, "cpu")
    for a, b in zip(whole.nets.parameters(), resumed.nets.parameters(), strict=True):
        assert torch.equal(a, b)


def test_cells_have_networks_of_their_own():
    method = method_of(300, cells=[2, 1, 1], margin=0.1)
    method.fit(task_of(), Log(), 0, "cpu")
    assert len(method.nets) == 2 and error(method) < 0.2
    # each network learnt beyond its own half, and no further than the margin
    # (the middle of [-1, 0.2] and of [-0.2, 1]: the margin is a share of the box's side of 2)
    middles = sorted(float(net.centre[0]) for net in method.networks_of())
    assert middles == pytest.approx([-0.4, 0.4], abs=0.03)
    # a point is served by the network of its own cell
    points, _ = field(100, 5)
    one = method.transfer(gbuffer_of(points))
    for number, net in enumerate(method.networks_of()):
        rows = method.partition.group_of(points.position) == number
        torch.testing.assert_close(one[rows], net(points.position[rows], points.normal[rows]))
    merged = method_of(1, cells=[2, 1, 1], networks=1)
    merged.fit(task_of(), Log(), 0, "cpu")
    assert len(merged.nets) == 1


@pytest.mark.parametrize("cells", [None, [2, 2, 1]])
def test_it_survives_the_disk(cells, tmp_path):
    method = method_of(5, cells=cells)
    method.fit(task_of(), Log(), 0, "cpu")
    method.save(tmp_path / "x.safetensors")
    again = method_of(5, cells=cells)
    again.load(tmp_path / "x.safetensors", task_of(), "cpu")
    points, _ = field(200, 2)
    assert torch.equal(again.transfer(gbuffer_of(points)), method.transfer(gbuffer_of(points)))
    # weights and little else
    assert abs((tmp_path / "x.safetensors").stat().st_size - method.nbytes()) < 4096
    with pytest.raises(PrtError, match="other layer sizes than method.neurons=25"):
        method_of(5, cells=cells, neurons=25).load(tmp_path / "x.safetensors", task_of(), "cpu")


def test_the_sizes_of_the_paper_take_what_it_says():
    """Section 5.4: "our method only needs around 64KB"."""
    net = TransferNetwork(([0.0] * 3, [1.0] * 3), 64, 4, 16, 5, 1)
    assert 60_000 < net.nbytes() < 100_000


def test_the_network_as_written_by_hand():
    net = TransferNetwork(([-2.0, 0.0, 0.0], [2.0, 1.0, 1.0]), 5, 2, 9, 2, 1)
    net.scale.fill_(0.5)
    p, n = torch.tensor([[1.0, 0.5, 0.75]]), torch.tensor([[0.0, 1.0, 0.0]])
    x = torch.cat([frequencies((p - torch.tensor([0.0, 0.5, 0.5])) / 2, 2), frequencies(n, 1)], 1)
    for layer in net.mlp.layers[:-1]:
        x = layer(x)
        x = torch.where(x > 0, x, 0.01 * x)
    torch.testing.assert_close(net(p, n), 0.5 * torch.tanh(net.mlp.layers[-1](x)))


def test_frequencies():
    x = torch.tensor([[0.25, -0.5]])
    assert torch.equal(frequencies(x, 0), x)
    found = frequencies(x, 2)
    s = math.sqrt(0.5)
    expected = [[0.25, -0.5, s, -1, s, 0, 1, 0, 0, -1]]
    torch.testing.assert_close(found, torch.tensor(expected), atol=1e-6, rtol=0)
    with pytest.raises(PrtError, match="octaves=-1"):
        frequencies(x, -1)


@pytest.mark.parametrize(("changes", "message"), [
    ({"neurons": 0}, "method.neurons=0"), ({"layers": 1.5}, "method.layers=1.5"),
    ({"loss": "l3"}, "method.training.loss='l3'"), ({"renderer": "vulkan"}, "method.renderer='vulkan'"),
    ({"margin": -1}, "method.margin=-1"), ({"neurons": "auto"}, "method.ladder, which is empty"),
    ({"neurons": "auto", "ladder": [[4, 0]]}, r"method.ladder\[0\]=0"), ({"target": 0}, "method.target=0"),
    ({"networks": 2}, "method.networks=2 merges cells"),
])  # fmt: skip
def test_refusals(changes, message):
    with pytest.raises(PrtError, match=message):
        method_of(**changes)


def auto_task():
    points, transfer = field(400, 77)
    task = task_of()
    task.held_out = lambda: TransferPoints(points, transfer, BOX)
    return task


def test_the_smallest_size_that_meets_the_target_is_taken(tmp_path):
    ladder = [[1, 1], [16, 2], [24, 2]]
    method, log = method_of(300, neurons="auto", ladder=ladder, target=0.2), Kept()
    method.fit(auto_task(), log, 0, "cpu")
    assert (method.neurons, method.layers) == (16, 2)
    errors = [values["held_out_error"] for values in log.steps]
    assert len(errors) == 2 and errors[0] > 0.2 > errors[1] == pytest.approx(
        held_out_error(auto_task(), method)
    )
    method.save(tmp_path / "x.safetensors")
    again = method_of(300, neurons="auto", ladder=ladder, target=0.2)
    again.load(tmp_path / "x.safetensors", auto_task(), "cpu")
    assert (again.neurons, again.layers) == (16, 2) and again.nbytes() == method.nbytes()
    # resumed after the last size was trained, and after the one before
    for kept in (log.kept, log.first):
        resumed, more = method_of(300, neurons="auto", ladder=ladder, target=0.2), Kept(kept)
        resumed.fit(auto_task(), more, 0, "cpu")
        assert (resumed.neurons, len(more.steps)) == (16, 0 if kept is log.kept else 1)
        assert torch.equal(resumed.nets[0].mlp.layers[0].weight, method.nets[0].mlp.layers[0].weight)


def test_a_target_no_size_meets_is_an_error_with_the_best():
    method = method_of(20, neurons="auto", ladder=[[2, 1], [4, 1]], target=1e-6)
    with pytest.raises(PrtError, match=r"meets method.target=1e-06: the largest has a held-out error of "):
        method.fit(auto_task(), Kept(), 0, "cpu")


class Kept:
    """Keeps all steps and the first and last state."""

    def __init__(self, kept=None):
        self.kept, self.first, self.steps = kept, None, []

    def start(self, steps, label):
        pass

    def step(self, step, **values):
        self.steps.append(values)

    def save(self, step, state):
        self.kept = (step, state)
        self.first = self.first or self.kept

    def resume(self):
        return self.kept


@pytest.mark.parametrize("cells", [None, [2, 1, 1]])
def test_the_shader_draws_what_torch_computes(cells):
    problem = available()
    if problem:
        pytest.skip(problem)
    method = method_of(20, cells=cells)
    method.fit(task_of(), Log(), 0, "cpu")
    points, _ = field(64, 4)
    view = View((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), width=8, height=8)
    gbuffer = dataclasses.replace(gbuffer_of(points), view=view, hit=torch.ones(64, dtype=torch.bool))
    code = method.light(torch.rand((6, 8, 8, 3), generator=torch.Generator().manual_seed(0)))
    expected = method.shade(gbuffer, code)
    method.renderer = "glsl"
    torch.testing.assert_close(method.shade(gbuffer, code), expected, atol=1e-4, rtol=0)
    with pytest.raises(PrtError, match="draws images"):
        method.shade(gbuffer.rows(torch.arange(5)), code)


def test_before_fitting():
    with pytest.raises(PrtError, match="no transfer yet"):
        method_of().light(torch.ones((6, 8, 8, 3)))
    with pytest.raises(PrtError, match="no network yet"):
        method_of().transfer(gbuffer_of(field(3)[0]))

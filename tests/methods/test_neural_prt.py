"""Neural PRT: sizes, scaling with the light, storage, and that it can learn a tiny scene."""

import types

import pytest
import torch

from prt.errors import PrtError
from prt.light.cubemap import direction_to_texel
from prt.methods.neural_prt import LightEncoder, NeuralPrt, NeuralPrtNet
from prt.scene.gbuffer import GBuffer
from prt.trace.transport import Transport

RESOLUTION, POINTS, LIGHTINGS = 8, 48, 6
BOUNDS = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
TRAINING = dict(
    steps=150, pixels=32, lightings=4, loss="mu_law", mu=10.0, epsilon=1.0, rate=5e-3, average=0.0,
    strategies=dict(uniform=1.0, specular=1.0),
)  # fmt: skip
SIZES = dict(width=24, hidden_layers=2, code=8, channels=4, narrow=4, position_bins=4, sh_degree=2)


class Log:
    """A log in memory that can stop a fit after some steps."""

    def __init__(self, stop_after: int | None = None, kept=None):
        self.losses, self.stop_after, self.kept = [], stop_after, kept

    def start(self, steps, label):
        self.steps = steps

    def step(self, step, loss):
        self.losses.append(loss)

    def checkpoint_due(self, step):
        return step in (self.stop_after, self.steps)

    def save(self, step, state):
        import copy

        self.kept = (step, copy.deepcopy(state))
        if step == self.stop_after:
            raise InterruptedError

    def resume(self):
        return self.kept


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """Tiny matrices: threads only wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def task():
    generator = torch.Generator().manual_seed(0)

    def unit(rows, columns):
        return torch.rand(rows, columns, generator=generator)

    def directions():
        return torch.nn.functional.normalize(torch.randn(POINTS, 3, generator=generator), dim=1)

    gbuffer = GBuffer(
        unit(POINTS, 3) * 2 - 1, directions(), directions(), directions(), unit(POINTS, 3), unit(POINTS, 3),
        unit(POINTS, 1), unit(POINTS, 2), torch.ones(POINTS, dtype=torch.bool),
    )  # fmt: skip
    # each point sees the lighting about its normal, in its diffuse colour
    per_point, texels = 50, 6 * RESOLUTION**2
    samples = gbuffer.normal.repeat_interleave(per_point, 0)
    samples = samples + 0.7 * torch.randn(samples.shape, generator=generator)
    transport = Transport(
        RESOLUTION, torch.arange(POINTS + 1) * per_point,
        direction_to_texel(torch.nn.functional.normalize(samples, dim=1), RESOLUTION),
        gbuffer.diffuse.repeat_interleave(per_point, 0) / per_point,
        torch.full((POINTS * per_point,), 2, dtype=torch.uint8),
    )  # fmt: skip
    lightings = torch.rand(LIGHTINGS, texels, 3, generator=generator) ** 4 * torch.tensor([1.0, 2.0, 0.5])
    training = types.SimpleNamespace(
        gbuffer=gbuffer, transport=transport, importance={"specular": torch.ones(POINTS)}, bounds=BOUNDS
    )
    return types.SimpleNamespace(
        scene=types.SimpleNamespace(bounds=BOUNDS), resolution=RESOLUTION,
        training=lambda: training, train_lightings=lambda: lightings,
    )  # fmt: skip


def make(**training) -> NeuralPrt:
    return NeuralPrt(**SIZES, training={**TRAINING, **training})


@pytest.fixture(scope="module")
def fitted(task):
    method, log = make(), Log()
    method.fit(task, log, 0, "cpu")
    return method, log


def cubemap(task, number=0):
    return task.train_lightings()[number].view(6, RESOLUTION, RESOLUTION, 3)


def test_learns_a_tiny_scene(fitted, task):
    method, log = fitted
    assert sum(log.losses[-10:]) < 0.1 * sum(log.losses[:10])
    data = task.training()
    truth = data.transport.relight(task.train_lightings())
    codes = [method.light(cubemap(task, i)) for i in range(LIGHTINGS)]
    image = torch.stack([method.shade(data.gbuffer, code) for code in codes])
    error = (image - truth).square().mean()
    assert error < 0.3 * (truth - truth.mean((0, 1))).square().mean()  # more than the mean colour was learnt


def test_a_brighter_light_scales_exactly(fitted, task):
    method, _ = fitted
    gbuffer = task.training().gbuffer
    image = method.shade(gbuffer, method.light(cubemap(task)))
    assert image.shape == (POINTS, 3) and bool((image >= 0).all())
    brighter = method.shade(gbuffer, method.light(1e6 * cubemap(task)))
    torch.testing.assert_close(brighter, 1e6 * image, rtol=1e-4, atol=0)


def test_difficult_lights(fitted, task):
    method, _ = fitted
    gbuffer = task.training().gbuffer
    black = method.shade(gbuffer, method.light(torch.zeros_like(cubemap(task))))
    assert torch.equal(black, torch.zeros((POINTS, 3)))
    single = torch.zeros_like(cubemap(task))
    single[2, 3, 4] = 1e6
    assert bool(method.shade(gbuffer, method.light(single)).isfinite().all())
    with pytest.raises(PrtError, match="16 texels"):
        method.light(torch.ones(6, 16, 16, 3))


def test_chunks_and_empty_views(fitted, task):
    method, _ = fitted
    gbuffer, code = task.training().gbuffer, method.light(cubemap(task))
    whole = method.shade(gbuffer, code)
    small = make()
    small.net, small.resolution, small.chunk = method.net, method.resolution, 7
    torch.testing.assert_close(small.shade(gbuffer, code), whole)
    assert method.shade(gbuffer.rows(torch.zeros(0, dtype=torch.int64)), code).shape == (0, 3)


def test_decoder_is_that_of_the_concatenated_codes(fitted, task):
    # The fast form splits the first layer of the decoder; the architecture concatenates the codes.
    branch = fitted[0].net.diffuse
    generator = torch.Generator().manual_seed(3)
    features = torch.randn(5, branch.transport.layers[0].in_features, generator=generator)
    light = torch.randn(2, SIZES["code"], generator=generator)
    transport = torch.relu(branch.transport(features))
    both = torch.cat([transport[None].expand(2, -1, -1), light[:, None].expand(-1, 5, -1)], -1)
    torch.testing.assert_close(branch(features, light), torch.nn.functional.softplus(branch.decoder(both)))


def test_save_and_load(fitted, task, tmp_path):
    method, _ = fitted
    path = tmp_path / "checkpoint.safetensors"
    method.save(path)
    again = make()
    again.load(path, task, "cpu")
    gbuffer = task.training().gbuffer
    assert torch.equal(
        again.shade(gbuffer, again.light(cubemap(task))), method.shade(gbuffer, method.light(cubemap(task)))
    )
    assert again.nbytes() == method.nbytes() > 0
    other = NeuralPrt(**{**SIZES, "width": 25}, training=TRAINING)
    with pytest.raises(PrtError, match="layer sizes"):
        other.load(path, task, "cpu")


def test_interrupted_fit_ends_with_the_same_weights(task):
    straight = make(steps=12, average=0.9)
    straight.fit(task, Log(), 1, "cpu")
    log, method = Log(stop_after=5), make(steps=12, average=0.9)
    with pytest.raises(InterruptedError):
        method.fit(task, log, 1, "cpu")
    resumed = make(steps=12, average=0.9)
    resumed.fit(task, Log(kept=log.kept), 1, "cpu")
    for name, value in straight.net.state_dict().items():
        assert torch.equal(value, resumed.net.state_dict()[name]), name


def test_half_a_million_parameters_at_paper():
    from omegaconf import OmegaConf

    from prt.bench.compose import conf_folder  # importing it registers by_budget

    settings = OmegaConf.create({
        "budget": {"name": "paper"},
        "method": OmegaConf.load(conf_folder() / "method" / "neural_prt.yaml"),
        "task": OmegaConf.load(conf_folder() / "task" / "relight_indirect.yaml"),
    })  # fmt: skip
    sizes = {name: settings.method[name] for name in SIZES}
    net = NeuralPrtNet(BOUNDS, settings.task.resolution, **sizes)
    assert 0.4e6 < sum(p.numel() for p in net.parameters()) < 0.6e6


@pytest.mark.parametrize("resolution", [3, 12, 2])
def test_unusable_resolution(resolution):
    with pytest.raises(PrtError, match="power of 2"):
        LightEncoder(resolution, 4, 4, 8)


def test_wrong_setting():
    with pytest.raises(PrtError, match="method.width=0"):
        NeuralPrt(**{**SIZES, "width": 0}, training=TRAINING)

"""The folded renderer equals the readable one, sampling obeys its settings, fitting lowers the loss."""

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from prt.errors import PrtError
from prt.light import haar
from prt.methods.wavelet_neural import WaveletNeural, level_growth
from prt.scene.gbuffer import GBuffer

RESOLUTION = 8
TRAINING = dict(
    steps=30,
    pixels=64,
    wavelets=32,
    largest_share=0.5,
    draw="transport",
    lightings=2,
    lightings_per_view=None,
    supervision="images",
    target="truncated",
    loss="mu_law_slope",
    precision="float32",
    mu=10.0,
    epsilon=1.0,
    rates=dict(grid=1e-2, wavelet=1e-2, mlp=2e-3),
    decay=dict(grid=0.3, wavelet=0.1, mlp=0.0),
    average=0.9,
    gain_points=0,
    strategies=dict(uniform=1.0, specular=1.0),
)


def make(**changes) -> WaveletNeural:
    training = {**TRAINING, **changes.pop("training", {})}
    settings = dict(
        wavelets=16,
        selection="transport",
        width=32,
        directions=dict(kind="sh", degree=4, bins=8, levels=2, features=2, base_resolution=2, scale=2.0),
        scale_outputs=True,
        texture="shared",
        training=training,
        grid=dict(levels=4, features=2, log2_table=10, base_resolution=4, scale=1.5),
    )
    return WaveletNeural(**{**settings, **changes})


def random_gbuffer(count: int, seed: int = 0) -> GBuffer:
    generator = torch.Generator().manual_seed(seed)

    def directions():
        return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)

    def unit(columns):
        return torch.rand(count, columns, generator=generator)

    return GBuffer(
        unit(3) * 2 - 1,
        directions(),
        directions(),
        directions(),
        unit(3),
        unit(3),
        unit(1),
        unit(2),
        torch.ones(count, dtype=torch.bool),
    )


@pytest.fixture
def built() -> WaveletNeural:
    torch.manual_seed(0)
    method = make()
    sigma = torch.rand(6 * RESOLUTION**2) + 0.1
    method.build(((-1, -1, -1), (1, 1, 1)), RESOLUTION, sigma, "cpu")
    with torch.no_grad():
        method.net.grid.table.normal_()
        for layer in method.net.mlp.layers:
            layer.bias.normal_()
    return method


def random_lighting(seed: int = 1) -> torch.Tensor:
    return torch.rand((6, RESOLUTION, RESOLUTION, 3), generator=torch.Generator().manual_seed(seed)) * 3


def test_folded_equals_readable(built):
    gbuffer, code = random_gbuffer(300), built.light(random_lighting())
    folded = built.shade(gbuffer, code)
    built.folded = False
    readable = built.shade(gbuffer, code)
    assert readable.abs().mean() > 0.01
    assert (folded - readable).norm() / readable.norm() < 1e-4
    assert ((folded - readable).abs() / readable.abs().clamp(min=readable.abs().mean())).max() < 1e-4


def test_bfloat16_error_is_small(built):
    gbuffer = random_gbuffer(300)
    exact = built.shade(gbuffer, built.light(random_lighting()))
    built.precision = "bfloat16"
    rough = built.shade(gbuffer, built.light(random_lighting()))
    assert 0 < (rough - exact).norm() / exact.norm() < 0.03


def test_radiance_is_linear_in_the_kept_wavelets(built):
    built.wavelets = 6 * RESOLUTION**2
    gbuffer, a, b = random_gbuffer(50), random_lighting(1), random_lighting(2)
    both = built.shade(gbuffer, built.light(a + b))
    apart = built.shade(gbuffer, built.light(a)) + built.shade(gbuffer, built.light(b))
    assert torch.allclose(both, apart, rtol=1e-3, atol=1e-3 * float(both.abs().mean()))


def test_truncated_lighting_has_k_wavelets(built):
    kept = haar.forward(built.truncated(random_lighting())).reshape(-1, 3)
    assert (kept.abs().sum(dim=1) > 1e-4).sum() == built.wavelets


def test_training_coefficients_equal_the_readable_ones(built):
    gbuffer, k = random_gbuffer(40), torch.tensor([0, 5, 100, 383])
    pixel = built.net.inputs(gbuffer)
    fast = built.net.coefficients(pixel, k)
    slow = built.net.coefficients_readable(pixel, k)
    assert torch.allclose(fast, slow, rtol=1e-4, atol=1e-4)


def test_the_finest_cells_get_the_width_asked_for():
    grid = dict(levels=4, features=2, log2_table=10, base_resolution=4)
    growth = level_growth(grid, ([0.0, 0.0, 0.0], [8.0, 4.0, 1.0]), 0.25)
    assert grid["base_resolution"] * growth**3 == pytest.approx(8.0 / 0.25)
    assert level_growth(grid, ([0.0] * 3, [1.0] * 3), 10.0) == 1.0
    assert level_growth({**grid, "levels": 1}, ([0.0] * 3, [1.0] * 3), 0.1) > 1


@pytest.mark.parametrize("width", [0, "two"])
def test_a_width_of_nothing_is_refused(width):
    with pytest.raises(PrtError, match=f"finest_pixels={width}"):
        make(grid=dict(levels=2, features=2, log2_table=8, base_resolution=4, scale=1.5, finest_pixels=width))


def test_a_model_remembers_the_growth_of_its_grid(built, tmp_path):
    built.grid_settings["scale"] = 1.25
    built.build(built.bounds, RESOLUTION, built.sigma, "cpu")
    built.save(tmp_path / "model.safetensors")
    again = make()
    again.load(tmp_path / "model.safetensors", None, "cpu")
    gbuffer = random_gbuffer(20)
    assert torch.equal(
        again.shade(gbuffer, again.light(random_lighting())),
        built.shade(gbuffer, built.light(random_lighting())),
    )


def test_a_model_stored_without_the_growth_has_the_configured_one(built, tmp_path):
    built.save(tmp_path / "model.safetensors")
    with safe_open(tmp_path / "model.safetensors", "pt") as file:
        stored = {name: value for name, value in file.metadata().items() if name != "scale"}
    save_file(load_file(tmp_path / "model.safetensors"), tmp_path / "old.safetensors", metadata=stored)
    again = make()
    again.load(tmp_path / "old.safetensors", None, "cpu")
    assert torch.equal(again.net.grid.per_unit, built.net.grid.per_unit)


def test_empty_view_gives_no_radiance(built):
    assert built.shade(random_gbuffer(0), built.light(random_lighting())).shape == (0, 3)


@pytest.mark.parametrize("scale", [0.0, 1e6])
def test_black_and_bright_lights_stay_finite(built, scale):
    out = built.shade(random_gbuffer(20), built.light(random_lighting() * scale))
    assert torch.isfinite(out).all()
    assert scale > 0 or out.abs().max() == 0


def test_saved_model_renders_the_same(built, tmp_path):
    class Scene:
        bounds = ((-1, -1, -1), (1, 1, 1))

    class Task:
        scene = Scene()

    built.save(tmp_path / "model.safetensors")
    other = make()
    other.load(tmp_path / "model.safetensors", Task(), "cpu")
    gbuffer = random_gbuffer(30)
    assert torch.equal(
        built.shade(gbuffer, built.light(random_lighting())),
        other.shade(gbuffer, other.light(random_lighting())),
    )


@pytest.mark.parametrize(
    "change, word",
    [
        (dict(selection="largest"), "selection"),
        (dict(precision="float16"), "precision"),
        (dict(wavelets=0), "wavelets"),
        (dict(training=dict(draw="all")), "draw"),
        (dict(training=dict(target="none")), "target"),
        (dict(training=dict(gain_points=-1)), "gain_points=-1"),
    ],
)
def test_bad_settings_are_named(change, word):
    with pytest.raises(PrtError, match=word):
        make(**change)


def test_another_resolution_is_refused(built):
    with pytest.raises(PrtError, match="task.resolution=8"):
        built.light(torch.ones(6, 4, 4, 3))

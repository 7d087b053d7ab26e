import numpy as np
import pytest
import torch
from trace_scenes import CORNER_VIEW, glossy_corner, lightings

from prt.errors import PrtError
from prt.trace.benchmark_record import benchmark, deviations, ratio_of_means


class Lights:
    """An environment set of three training lightings and two tests."""

    resolution = 2

    def train(self):
        return list("abc"), torch.stack(list(lightings(2).values()))

    def test(self):
        return ["d", "e"], self.train()[1][:2]


SMALL = {"size": 8, "spp": 4, "lights": 2, "repetitions": 3, "variance_spp": 4, "variance_seeds": 3}


def test_every_measure_of_every_mode_and_map():
    rows = benchmark(glossy_corner(), Lights(), view=CORNER_VIEW, **SMALL)
    found = {(row["variant"], row["component"], row["metric"]) for row in rows}
    for mode in ("bsdf", "nee"):
        assert {(f"mode={mode}", "full", f"ratio/{name}") for name in ("paths", "cost")} <= found
        for name in ("indoor", "outdoor"):
            for part in ("full", "indirect"):
                assert (f"mode={mode},map={name}", part, "ratio/variance") in found
    for row in rows:
        assert set(row) == {
            "method", "device", "variant", "component", "metric", "value", "lo", "hi", "n"
        }  # fmt: skip
        assert 0 < row["lo"] <= row["hi"] < float("inf") and row["n"] >= 3


def test_variance_ratio_finds_a_known_one():
    random = np.random.default_rng(0)
    a, b = (deviations(random.normal(0, scale, (24, 16, 16, 3))) for scale in (2.0, 1.0))
    assert a.mean() == pytest.approx(4.0, rel=0.05)
    row = ratio_of_means(a, b)
    assert row["lo"] < 4.0 < row["hi"] and row["hi"] - row["lo"] < 0.6


def test_too_few_repetitions():
    with pytest.raises(PrtError, match="variance_seeds=1"):
        benchmark(glossy_corner(), Lights(), **{**SMALL, "variance_seeds": 1})


def test_too_few_test_lightings():
    with pytest.raises(PrtError, match="has 2 test environments; raise lighting.test_count"):
        benchmark(glossy_corner(), Lights(), maps=["a", "b", "c"], view=CORNER_VIEW, **SMALL)

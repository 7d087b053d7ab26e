"""What a user, a full disk, a kill or a bad file may do to the real thing; nothing here is a fake.

Task, scene, lighting and methods are the project's own, driven through ``prt run`` wherever that is the
question. Damaged caches are in tests/tasks/test_relight_indirect.py and tests/test_cache.py.
"""

import contextlib
import math
import multiprocessing
import os
import random
import signal
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tiny
import torch
from safetensors.torch import load_file

from prt import cli
from prt.bench.compose import compose
from prt.bench.evaluate import evaluate_item
from prt.bench.exr import read_exr, write_exr
from prt.bench.run import build, folder_of
from prt.bench.run_folder import RunFolder, find_runs
from prt.metrics.registry import METRICS, evaluate
from prt.scene.capture import capture
from prt.scene.view import View
from prt.trace.record import record

METHODS = ("wavelet_neural", "neural_prt", "path_traced")
#: overrides that make a method small; 30 steps are enough to leave the initial weights
SMALL = {
    "wavelet_neural": ["method=wavelet_neural", "method.wavelets=24", "method.training.steps=30"],
    "neural_prt": ["method=neural_prt", "method.training.steps=30"],
    "path_traced": ["method=path_traced", "method.frame_seconds=null", "method.samples=2"],
}
#: looks away from every scene
NOTHING = View((0.0, 1.0, 20.0), (0.0, 1.0, 40.0), width=16, height=16)


@pytest.fixture(scope="module")
def fitted(tiny_task, maps):
    """Every method, fitted to the real task."""
    found = {}
    for name in METHODS:
        method = build(compose([*tiny.TASK, *tiny.lights(maps), *SMALL[name]]), "method")
        log = tiny.Log() if name != "path_traced" else _Silent()
        method.fit(tiny_task, log, 0, "cpu")
        found[name] = method
    return found


class _Silent(tiny.Log):
    def step(self, step, **values):
        pass


@pytest.fixture
def prt(monkeypatch, tmp_path, capsys):
    """``prt ...`` in this process: exit status, what it printed, what it complained about."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PRT_CONF_DIRS", raising=False)
    before = signal.getsignal(signal.SIGTERM), warnings.showwarning

    def call(*arguments):
        status = cli.main([str(a) for a in arguments])
        done = capsys.readouterr()
        return status, done.out, done.err

    yield call
    signal.signal(signal.SIGTERM, before[0])
    warnings.showwarning = before[1]


def one_line(err: str) -> str:
    """The one line of an error (progress and warnings stand before it)."""
    lines = [line for line in err.splitlines() if "error" in line]
    assert len(lines) == 1 and lines[0].startswith("prt: error: ") and "Traceback" not in err, err
    assert err.splitlines()[-1] == lines[0]
    return lines[0]


# ---- lightings


def black():
    return torch.zeros((6, tiny.RESOLUTION, tiny.RESOLUTION, 3))


def one_texel():
    cubemap = black()
    cubemap[2, 3, 4] = 200.0
    return cubemap


LIGHTINGS = {
    "black": black(),
    "one texel": one_texel(),
    "1e6 everywhere": 1e6 * tiny.random_cubemap(1),
    "1e6 in one texel": torch.full_like(black(), 0.1) + 5e3 * one_texel(),
    "one colour": tiny.random_cubemap(2) * torch.tensor([1.0, 0.0, 0.0]),
    "almost black": 1e-12 * tiny.random_cubemap(3),
}


@pytest.mark.parametrize("lighting", LIGHTINGS)
@pytest.mark.parametrize("method", METHODS)
def test_extreme_lightings_give_finite_radiance(fitted, tiny_task, method, lighting):
    cubemap, gbuffer = LIGHTINGS[lighting], tiny_task.tests()[0].gbuffer
    out = fitted[method].shade(gbuffer, fitted[method].light(cubemap))
    assert out.shape == (len(gbuffer), 3) and out.isfinite().all()
    assert (float(out.abs().max()) > 0) == (lighting != "black")
    if method == "path_traced":
        assert (out >= 0).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_lighting_a_million_times_brighter_gives_as_much_more_light(fitted, tiny_task, method):
    gbuffer, cubemap = tiny_task.tests()[0].gbuffer, tiny.random_cubemap(5)
    dim, bright = (fitted[method].shade(gbuffer, fitted[method].light(s * cubemap)) for s in (1.0, 1e6))
    assert torch.allclose(bright, 1e6 * dim, rtol=1e-3, atol=1e3 * float(dim.abs().max()))


@pytest.mark.parametrize("lighting", ["black", "one texel", "1e6 everywhere"])
def test_extreme_lightings_are_judged_like_any_other(fitted, tiny_task, maps, own_cache, tmp_path, lighting):
    """Reference, composing, denoising, every metric, the error split, images and metrics.csv."""
    view = tiny_task.tests()[0].gbuffer.view
    item = tiny_task.test_item("far", "far00", view, lighting, LIGHTINGS[lighting])
    assert all(image.isfinite().all() and (image >= 0).all() for image in item.references.values())
    cfg = compose(
        [*tiny.TASK, *tiny.lights(maps), "run.denoise=true", "run.metrics=[psnr,ssim,flip,mape,mae,rmse]"]
    )
    for name in ("wavelet_neural", "neural_prt"):
        rows = evaluate_item(folder := RunFolder(tmp_path / name), cfg, tiny_task, fitted[name], item)
        folder.write_metrics(rows)
        frame = folder.metrics()
        assert frame.value.notna().all() and len(frame) == len(rows) > 20
        assert (frame[frame.metric == "bad_pixels"].value == 0).all()
        assert np.isfinite(frame.value).all(), frame[~np.isfinite(frame.value)]
        if lighting == "black":
            mine = frame[(frame.component == "indirect") & (frame.metric == "mae")]
            assert (mine.value == 0).all() and item.references["full"].max() == 0


BAD = {"nan": (math.nan, "1 NaN"), "infinite": (math.inf, "1 infinite"), "negative": (-0.5, "1 negative")}


def spoilt(folder: Path, *values: float) -> Path:
    image = torch.rand((8, 16, 3), generator=torch.Generator().manual_seed(0))
    for row, value in enumerate(values):
        image[row, 7, 1] = value
    write_exr(folder / "spoilt.exr", image)
    return folder / "spoilt.exr"


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_environment_is_one_line_that_names_the_cure(prt, own_cache, tiny_task, maps, tmp_path, kind):
    path = spoilt(tmp_path, BAD[kind][0])
    status, _, err = prt("run", *tiny.TASK, *tiny.lights(maps, path), *SMALL["path_traced"])
    message = one_line(err)
    assert (
        status == 2 and "'spoilt'" in message and BAD[kind][1] in message and "lighting.mend=true" in message
    )


def test_a_mended_environment_runs(prt, own_cache, tiny_task, maps, tmp_path):
    path = spoilt(tmp_path, *(value for value, _ in BAD.values()))
    lights = [*tiny.lights(maps, path), "lighting.mend=true"]
    status, _, err = prt("run", *tiny.TASK, *lights, *SMALL["path_traced"], "task.near_views=0")
    assert status == 0 and "1 NaN, 1 infinite, 1 negative of 128 texels; mended" in err, err
    (run,) = find_runs(tmp_path / "runs")
    assert np.isfinite(run.metrics().value).all()


@pytest.mark.parametrize("image", ["one pixel", "black", "1e6"])
def test_odd_environment_files_run_to_the_end(prt, own_cache, tiny_task, maps, tmp_path, image):
    pixels = {"one pixel": torch.ones((1, 1, 3)), "black": torch.zeros((8, 16, 3)),
              "1e6": 1e6 * torch.rand((8, 16, 3))}[image]  # fmt: skip
    write_exr(tmp_path / "odd.exr", pixels)
    settings = [*tiny.TASK, *tiny.lights(maps, tmp_path / "odd.exr"), "lighting.normalise=false"]
    status, out, err = prt("run", *settings, *SMALL["wavelet_neural"], "task.near_views=0")
    assert status == 0, err
    (run,) = find_runs(tmp_path / "runs")
    frame = run.metrics()
    assert run.done and np.isfinite(frame.value).all(), frame[~np.isfinite(frame.value)]
    shown = read_exr(run.image_file("far", "far00", "odd", "indirect"))
    assert shown.isfinite().all() and (float(shown.abs().max()) > 0) == (image != "black")


# ---- views and meshes


def test_a_view_that_sees_nothing(fitted, tiny_task, maps, own_cache, tmp_path):
    gbuffer = capture(tiny_task.mitsuba_scene, NOTHING)
    assert (
        len(gbuffer) == 0
        and gbuffer.hit.numel() == 256
        and gbuffer.image(gbuffer.position).shape == (16, 16, 3)
    )
    for prior in (None, tiny.random_cubemap()):
        transport = record(tiny_task.mitsuba_scene, NOTHING, 4, 3, tiny.RESOLUTION, 0, prior=prior)
        light = tiny.random_cubemap().reshape(1, -1, 3)
        for part in ("direct", "indirect", "full"):
            assert transport.component(part).relight(light).shape == (1, 256, 3)
            assert transport.component(part).relight(light).max() == 0
        assert transport.component("background").relight(light).max() > 0
    item = tiny_task.test_item("far", "nothing", NOTHING, "bright", tiny.random_cubemap())
    assert all(image.shape == (16, 16, 3) and image.max() == 0 for image in item.references.values())
    cfg = compose(
        [*tiny.TASK, *tiny.lights(maps), "run.denoise=true", "run.metrics=[psnr,ssim,flip,mape,mae,rmse]"]
    )
    for name, method in fitted.items():
        assert method.shade(item.gbuffer, method.light(item.lighting)).shape == (0, 3)
        rows = evaluate_item(folder := RunFolder(tmp_path / name), cfg, tiny_task, method, item)
        folder.write_metrics(rows)
        frame = folder.metrics()
        assert np.isfinite(frame.value).all(), frame[~np.isfinite(frame.value)]
        assert (frame[frame.metric == "mae"].value == 0).all()


def test_every_metric_of_two_empty_images():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no LPIPS weights
        values = evaluate(torch.zeros((64, 64, 3)), torch.zeros((64, 64, 3)))
    assert set(values) == {*METRICS, "bad_pixels"}
    assert all(math.isfinite(v) for name, v in values.items() if name != "lpips")


OBJ = """v -1 0 1\nv 1 0 1\nv 1 0 -1\nv -1 0 -1\nv -1 1.5 -1\nv 1 1.5 -1\nv 1 0 -1
f 1 2 3\nf 1 3 4\nf 4 3 6\nf 4 6 5\nf 2 2 3\nf 3 7 6\n"""
XML = """<scene version="3.0.0"><shape type="obj"><string name="filename" value="mesh.obj"/>
<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape></scene>"""


def test_a_mesh_without_normals_and_with_degenerate_triangles(prt, own_cache, tiny_task, maps, tmp_path):
    """A floor and a wall in one OBJ file: no normals, no texture coordinates, two triangles without area."""
    (tmp_path / "mesh.obj").write_text(OBJ)
    (tmp_path / "scene.xml").write_text(XML)
    settings = [*tiny.TASK, *tiny.lights(maps), *SMALL["wavelet_neural"], "task.near_views=0"]
    settings[0] = "scene=mitsuba"
    status, _, err = prt("run", *settings, "scene.path=scene.xml")
    assert status == 0, err
    (run,) = find_runs(tmp_path / "runs")
    assert np.isfinite(run.metrics().value).all() and "psnr" in set(run.metrics().metric)
    scene = build(compose([*settings, f"scene.path={tmp_path}/scene.xml"]), "scene")
    gbuffer = capture(scene.load(), scene.views("far", 1, 32)[0])
    assert len(gbuffer) > 100
    assert all(getattr(gbuffer, name).isfinite().all() for name in gbuffer.FIELDS)
    assert torch.allclose(gbuffer.normal.norm(dim=1), torch.ones(len(gbuffer)), atol=1e-4)
    assert ((gbuffer.normal * gbuffer.wo).sum(1) > -1e-4).all()


# ---- mistakes at the command line


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["run", "method.wavelet=32"], "did you mean method.wavelets"),
        (["run", "task.reference_sp=32"], "did you mean task.reference_spp"),
        (["run", "lightning=hdri"], "did you mean lighting"),
        (["run", "scene=cornel_glossy"], "did you mean cornell_glossy"),
        (["run", "-m", "method.training.step=1,2"], "did you mean method.training.steps"),
        (
            ["run", "+method.wavelet=3"],
            "method.wavelet is not a setting of WaveletNeural; did you mean wavelets",
        ),
        (["run", "method.grid.level=3"], "did you mean method.grid.levels"),
        (["run", "+run.fodler=x"], "nothing reads this setting"),
        (["table", "quickstrat"], "did you mean quickstart"),
        (["table", "quickstart", "method.wavelet=32", "--dry-run"], "method.wavelet"),
    ],
)
def test_a_misspelt_key_is_one_line_with_a_suggestion(prt, tmp_path, words, says):
    status, _, err = prt(*words)
    assert status == 2 and says in one_line(err)
    assert not list(tmp_path.rglob("config.yaml"))


@pytest.mark.parametrize("words", [["run"], ["run", "-m"]])
def test_a_run_folder_that_cannot_be_written(prt, own_cache, maps, tmp_path, words):
    (tmp_path / "file").write_text("a file, not a folder")
    settings = [*tiny.TASK, *tiny.lights(maps), *SMALL["path_traced"], f"run.folder={tmp_path}/file/runs"]
    status, _, err = prt(*words, *settings)
    message = one_line(err)
    assert status == 2 and "cannot write" in message
    assert f"{tmp_path}/file/runs" in message and "run.folder=" in message
    assert (tmp_path / "file").read_text() == "a file, not a folder"


def test_a_cache_that_cannot_be_written(prt, monkeypatch, maps, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PRT_CACHE", str(tmp_path / "file" / "cache"))
    status, _, err = prt("run", *tiny.TASK, *tiny.lights(maps), *SMALL["wavelet_neural"])
    message = one_line(err)
    assert (
        status == 2 and "cannot" in message and str(tmp_path / "file") in message and "PRT_CACHE" in message
    )


def test_a_report_that_cannot_be_written(prt, tmp_path):
    (tmp_path / "file").write_text("")
    status, _, err = prt("table", "quickstart", f"report={tmp_path}/file/report", *tiny.TASK)
    assert status == 2 and "cannot write" in one_line(err)


# ---- two runs sharing one cache, and runs killed at any moment

STEPS = 160
SETTINGS = [
    *tiny.TASK,
    "task.train_views=6",
    "task.far_views=3",
    "task.near_views=2",
    "run.checkpoint_seconds=0.05",
]
FITTING = {
    "wavelet_neural": ["method=wavelet_neural", "method.wavelets=24", f"method.training.steps={STEPS}"],
    "neural_prt": ["method=neural_prt", f"method.training.steps={STEPS}"],
}
ITEMS = 5


def prt_run(overrides, cache, output):
    """The body of a process: ``prt run`` with its output in a file."""
    os.environ["PRT_CACHE"] = str(cache)
    with open(output, "a") as file, contextlib.redirect_stderr(file), contextlib.redirect_stdout(file):
        status = cli.main(["run", *overrides])
    sys.exit(status)


def start(overrides, cache, output):
    # a fork server that has imported torch already saves seconds for every process that is killed
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["prt.bench.run", "prt.bench.sweep", "OpenEXR", "torch._dynamo", __name__])
    process = context.Process(target=prt_run, args=(overrides, cache, output))
    process.start()
    return process


def choose(method, maps, folder) -> list[str]:
    return [*SETTINGS, *tiny.lights(maps), *FITTING[method], f"run.folder={folder}"]


@pytest.fixture(scope="module")
def whole(maps, tmp_path_factory):
    """Both methods at once in two processes on one cold cache: (their folders, the cache)."""
    base = tmp_path_factory.mktemp("whole")
    started = [start(choose(m, maps, base / m), base / "cache", base / f"{m}.txt") for m in FITTING]
    for process, method in zip(started, FITTING, strict=True):
        process.join(240)
        assert process.exitcode == 0, (base / f"{method}.txt").read_text()
    return {m: folder_of(compose(choose(m, maps, base / m))) for m in FITTING}, base / "cache"


def files(cache: Path) -> dict[str, bytes]:
    return {str(path.relative_to(cache)): path.read_bytes() for path in cache.rglob("*") if path.is_file()}


def test_two_runs_share_one_cache(whole, maps):
    runs, cache = whole
    assert all(run.done for run in runs.values())
    found = files(cache)
    assert found and all(name.endswith(".safetensors") for name in found)
    # 6 training views, and two records of each test view (wavelet_neural's error split); 5 references
    kinds = [name.partition("/")[0] for name in found]
    assert (kinds.count("transport"), kinds.count("reference")) == (6 + 2 * ITEMS, ITEMS)
    # both were judged against the same references
    floors = [run.metrics().query("metric == 'noise_floor'") for run in runs.values()]
    pd.testing.assert_frame_equal(*(frame.reset_index(drop=True) for frame in floors))


def progress(run: RunFolder, cache: Path) -> int:
    """Files in the cache, steps fitted, items judged: grows through the whole life of a run."""
    steps = len(run.log_file.read_text().splitlines()) - 1 if run.log_file.exists() else 0
    return len(list(cache.rglob("*.safetensors"))) + steps + len({row[:3] for row in run.metric_rows()})


@pytest.mark.parametrize("method", FITTING)
def test_a_run_killed_at_any_moment_resumes_to_the_same_numbers(method, whole, maps, tmp_path):
    truth, cache, output = whole[0][method], tmp_path / "cache", tmp_path / "output.txt"
    overrides = choose(method, maps, tmp_path / "runs")
    run, rng = folder_of(compose(overrides)), random.Random(method)
    # while recording, three times while fitting, and among the test items
    baked = 8
    points = [rng.randrange(1, baked), *sorted(rng.sample(range(baked, baked + STEPS), 3)), baked + STEPS + 7]
    kills = 0
    for point in points:
        process = start(overrides, cache, output)
        end = time.monotonic() + 60
        while process.is_alive() and progress(run, cache) < point and time.monotonic() < end:
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.03))
        kills += process.is_alive()
        os.kill(process.pid, signal.SIGKILL) if process.is_alive() else None
        process.join()
    assert kills >= 3, "the runs ended before they could be killed: the test tests nothing"
    process = start(overrides, cache, output)
    process.join(120)
    assert process.exitcode == 0 and run.done, output.read_text()

    assert run.path.name == truth.path.name
    assert (run.path / "metrics.csv").read_bytes() == (truth.path / "metrics.csv").read_bytes()
    # not byte by byte: safetensors writes the two entries of its header's metadata in either order
    mine, other = load_file(run.checkpoint), load_file(truth.checkpoint)
    assert mine.keys() == other.keys() and all(torch.equal(mine[name], other[name]) for name in mine)
    pd.testing.assert_frame_equal(run.log().drop(columns="seconds"), truth.log().drop(columns="seconds"))
    assert len(run.log()) == STEPS
    for path in sorted((truth.path / "images").rglob("*.exr")):
        assert torch.equal(read_exr(path), read_exr(run.path / path.relative_to(truth.path)))
    assert not (run.path / "state").exists() and not (run.path / "lock").exists()
    assert len(run.provenance()["sessions"]) >= kills
    # what the killed processes had cached is whole, and the same as elsewhere
    mine, other = files(cache), files(whole[1])
    assert {name for name in mine if name.endswith(".safetensors")} <= set(other)
    assert all(mine[name] == other[name] for name in mine if name.endswith(".safetensors"))

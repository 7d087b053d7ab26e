"""Finished runs played again: pictures, films, and the viewer, without and within a real browser."""

import dataclasses
import subprocess
import sys
import time

import numpy as np
import pytest
import tiny
import torch
from PIL import Image

from prt.bench import export, viewer
from prt.bench.compose import compose
from prt.bench.exr import read_exr
from prt.bench.playback import Playback, difference, to_bytes
from prt.bench.run import build_task, run
from prt.cli import main
from prt.errors import PrtError
from prt.tasks.free_views import free_view

LIGHTS = ["task=local_lights", "scene=cornell_box", "lighting=spots_inside", "budget=smoke", "task.texels=16",
          "task.train_count=3", "task.spp=4", "task.reference_spp=8", "task.frame_spp=4"]  # fmt: skip
DIRECT = ["task=relight_direct", "scene=four_shapes", "budget=smoke", "task.train_points=300",
          "task.directions=16", "task.texels=32", "task.truth_samples=32"]  # fmt: skip
STATES = ["task=animate", "budget=smoke", "task.size=16", "task.states=2", "task.spp=4"]


@pytest.fixture(scope="module")
def runs(maps, warm_cache, tmp_path_factory):
    """Two small runs of the real scene, of a wavelet network and of path tracing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PRT_CACHE", str(warm_cache))
        words = [*tiny.TASK, *tiny.lights(maps), f"run.folder={tmp_path_factory.mktemp('runs')}"]
        network = ["method=wavelet_neural", "method.training.steps=5", "method.wavelets=16"]
        traced = ["method=path_traced", "method.frame_seconds=null", "method.samples=1"]
        yield [run(compose([*words, *more])).path for more in (network, traced)]


def test_a_picture_is_the_one_that_was_judged(runs):
    play = Playback(runs[0], "indirect")
    item = play.task.tests()[0]
    frame = play.frame(item.gbuffer.view, item.lighting)
    stored = read_exr(play.folder.image_file(item.split, item.view_name, item.lighting_name, "indirect"))
    torch.testing.assert_close(frame.image, torch.as_tensor(stored), rtol=1e-4, atol=1e-6)
    assert frame.seconds > 0
    whole = Playback(runs[0])
    assert whole.component == "full"
    assert float(whole.frame(item.gbuffer.view, item.lighting).image.mean()) > float(frame.image.mean())


@pytest.mark.parametrize("words", [LIGHTS, DIRECT, STATES], ids=["local_lights", "relight_direct", "animate"])
def test_other_tasks_are_free_to_look_at_too(words, maps, warm_cache, monkeypatch):
    monkeypatch.setenv("PRT_CACHE", str(warm_cache))
    words = [*words, *(tiny.lights(maps) if words is DIRECT else [])]
    task = build_task(compose(words))
    free = free_view(task)
    lighting = next(iter(free.lightings.values()))
    view = task.scene.views("far", 1, 16)[0]
    gbuffer = free.look(view, lighting)
    assert len(gbuffer) > 0 and gbuffer.view == view
    traced = free.trace(view, lighting, 4, 1)
    assert set(task.components) & set(traced)
    image = next(iter(traced.values()))
    assert image.shape == (16, 16, 3) and image.isfinite().all() and float(image.max()) > 0
    moved = free.moving(lighting, 0.25)
    other = free.trace(view, moved, 4, 1)
    assert not torch.equal(next(iter(other.values())), image), "something moves"
    assert len(free.variables) == (task.dimension if words[0] == "task=animate" else 0)


def test_a_sequence_begins_and_ends_with_the_light_it_is_given(tiny_task):
    free = free_view(tiny_task)
    lighting = next(iter(free.lightings.values()))
    assert torch.equal(free.moving(lighting, 0.0), lighting)
    half = free.moving(lighting, 0.5)
    torch.testing.assert_close(free.moving(half, 0.5), lighting, rtol=1e-3, atol=1e-3)
    assert float((half - lighting).abs().max()) > 0.1
    state = free_view(build_task(compose(STATES))).moving
    v = torch.tensor([0.4, 0.6])
    torch.testing.assert_close(state(v, 0.0), v)
    steps = torch.stack([state(v, k / 200) for k in range(201)])
    assert float(steps.diff(dim=0).abs().max()) < 0.02 and float(steps.min()) >= 0 and float(steps.max()) <= 1


def test_a_film(runs, tmp_path, capsys):
    out = tmp_path / "film"
    words = f"export {runs[0]} --frames 3 --size 16 --output {out} --component indirect".split()
    assert main([*words, "--formats", "png,exr,mp4"]) == 0
    assert sorted(p.name for p in out.iterdir()) == [
        "indirect.mp4", *(f"indirect_{k:04d}.{end}" for k in range(3) for end in ("exr", "png")),
    ]  # fmt: skip
    play = Playback(runs[0], "indirect")
    moved = play.free.moving(play.lighting(), 1 / 3)
    torch.testing.assert_close(
        torch.as_tensor(read_exr(out / "indirect_0001.exr")), play.frame(play.view(16), moved).image
    )
    first, second = (np.asarray(Image.open(out / f"indirect_{k:04d}.png"), float) for k in (0, 1))
    assert first.shape == (16, 16, 3) and np.abs(first - second).max() > 0
    seen = film(out / "indirect.mp4")
    grey = [picture.astype(float).mean(axis=2).ravel() for picture in (seen[0], first)]
    assert len(seen) == 3 and np.corrcoef(grey)[0, 1] > 0.95
    assert main([*words, "--kind", "turntable", "--formats", "png"]) == 0
    turned = np.asarray(Image.open(out / "indirect_0001.png"), float)
    assert np.abs(turned - second).max() > 0


def film(path) -> list[np.ndarray]:
    reader = export.encoder().read_frames(str(path), pix_fmt="rgb24")
    width, height = next(reader)["size"]
    return [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--kind", "zoom"], "--kind 'zoom' is not one of turntable, relight"),
        (["--formats", "gif"], "--formats gif: choose from png, exr, mp4"),
        (["--frames", "0"], "--frames 0 must be at least 1"),
        (["--component", "direct"], "component=direct: this run shows indirect or full"),
        (["--lighting", "moon"], "no lighting 'moon'; choose from "),
    ],
)
def test_mistakes_of_an_export(runs, words, said, capsys):
    assert main(["export", str(runs[0]), *words]) == 2
    assert said in capsys.readouterr().err


def test_what_cannot_be_played(runs, tmp_path, capsys):
    assert main(["export", str(tmp_path)]) == 2
    assert "is no run folder" in capsys.readouterr().err
    half = tmp_path / "half"
    half.mkdir()
    (half / "config.yaml").write_text((runs[0] / "config.yaml").read_text())
    assert main(["view", str(half)]) == 2
    assert "stopped, not done" in capsys.readouterr().err
    assert main(["view", *map(str, [*runs, runs[0]])]) == 2
    assert "shows one or two" in capsys.readouterr().err


def test_bad_pixels_are_seen():
    image = torch.full((2, 2, 3), 0.5)
    image[0, 0, 1] = float("nan")
    assert to_bytes(image, 1.0)[0, 0].tolist() == [255, 0, 255]
    same = difference(torch.ones(2, 2, 3), torch.ones(2, 2, 3), 1.0)
    assert same.max() < 10 and difference(image, torch.ones(2, 2, 3), 1.0)[0, 0].max() > 200


@pytest.fixture(scope="module")
def gallery(runs):
    return viewer.Gallery([Playback(path, "indirect") for path in runs])


def wanted(gallery, **changes) -> viewer.Wanted:
    start = gallery.plays[0].view(16)
    light = next(iter(gallery.free.lightings))
    first = viewer.Wanted(start.origin, start.target, start.up, 0.8, 1.5, "method", light, 0.0, (), 0.0, 40)
    return dataclasses.replace(first, **changes)


def test_small_while_it_moves_and_whole_when_it_stands(gallery):
    look = wanted(gallery)
    picture, said = gallery.update("a", look, 0.0)
    assert picture.shape == (16, 48, 3) and "24 x 16 pixels, moving" in said, "two runs beside each other"
    assert gallery.update("a", look, 0.1) is None, "nothing new until it has stood for a while"
    picture, said = gallery.update("a", look, 0.5)
    assert picture.shape == (40, 120, 3) and "still" in said
    assert "wavelet_neural:" in said and "path_traced:" in said and "ms a frame" in said
    assert gallery.update("a", look, 9.0) is None
    again, _ = gallery.update("a", dataclasses.replace(look, share=0.3), 9.1)
    assert again.shape == (16, 48, 3)


def test_a_reference_is_traced_on_while_nothing_moves(gallery):
    look = wanted(gallery, show="side by side")
    gallery.update("b", look, 0.0)
    pictures = [gallery.update("b", look, 1.0 + k)[0] for k in range(3)]
    assert gallery.shown["b"].spp == 3 * viewer.SPP and pictures[0].shape == (40, 4 * 15, 3)
    play = gallery.plays[0]
    view = gallery._view(look, 1.0)
    truth = sum(play.reference(view, play.lighting(), viewer.SPP, 1 + viewer.SPP * k) for k in range(3)) / 3
    torch.testing.assert_close(gallery.shown["b"].traced, truth)
    only = gallery.update("c", wanted(gallery, show="reference"), 0.0)[0]
    wrong = gallery.update("d", wanted(gallery, show="difference"), 0.0)[0]
    assert only.shape == wrong.shape == (16, 24, 3) and not np.array_equal(only, wrong)


def test_runs_of_different_scenes_are_not_set_side_by_side(gallery):
    other = type("Other", (), {})()
    other.task, other.name = gallery.plays[0].task, "neural_prt on kitchen"
    other.cfg = compose([*tiny.TASK, "scene=four_shapes"])
    with pytest.raises(PrtError, match="cannot stand side by side"):
        viewer.Gallery([gallery.plays[0], other])


def test_the_viewer_in_a_browser(runs, browser):
    """As a user would: open it, wait for the picture, choose another one, turn the light, close it."""
    pytest.importorskip("viser", reason="the package viser is missing (pip install 'prt[view]')")
    words = [sys.executable, "-m", "prt.cli", "view", str(runs[0]), "--port", "0", "--size", "48"]
    server = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    try:
        said = []
        for line in server.stderr:
            said.append(line)
            if line.startswith("open http"):
                break
        assert said and said[-1].startswith("open http"), said
        address = said[-1].split()[1]
        page = browser.new_context(viewport={"width": 900, "height": 600}).new_page()
        page.set_default_timeout(60_000)
        page.goto(address)
        page.get_by_text("wavelet_neural on cornell_glossy").wait_for()
        page.get_by_text("pixels, still").wait_for()
        page.get_by_text("ms a frame").wait_for()
        plain = page.screenshot()
        page.get_by_role("combobox", name="Show", exact=True).click()
        page.get_by_role("option", name="side by side").click()
        page.get_by_text("paths a pixel").wait_for()
        deadline = time.monotonic() + 60
        while page.screenshot() == plain and time.monotonic() < deadline:
            time.sleep(0.2)
        assert page.screenshot() != plain
        before = page.locator("text=paths a pixel").inner_text()
        page.get_by_role("slider").first.focus()  # turns the light
        for _ in range(20):
            page.keyboard.press("ArrowRight")
        page.wait_for_function("before => !document.body.innerText.includes(before)", arg=before)
        page.close()
    finally:
        server.terminate()
        server.wait(30)
    rest = server.stderr.read()
    assert server.returncode == 0 and "closed" in rest, rest

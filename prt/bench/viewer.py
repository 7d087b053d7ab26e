"""``prt view``: finished runs in the browser, with the camera, the light and the scene's variables in hand.

Pictures are small while something moves, whole when all stands still; then the reference is traced on, more
and more paths a pixel. All rendering is done in one thread, the one that calls :meth:`Viewer.serve`.
"""

import dataclasses
import math
import signal
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.bench.playback import Playback, difference, to_bytes
from prt.bench.run import say
from prt.errors import PrtError
from prt.metrics.tonemap import exposure_of
from prt.scene.view import View

SHOWS = ("method", "reference", "difference", "side by side")
#: seconds without a change after which the picture is rendered whole
STILL = 0.3
#: share of the full size while something moves
MOVING = 0.4
#: paths a pixel that are added to a reference at a time, and at most
SPP, MOST_SPP = 8, 512
#: height of a still picture in pixels, least and most
SIZES = (32, 1024)


@dataclasses.dataclass(frozen=True)
class Wanted:
    """All that a picture depends on: two equal ones have one picture.

    Attributes:
        origin, target, up: of the camera, world units.
        fov: vertical, radians.
        aspect: of the browser's window, width over height.
        show: one of :data:`SHOWS`.
        lighting: name of a test lighting.
        share: of the way of a moving light.
        state: values of the scene's variables, empty where there are none.
        stops: exposure beside the automatic one.
        size: pixels of the full picture's height.
    """

    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float]
    fov: float
    aspect: float
    show: str
    lighting: str
    share: float
    state: tuple[float, ...]
    stops: float
    size: int


@dataclasses.dataclass
class Shown:
    """What a browser has been sent."""

    wanted: Wanted
    since: float
    whole: bool = False
    spp: int = 0
    traced: Float[Tensor, "H W 3"] | None = None
    pictures: list[Float[Tensor, "H W 3"]] = dataclasses.field(default_factory=list)
    seconds: list[float] = dataclasses.field(default_factory=list)


class Gallery:
    """Pictures of one or two runs of the same scene, without any browser.

    Raises:
        PrtError: for runs of different tasks or scenes.
    """

    def __init__(self, plays: Sequence[Playback]):
        first = plays[0]
        for other in plays[1:]:
            if (other.task.name, other.cfg.choice.scene) != (first.task.name, first.cfg.choice.scene):
                raise PrtError(
                    f"{first.name} and {other.name} cannot stand side by side: choose one scene and task"
                )
        self.plays = list(plays)
        self.shown: dict[Any, Shown] = {}

    @property
    def free(self):
        return self.plays[0].free

    def update(self, who: Any, wanted: Wanted, now: float) -> tuple[np.ndarray, str] | None:
        """The next picture for a browser and what is said of it; None where it has the best there is."""
        shown = self.shown.get(who)
        if shown is None or shown.wanted != wanted:
            self.shown[who] = shown = Shown(wanted, now)
            self._render(shown, MOVING)
        elif not shown.whole and now - shown.since >= STILL:
            shown.whole, shown.spp, shown.traced = True, 0, None
            self._render(shown, 1.0)
        elif shown.whole and wanted.show != "method" and shown.spp < MOST_SPP:
            self._trace(shown)
        else:
            return None
        return self._compose(shown), self._say(shown)

    def _lighting(self, wanted: Wanted) -> Any:
        if self.free.variables:
            return torch.tensor(wanted.state, dtype=torch.float32)
        light = self.free.lightings[wanted.lighting]
        return self.free.moving(light, wanted.share) if wanted.share else light

    def _view(self, wanted: Wanted, scale: float) -> View:
        panes = (len(self.plays) + 2) if wanted.show == "side by side" else 1
        height = max(round(wanted.size * scale), 8)
        width = max(round(height * wanted.aspect / panes), 8)
        fov = 2 * math.atan(math.tan(wanted.fov / 2) * width / height)
        return View(wanted.origin, wanted.target, wanted.up, math.degrees(fov), width, height)

    def _render(self, shown: Shown, scale: float) -> None:
        view, lighting = self._view(shown.wanted, scale), self._lighting(shown.wanted)
        shown.pictures, shown.seconds = [], []
        if shown.wanted.show != "reference":
            for play in self.plays:
                frame = play.frame(view, lighting, direct_spp=4 if scale < 1 else 32)
                shown.pictures.append(frame.image)
                shown.seconds.append(frame.seconds)
        if shown.wanted.show != "method":
            self._trace(shown, scale)

    def _trace(self, shown: Shown, scale: float = 1.0) -> None:
        """Some more paths of the reference, averaged with those before."""
        view, lighting = self._view(shown.wanted, scale), self._lighting(shown.wanted)
        more = self.plays[0].reference(view, lighting, SPP, seed=1 + shown.spp)
        before = shown.traced if shown.traced is not None else torch.zeros_like(more)
        shown.traced = (before * shown.spp + more * SPP) / (shown.spp + SPP)
        shown.spp += SPP

    def _compose(self, shown: Shown) -> np.ndarray:
        """The panes from left to right: runs, reference, difference of the first run."""
        traced, pictures = shown.traced, shown.pictures
        bright = (pictures[0] if pictures else traced).numpy()  # pyright: ignore
        exposure = exposure_of(np.where(np.isfinite(bright), bright, 0.0)) * 2.0**shown.wanted.stops
        panes = [to_bytes(image, exposure) for image in pictures]
        if shown.wanted.show == "method":
            return panes[0] if len(panes) == 1 else np.concatenate(panes, axis=1)
        assert traced is not None
        if shown.wanted.show == "reference":
            return to_bytes(traced, exposure)
        wrong = difference(pictures[0], traced, exposure)
        if shown.wanted.show == "difference":
            return wrong
        return np.concatenate([*panes, to_bytes(traced, exposure), wrong], axis=1)

    def _say(self, shown: Shown) -> str:
        view = self._view(shown.wanted, 1.0 if shown.whole else MOVING)
        lines = [f"{view.width} x {view.height} pixels, {'still' if shown.whole else 'moving'}"]
        for play, seconds in zip(self.plays, shown.seconds, strict=False):
            lines.append(f"{play.cfg.choice.method}: {1e3 * seconds:.3g} ms a frame")
        if shown.traced is not None:
            lines.append(f"reference: {shown.spp} paths a pixel")
        return "\n\n".join(lines)


class Viewer:
    """The browser's side: camera and controls, on a local port.

    Args:
        port: 0 for any that is free.

    Raises:
        PrtError: where viser is not installed.
    """

    def __init__(self, gallery: Gallery, port: int = 8080, size: int = 384, host: str = "127.0.0.1"):
        try:
            import viser
        except ImportError as error:
            raise PrtError("`prt view` needs the package viser: pip install 'prt[view]'") from error
        self.gallery, self.server = gallery, viser.ViserServer(host, port, label="prt", verbose=False)
        self.start = gallery.plays[0].view(size)
        self.server.scene.set_up_direction(self.start.up)
        self.server.on_client_connect(self._welcome)
        self._controls(size)

    @property
    def address(self) -> str:
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def _controls(self, size: int) -> None:
        gui, gallery = self.server.gui, self.gallery
        names = " and ".join(dict.fromkeys(play.name for play in gallery.plays))
        gui.add_markdown(f"**{names}**, {gallery.plays[0].component} light")
        self.status = gui.add_markdown("no picture yet")
        self.show = gui.add_dropdown("Show", SHOWS, initial_value="method")
        self.variables = [
            gui.add_slider(name, 0.0, 1.0, 0.01, initial_value=0.5) for name in gallery.free.variables
        ]
        self.lighting = self.share = None
        if not self.variables:
            lights = tuple(gallery.free.lightings)
            self.lighting = gui.add_dropdown("Light", lights, initial_value=lights[0])
            self.share = gui.add_slider("Turn or move it", 0.0, 1.0, 0.005, initial_value=0.0)
        self.stops = gui.add_slider("Exposure (stops)", -4.0, 4.0, 0.1, initial_value=0.0)
        self.size = gui.add_slider("Pixels, height", *SIZES, 16, initial_value=size)

    def _welcome(self, client: Any) -> None:
        """Put a new browser's camera where the first test camera stands."""
        start = self.start
        vertical = 2 * math.atan(start.half_width * start.height / start.width)
        client.camera.up_direction = start.up
        client.camera.position, client.camera.look_at, client.camera.fov = (
            start.origin,
            start.target,
            vertical,
        )

    def wanted(self, camera: Any) -> Wanted:
        """What a browser's camera and the controls ask for."""

        def three(values: Any) -> tuple[float, float, float]:
            x, y, z = (round(float(v), 5) for v in values)
            return x, y, z

        return Wanted(
            origin=three(camera.position),
            target=three(camera.look_at),
            up=three(camera.up_direction),
            fov=round(float(camera.fov), 5),
            aspect=round(float(camera.aspect), 3),
            show=self.show.value,
            lighting=self.lighting.value if self.lighting else "",
            share=float(self.share.value) if self.share else 0.0,
            state=tuple(float(slider.value) for slider in self.variables),
            stops=float(self.stops.value),
            size=int(self.size.value),
        )

    def step(self) -> bool:
        """Render what is wanted next; returns whether there was anything to do."""
        busy = False
        clients = self.server.get_clients()
        for number in [who for who in self.gallery.shown if who not in clients]:
            del self.gallery.shown[number]
        for number, client in clients.items():
            if client.camera.update_timestamp == 0:
                continue  # it has said nothing of itself yet
            found = self.gallery.update(number, self.wanted(client.camera), time.monotonic())
            if found is not None:
                client.scene.set_background_image(found[0], format="jpeg", jpeg_quality=92)
                self.status.content = found[1]
                busy = True
        return busy

    def serve(self) -> None:
        """Until a signal asks to end; a picture that is being rendered is finished first."""
        asked = threading.Event()
        # an exception in the midst of the renderer's work would come out as an error of its own
        for kind in (signal.SIGINT, signal.SIGTERM):
            signal.signal(kind, lambda *_: asked.set())
        try:
            while not asked.is_set():
                if not self.step():
                    time.sleep(0.02)
        finally:
            self.server.stop()


def main(runs: Sequence[Path], port: int, size: int, host: str, component: str | None) -> int:
    """Open the runs and serve them until the user stops it.

    Raises:
        PrtError: for runs that cannot be played, or not beside each other.
    """
    if len(runs) > 2:
        raise PrtError(f"{len(runs)} runs: `prt view` shows one or two beside each other")
    if not SIZES[0] <= size <= SIZES[1]:
        raise PrtError(f"--size {size} must be from {SIZES[0]} to {SIZES[1]} pixels")
    viewer = Viewer(Gallery([Playback(run, component) for run in runs]), port, size, host)
    say(f"open {viewer.address} in a browser; Ctrl+C ends it")
    viewer.serve()
    say("closed")
    return 0

"""`tomotactile view`: what a sensor feels, or has felt, as a page in the browser."""

from __future__ import annotations

import bisect
import math
import threading
import time
from argparse import ArgumentParser, Namespace
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from tomotactile_ros.commands.device_options import source_of
from tomotactile_ros.commands.reconstruct import law_of_recording, stamps_of_recording
from tomotactile_ros.commands.run import add_chain_arguments, open_chain, shots
from tomotactile_ros.commands.tare import apply_tare
from tomotactile_ros.devices.health import late_of
from tomotactile_ros.devices.recording import load_recording
from tomotactile_ros.devices.stream import FrameStream
from tomotactile_ros.frames_file import FramesFile
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.view.display import Shot
from tomotactile_ros.view.page import LOCALHOST, PORT, Page
from tomotactile_ros.view.page_sheet import Sheet
from tomotactile_ros.view.timeline import late_frames, strip

HELP = "show a sensor, or a recording with a slider, as a page in the browser"
_MARKED = 0.5  # s between two drawings of the strip below the slider
_TICK = 0.04  # s between two looks at a recording that plays


def add_arguments(parser: ArgumentParser) -> None:
    add_chain_arguments(parser)
    add_page_arguments(parser)


def add_page_arguments(parser: ArgumentParser) -> None:
    """Add where the page is served."""
    parser.add_argument(
        "--host",
        default=LOCALHOST,
        help=f"address to listen at (default: {LOCALHOST}, this machine only; 0.0.0.0: everybody "
        "who reaches it)",
    )
    parser.add_argument(
        "--web-port", type=int, default=PORT, help=f"or the next free one (default: {PORT})"
    )


def open_page(args: Namespace, title: str, calibrated: bool = True) -> Page:
    """The page that the options ask for; it is said where it is."""
    page = Page(title, args.host, args.web_port, calibrated)
    print(f"tomotactile {title}: {page.url}", flush=True)
    return page


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    if args.recording:
        _show_recording(args, layout)
        return
    device, scene, pipeline = open_chain(args, layout)
    title = f"{layout.name}, {source_of(args)}"
    calibrated = pipeline.settings.contact_law is not None
    with open_page(args, title, calibrated) as page, suppress(KeyboardInterrupt):
        sheet = page.add_layout(layout, pipeline.grid)
        with FrameStream(device) as stream:
            for shot in shots(stream, pipeline, args.duration):
                truth = None if scene is None or scene.live else scene.truth(shot.scene_time)
                sheet.show(shot, truth=truth)


def _show_recording(args: Namespace, layout: Layout) -> None:
    recorded = load_recording(args.recording, layout, stored=True)
    law, of_law = law_of_recording(args.calibration, recorded)
    stamps, told = stamps_of_recording(recorded)
    pipeline = Pipeline(layout, Settings(args.profile, contact_law=law))
    apply_tare(args.tare, pipeline)
    name = Path(args.recording).name
    with open_page(args, f"{layout.name}, {name}", law is not None) as page:
        page.say("  \n".join(filter(None, [f"**{name}**", of_law, told])))
        with suppress(KeyboardInterrupt):
            player = Player(page, page.add_layout(layout, pipeline.grid))
            player.play(replace(recorded, stamps=stamps), pipeline, args.duration)


class Player:
    """Reconstructs a recording frame by frame in the background, and shows what the slider says."""

    def __init__(self, page: Page, sheet: Sheet):
        self._sheet = sheet
        self._shots: list[Shot] = []
        self._shown = -1
        self._turn = threading.Lock()
        gui = page.server.gui
        with gui.add_folder("recording", order=0.5):
            self._state = gui.add_markdown("")
            self._slider = gui.add_slider("time, s", 0.0, 0.1, 0.001, 0.0)
            self._strip = gui.add_html("")
            self._plays = gui.add_checkbox("play", True)
            self._speed = gui.add_dropdown("speed", ("1", "0.1", "0.25", "0.5", "2", "5"))
        self._slider.on_update(self._on_slider)

    def play(self, recorded: FramesFile, pipeline: Pipeline, duration: float | None) -> None:
        """Show the recording, again and again, for `duration` s or until Ctrl-C."""
        stopped = threading.Event()
        worker = threading.Thread(target=self._work, args=(recorded, pipeline, stopped))
        worker.start()
        start = before = time.monotonic()
        try:
            while duration is None or time.monotonic() - start < duration:
                time.sleep(_TICK)
                now = time.monotonic()
                if self._plays.value and self._shots:
                    self._advance((now - before) * float(self._speed.value), worker.is_alive())
                before = now
        finally:
            stopped.set()
            worker.join()

    def _work(self, recorded: FramesFile, pipeline: Pipeline, stopped: threading.Event) -> None:
        begin, drawn = math.nan, -math.inf
        withheld: list[bool] = []
        assert recorded.stamps is not None  # where the file has none, they count from 0
        late = late_frames(recorded.stamps)
        for number, frame in enumerate(recorded, 1):
            if stopped.is_set():
                return
            begin = frame.stamp if number == 1 else begin
            result = pipeline.process(frame)
            withheld.append(bool(result.reason))
            at = frame.stamp + result.holds - begin
            image = np.asarray(result.image, np.float32)
            behind = late_of(int(late[:number].sum()), number, "frames")
            shot = Shot(
                image,
                result.contacts,
                at,
                0.0,
                0.0,
                result.reason,
                0.0,
                behind,
                result.faults,
                alternative=result.alternative,
            )
            self._shots.append(shot)
            self._slider.max = max(at, 0.1)
            if time.monotonic() - drawn > _MARKED or number == len(recorded):
                drawn = time.monotonic()
                times = np.array([shot.scene_time for shot in self._shots])
                self._strip.content = strip(
                    times, self._slider.max, np.array(withheld), late[:number]
                )
            self._state.content = (
                f"{number} of {len(recorded)} frames, {sum(withheld)} of them withheld, "
                f"{late[:number].sum()} late"
            )

    def _advance(self, seconds: float, more_to_come: bool) -> None:
        """Go on by some seconds; from the end to the begin, once the end is known."""
        at = float(self._slider.value) + seconds
        if at > self._shots[-1].scene_time:
            if more_to_come:
                return
            at = 0.0
        self._slider.value = round(at, 3)
        self._show(at)

    def _on_slider(self, event) -> None:
        if event.client_id is not None:  # somebody moved it
            self._plays.value = False
            self._show(float(self._slider.value))
            self._sheet.show_again()  # what is read and drawn less often, too

    def _show(self, at: float) -> None:
        with self._turn:
            shots = self._shots[:]
            if not shots:
                return
            k = max(bisect.bisect_right(shots, at, key=lambda shot: shot.scene_time) - 1, 0)
            if k != self._shown:
                self._sheet.show_last(shots[: k + 1])
                self._shown = k

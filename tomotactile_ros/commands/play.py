"""`tomotactile play`: a simulated sheet that the pointer presses, in the browser: truth and estimate
beside each other, and what is wrong with a sensor to switch on."""

from __future__ import annotations

import math
import threading
from argparse import ArgumentParser, Namespace
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from tomotactile_ros.commands.run import shots
from tomotactile_ros.commands.view import add_page_arguments, open_page
from tomotactile_ros.devices import DeviceSettings, make_device
from tomotactile_ros.devices.fake import FakeDevice
from tomotactile_ros.devices.stream import FrameStream
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.settings import PROFILES
from tomotactile_ros.scenes.channels import Channels, Rms
from tomotactile_ros.scenes.defects import Defects, Noise
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.scenes.sheet_field import SheetField, Tear
from tomotactile_ros.scenes.touches import Touch
from tomotactile_ros.support.command_line import positive
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import installed
from tomotactile_ros.view.page import Page
from tomotactile_ros.view.page_sheet import Sheet

HELP = "press a simulated sheet with the pointer, in the browser"
ABOUT = (
    "**Press the sheet**: drag to slide a finger, click to leave one there, click it to lift it. "
    "Green rings are the fingers, orange is what the readings say of them."
)
_STRONGEST, _LARGEST = 10.0, 15.0  # N, mm
_NEAR = 0.005  # m from the pointer to a finger that it takes up
_AGAIN = 0.02  # s


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--layout", default="equal-8x8", help="to begin with (default: equal-8x8), name or file"
    )
    parser.add_argument(
        "--profile", default=Settings.profile, choices=PROFILES, help=f"default: {Settings.profile}"
    )
    parser.add_argument("--duration", type=positive, help="s (default: until Ctrl-C)")
    add_page_arguments(parser)


def run(args: Namespace) -> None:
    load_layout(args.layout)  # says what is wrong with it before there is a page
    with open_page(args, "play") as page, suppress(KeyboardInterrupt):
        page.say(ABOUT)
        over = threading.Event()
        if args.duration is not None:
            timer = threading.Timer(args.duration, over.set)
            timer.daemon = True
            timer.start()
        Game(page, args.layout, args.profile).play(over)


class Game:
    """The sheet that is pressed, and what can be chosen of it."""

    def __init__(self, page: Page, layout: str, profile: str):
        self._page, self._changed, self._lock = page, threading.Event(), threading.Lock()
        self._resting: list[Touch] = []
        self._finger: Touch | None = None  # while the pointer drags
        self._held: Touch | None = None  # a resting one that the pointer has taken along
        gui = page.server.gui
        with gui.add_folder("finger", order=0.3):
            self._force = gui.add_slider("force, N", 0.1, _STRONGEST, 0.1, 2.0)
            self._radius = gui.add_slider("radius, mm", 2.0, _LARGEST, 0.5, 5.0)
            for slider in (self._force, self._radius):
                slider.on_update(lambda event: self._adjust())
            gui.add_button("lift all").on_click(lambda event: self._lift())
        with gui.add_folder("sensor", order=0.4):
            names = list(dict.fromkeys([layout, *installed("layouts")]))
            self._name = gui.add_dropdown("layout", names, initial_value=layout)
            self._profile = gui.add_dropdown("profile", PROFILES, initial_value=profile)
            self._gains = gui.add_checkbox("gains 2 % off", False)
            self._tear = gui.add_checkbox("a tear", False)
            self._open = gui.add_checkbox("an open wire", False)
            self._noise = gui.add_checkbox("ten times the noise", False)
            self._said = gui.add_markdown("")
        chosen = self._name, self._profile, self._gains, self._tear, self._open, self._noise
        for each in chosen:
            each.on_update(lambda event: self._changed.set())

    def play(self, over: threading.Event) -> None:
        """Run the sensor until it is over, a new one after each change."""
        while not over.is_set():
            self._changed.clear()
            self._said.content = ""
            try:
                self._play_on(over)
            except InputError as error:  # a layout on which nothing can be reconstructed, say
                self._said.content = f"**{error}**"
                while not over.wait(_AGAIN) and not self._changed.is_set():
                    pass

    def _play_on(self, over: threading.Event) -> None:
        layout = load_layout(self._name.value)
        scene = self._scene(layout)
        pipeline = Pipeline(layout, Settings(self._profile.value, contact_law=scene.contact_law))
        device = make_device(DeviceSettings(layout, scene=scene))
        assert isinstance(device, FakeDevice)
        for name in list(self._page.sheets):
            self._page.remove_sheet(name)
        sheet = self._page.add_layout(layout, pipeline.grid)
        self._take_pointer(sheet)
        lifted = threading.Event()
        pressing = threading.Thread(target=self._press, args=(device, lifted))
        pressing.start()
        try:
            with FrameStream(device) as stream:
                for shot in shots(stream, pipeline, None):
                    sheet.show(shot, truth=device.truth(shot.scene_time))
                    if self._changed.is_set() or over.is_set():
                        return
        finally:
            lifted.set()
            pressing.join()
            pipeline.stop()

    def _press(self, device: FakeDevice, lifted: threading.Event) -> None:
        """Say again and again what presses: it would be taken away otherwise."""
        while not lifted.wait(_AGAIN):
            device.press(self.touches())

    def touches(self) -> list[Touch]:
        """All fingers."""
        with self._lock:
            return [*self._resting, *filter(None, [self._finger])]

    def _take_pointer(self, sheet: Sheet) -> None:
        """Let clicks and drags on the sheet be fingers."""

        async def drag(event: Any) -> None:
            eye = np.array(event.client.camera.position)
            place = sheet.pick(eye, np.array(event.end_position) - eye)
            with self._lock:
                if event.phase == "start":
                    self._held = None if place is None else self._taken(place)
                finger = self._held or self._new(0.0, 0.0)
                moved = None if place is None else replace(finger, x=place[0], y=place[1])
                if event.phase == "end" and self._held is not None and moved is not None:
                    self._resting.append(moved)
                self._finger = None if event.phase == "end" else moved

        async def click(event: Any) -> None:
            place = sheet.pick(np.array(event.ray_origin), np.array(event.ray_direction))
            with self._lock:
                if place is not None and self._taken(place) is None:
                    self._resting.append(self._new(*place))

        sheet.tiles.on_drag("left")(drag)
        sheet.tiles.on_click(click)

    def _new(self, x: float, y: float) -> Touch:
        return Touch(x, y, float(self._force.value), 1e-3 * float(self._radius.value))

    def _taken(self, place: tuple[float, float]) -> Touch | None:
        """The finger that rested at a place, taken up; None where there is none."""
        for touch in self._resting:
            if math.dist((touch.x, touch.y), place) <= max(touch.radius, _NEAR):
                self._resting.remove(touch)
                return touch
        return None

    def _adjust(self) -> None:
        """The sliders are those of the finger that was left last."""
        with self._lock:
            if self._resting:
                last = self._resting.pop()
                self._resting.append(self._new(last.x, last.y))

    def _lift(self) -> None:
        with self._lock:
            self._resting.clear()

    def _scene(self, layout: Layout) -> Scene:
        """What is chosen to be wrong with the sensor."""
        scene = load_scene("live")
        width, height = layout.outline.size
        cut = ((0.5 * width, 0.15 * height), (0.35 * width, 0.15 * height))  # from the rim
        channels = Channels(
            gain=Rms(0.02) if self._gains.value else None,
            open=(layout.electrodes // 3,) if self._open.value else (),
        )
        torn = SheetField(tears=(Tear(cut, 0.001),) if self._tear.value else ())
        noise = scene.noise or Noise(0.001)
        return replace(
            scene,
            noise=replace(noise, rms=10 * noise.rms) if self._noise.value else noise,
            defects=Defects(channels=channels, sheet=torn),
        )

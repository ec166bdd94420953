"""Shows pressure images and contacts while they come: a picture on a terminal, lines elsewhere."""

import os
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TextIO

import numpy as np

from tomotactile_ros.layout import Layout
from tomotactile_ros.scene import Scene
from tomotactile_ros.view.colours import full_scale
from tomotactile_ros.view.contacts import contact_lines
from tomotactile_ros.view.figure import save_pressure
from tomotactile_ros.view.terminal import HALF_BLOCK, picture

_LEAST_SCALE = 1000.0  # Pa
_PERIOD = {True: 0.1, False: 0.5}  # s between two pictures, and between two plain reports


@dataclass
class Shot:
    """One image.

    Attributes
    ----------
    pressure : (H, W) Pa.
    contacts : strongest first.
    scene_time : s since the scene began.
    rate : images/s of late.
    age : s from the frame's stamp to now.
    """

    pressure: np.ndarray
    contacts: Sequence
    scene_time: float
    rate: float
    age: float


class Display:
    """Shows shots of one sensor.

    Parameters
    ----------
    layout, scene : what is measured, and what is really there.
    """

    def __init__(self, layout: Layout, scene: Scene):
        self._layout, self._scene = layout, scene
        self._out = sys.stdout
        self._pictures = _shows_pictures(self._out)
        self._drawn = 0  # lines of the picture on the terminal
        self._next = -np.inf
        self.last: Shot | None = None

    def say(self, text: str) -> None:
        """Print a line."""
        print(text, file=self._out, flush=True)

    def show(self, shot: Shot) -> None:
        """Show a shot, unless the last one was shown just now."""
        self.last = shot
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + _PERIOD[self._pictures]
        if self._pictures:
            self._draw(shot)
        else:
            self._report(shot)

    def save(self, path: str) -> None:
        """Write the last shot as a PNG."""
        last = self.last
        title = f"{self._scene.name} on {self._layout.name}, {last.scene_time:.2f} s"
        truth = self._truth(last.scene_time)
        save_pressure(path, last.pressure, self._layout, last.contacts, truth, title)
        self.say(f"{path} written")

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._drawn:
            self._out.write("\x1b[?25h")
            self._out.flush()
            self._drawn = 0

    def _report(self, shot: Shot) -> None:
        for line in self._lines(shot):
            self.say(f"{shot.scene_time:6.2f} s  {line}")

    def _lines(self, shot: Shot) -> list[str]:
        return contact_lines(shot.contacts, self._truth(shot.scene_time))

    def _truth(self, t: float) -> list[dict] | None:
        """What really touches, if the scene alone says it."""
        return None if self._scene.live else self._scene.truth(t)

    def _draw(self, shot: Shot) -> None:
        room = shutil.get_terminal_size()
        contacts = self._lines(shot)[: room.lines // 2]
        scale = full_scale(shot.pressure, 0.0, _LEAST_SCALE)
        image = picture(
            shot.pressure, self._layout.outline.bounds, scale, room.columns,
            room.lines - len(contacts) - 3,
        )  # fmt: skip
        head = (
            f"{self._layout.name}: {shot.rate:.1f} images/s, {1e3 * shot.age:.0f} ms old, "
            f"{shot.scene_time:.2f} s into scene {self._scene.name}"
        )
        text = [line[: room.columns - 1] for line in [head, *contacts]]
        self._replace([text[0], *image, *text[1:]])

    def _replace(self, lines: list[str]) -> None:
        """Write lines over those of the last picture."""
        back = f"\x1b[{self._drawn}F" if self._drawn else "\x1b[?25l"
        body = "".join(f"{line}\x1b[K\n" for line in lines)
        self._out.write(f"{back}{body}\x1b[J")
        self._out.flush()
        self._drawn = len(lines)


def _shows_pictures(out: TextIO) -> bool:
    """Whether this is a terminal with colours (see no-color.org) and half blocks."""
    if not out.isatty() or os.environ.get("TERM", "dumb") == "dumb" or os.environ.get("NO_COLOR"):
        return False
    try:
        HALF_BLOCK.encode(out.encoding)
    except UnicodeEncodeError:
        return False
    return True

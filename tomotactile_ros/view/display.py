"""Shows pressure images and contacts while they come: a picture on a terminal, lines elsewhere."""

import os
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import wrap
from typing import TextIO

import numpy as np

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction.settings import Settings
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.view.colours import LEAST_CONDUCTANCE, LEAST_PRESSURE, SteadyScale
from tomotactile_ros.view.contact_lines import (
    contact_lines,
    fault_lines,
    fitting,
    numbers_of,
    other_line,
    withheld_line,
)
from tomotactile_ros.view.figure import save_pressure
from tomotactile_ros.view.terminal import HALF_BLOCK, picture
from tomotactile_ros.view.trails import LASTING, Trails

_UNCALIBRATED = "no contact law: forces and pressures are not known"
_PERIOD = {True: 0.1, False: 5.0}  # s between two pictures, and between two lines of text
_WIDEST = 200  # characters of a line about a contact
_LEAST = 0.5  # s between two lines where contacts come to be known or are no longer


@dataclass
class Shot:
    """What is known at one time, and the newest image to show under it.

    Attributes
    ----------
    pressure : (H, W) Pa; without a contact law conductance, S/m², as `Result.image`; None where there is no
        image yet.
    contacts : strongest first.
    scene_time : s since the scene began, of the time for which the contacts hold.
    rate : images/s of late.
    age : s since the time of the contacts, at least 0.
    reason : why contacts are withheld, if they are.
    image_age : s from the image's frame to the time of the contacts, where these do not wait for images.
    late : how many frames or rows of late were told late or not at all, for people; empty: not known.
    faults : electrodes that are left out, and why.
    complete : whether all was tried; else one contact may stand for all.
    alternative : other contacts that are nearly as likely; None: there are none.
    """

    pressure: np.ndarray | None
    contacts: Sequence
    scene_time: float
    rate: float
    age: float
    reason: str = ""
    image_age: float = 0.0
    late: str = ""
    faults: Mapping[int, str] = field(default_factory=dict)
    complete: bool = True
    alternative: Sequence | None = None

    def __post_init__(self) -> None:
        self.age = max(self.age, 0.0)  # a recording says before its last row what it has


class Display:
    """Shows shots of one sensor.

    Parameters
    ----------
    layout, scene : what is measured, and what is really there; None where nobody knows.
    source : what the frames come from, for people; the scene by default.
    calibrated : whether a contact law gives forces; by default, whether the scene has one. Without
        it no forces are shown: they would be invented.
    """

    def __init__(
        self,
        layout: Layout,
        scene: Scene | None,
        source: str = "",
        calibrated: bool | None = None,
    ):
        self._layout, self._scene = layout, scene
        self._source = source or (f"scene {scene.name}" if scene is not None else "")
        if calibrated is None:
            calibrated = scene is None or scene.contact_law is not None
        self._calibrated = calibrated
        self._scale = SteadyScale(LEAST_PRESSURE if calibrated else LEAST_CONDUCTANCE)
        self._trails = Trails()
        self._out = sys.stdout
        self._pictures = _shows_pictures(self._out)
        self._drawn = 0  # lines of the picture on the terminal
        self._next = -np.inf
        self.last: Shot | None = None
        self._shown: Shot | None = None

    def say(self, text: str) -> None:
        """Print a line."""
        print(text, file=self._out, flush=True)

    def show(self, shot: Shot) -> None:
        """Show a shot, unless the last one was shown just now."""
        self.last = shot
        self._trails.add(shot.contacts, _places(shot.contacts), shot.scene_time)
        now = time.monotonic()
        before = self._shown
        news = before is None or bool(before.reason) != bool(shot.reason)  # known now, or no longer
        if now < self._next - (_PERIOD[False] - _LEAST if news and not self._pictures else 0.0):
            return
        self._next = now + _PERIOD[self._pictures]
        self._show(shot)

    def save(self, path: str) -> None:
        """Write the last shot as a PNG."""
        last = self.last
        assert last is not None, "nothing was shown that could be saved"
        title = f"{self._source} on {self._layout.name}, {last.scene_time:.2f} s"
        truth = self._truth(last.scene_time)
        save_pressure(
            path,
            self._image(last),
            self._layout,
            last.contacts,
            truth,
            title,
            self._calibrated,
            reason=last.reason,
            trails=[trail for _, trail in self._trails.items()],
            complete=last.complete,
        )
        self.say(f"{path} written")

    def close(self) -> None:
        """Show the last shot, whose picture is saved, and leave the terminal as it was."""
        if self.last is not None and self.last is not self._shown:
            self._show(self.last)
        if self._drawn:
            self._out.write("\x1b[?25h")
            self._out.flush()
            self._drawn = 0

    def _show(self, shot: Shot) -> None:
        self._shown = shot
        if self._pictures:
            self._draw(shot)
        else:
            self._report(shot)

    def _report(self, shot: Shot) -> None:
        late = [f"late {shot.late}"] if shot.late else []
        self.say(f"{shot.scene_time:6.2f} s  {'; '.join([*self._lines(shot), *late])}")

    def _image(self, shot: Shot) -> np.ndarray:
        """(H, W) the image to show: one from before all trails would show what is not there any more; without
        one, an empty sheet."""
        if shot.pressure is not None and shot.image_age <= LASTING:
            return shot.pressure
        grid = Grid.for_outline(self._layout.outline, Settings().resolution)
        return grid.fill(np.zeros(len(grid.pixels)))

    def _lines(self, shot: Shot, width: int | None = None) -> list[str]:
        """What is known of contacts and electrodes; `width`: characters that fit, None: any number."""
        fits, faults = width or _WIDEST, fault_lines(shot.faults)
        if shot.reason:
            withheld = withheld_line(shot.reason)
            lines = wrap(withheld, fits) if width else [withheld]
        else:
            truth = self._truth(shot.scene_time)
            lines = contact_lines(shot.contacts, truth, self._calibrated, fits, shot.complete)
            lines += [fitting([line], fits) for line in other_line(shot.alternative)]
        return [*lines, *(fitting([line], width) if width else line for line in faults)]

    def _truth(self, t: float) -> list[dict] | None:
        """What really touches, if the scene alone says it."""
        if self._scene is None or self._scene.live:
            return None
        return self._scene.truth(t)

    def _draw(self, shot: Shot) -> None:
        room = shutil.get_terminal_size()
        width = room.columns - 1
        contacts = self._lines(shot, width)[: room.lines // 2]
        if not self._calibrated:
            contacts.append(fitting([_UNCALIBRATED], width))
        pressure = self._image(shot)
        scale = self._scale(float(np.nanmax(pressure, initial=0.0)), time.monotonic())
        numbers = numbers_of(shot.contacts, shot.complete)
        image = picture(
            pressure,
            self._layout.outline.bounds,
            scale,
            room.columns,
            room.lines - len(contacts) - 3,
            self._layout.positions,
            self._calibrated,
            [trail for _, trail in self._trails.items()],
            [(p, str(n or "?")) for p, n in zip(_places(shot.contacts), numbers, strict=True)],
        )
        head = [
            f"{self._layout.name}: {1e3 * shot.age:.0f} ms old",
            f", {shot.rate:.1f} images/s",
            *([f" (the last {shot.image_age:.1f} s ago)"] if shot.image_age > LASTING else []),
            *([f", late {shot.late}"] if shot.late else []),
            f", {shot.scene_time:.2f} s",
            f", {self._source}",
        ]
        self._replace([fitting(head, width), *image, *contacts])

    def _replace(self, lines: list[str]) -> None:
        """Write lines over those of the last picture."""
        back = f"\x1b[{self._drawn}F" if self._drawn else "\x1b[?25l"
        body = "".join(f"{line}\x1b[K\n" for line in lines)
        self._out.write(f"{back}{body}\x1b[J")
        self._out.flush()
        self._drawn = len(lines)


def _places(contacts: Sequence) -> np.ndarray:
    """(N, 2) m."""
    return np.array([(c.x, c.y) for c in contacts], float).reshape(-1, 2)


def _shows_pictures(out: TextIO) -> bool:
    """Whether this is a terminal with colours (see no-color.org) and half blocks."""
    if not out.isatty() or os.environ.get("TERM", "dumb") == "dumb" or os.environ.get("NO_COLOR"):
        return False
    try:
        HALF_BLOCK.encode(out.encoding)
    except UnicodeEncodeError:
        return False
    return True

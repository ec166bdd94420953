"""One sheet of the page for the browser: what is drawn of it in space, and what is said beside it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.spatial import Pose, SpatialContacts, in_space
from tomotactile_ros.view.colours import (
    LEAST_CONDUCTANCE,
    LEAST_PRESSURE,
    SteadyScale,
    colour,
    named,
    palette,
)
from tomotactile_ros.view.contact_lines import (
    fault_lines,
    numbers_of,
    other_line,
    stand_for_all,
    withheld_line,
)
from tomotactile_ros.view.display import Shot
from tomotactile_ros.view.page_parts import (
    DISC,
    MOST_CURVES,
    TILE,
    bar,
    curves,
    discs,
    fan,
    frames_of,
    linear,
    rings,
    roots_of,
    strength_of,
    table_of,
)
from tomotactile_ros.view.trails import LASTING, METRES_PER_NEWTON, Trails

if TYPE_CHECKING:
    from tomotactile_ros.view.page import Page

MAGNIFIED = 10.0  # times the deviation: ellipses of 0.1 mm are not seen on a sheet of 200 mm
_CURVES = 20.0  # s of forces that are shown
_DRAWN_EVERY, _TOLD_EVERY, _CURVED_EVERY = 0.05, 0.2, 0.25  # s
_STEP = 0.015  # of the size of the sheet, that a label moves at least: each move is a message
_ORANGE, _TRUE, _DEAD, _WELL = (255, 128, 26), (40, 200, 90), (230, 40, 40), (200, 200, 200)
_HERE = Pose(np.zeros(3), Rotation.identity())


class Sheet:
    """One sheet of a page.

    Parameters
    ----------
    page, name : where it is, and what it is called.
    cells : (H, W, 3) m, centres of the image's cells on the surface.
    cell_size : width and height of a cell on the flat sheet, m.
    inside : (H, W) bool, cells that are on the sheet.
    electrodes, radius : (E, 3) m, and their radius, m.
    layout : of the sheet where it is known; without one contacts must be handed over in space.
    number : of the sheet among several, in whose order they are described.
    """

    def __init__(
        self,
        page: Page,
        name: str,
        cells: np.ndarray,
        cell_size: tuple[float, float],
        inside: np.ndarray,
        electrodes: np.ndarray,
        radius: float,
        layout: Layout | None = None,
        number: int = 0,
    ):
        self.name, self.layout, self.inside, self._page = name, layout, inside, page
        self._lock = threading.RLock()
        self._root = f"/{name.strip('/').replace('/', '_') or 'sheet'}"
        frames, self.cells = frames_of(cells)[inside], cells[inside]
        self._normals, self._cell = frames[:, :, 2], float(np.hypot(*cell_size))
        self._least = LEAST_PRESSURE if page.calibrated else LEAST_CONDUCTANCE
        self._scale, self._trails = SteadyScale(self._least), Trails()
        self._last: tuple | None = None
        self._drawn = self._told = self._curved = -np.inf
        self._forces: deque[tuple[float, dict[int, float]]] = deque(maxlen=2000)
        self._size = float(np.ptp(self.cells, axis=0).max())
        scene, gui = page.server.scene, page.server.gui
        self._frame = scene.add_frame(self._root, show_axes=False)
        self._pose = _HERE
        tile = TILE * [*cell_size, 1.0]
        self.tiles = self._instances("pressure", tile, frames, self.cells, palette()[0])
        nearest = frames[np.linalg.norm(self.cells[:, None] - electrodes, axis=2).argmin(axis=0)]
        above = electrodes + 0.002 * self._size * nearest[:, :, 2]
        self._electrodes = self._instances("electrodes", DISC * radius, nearest, above, _WELL)
        self._lines: dict[str, Any] = {}
        self._labels: list[Any] = []
        shown = "sensor" if name == "/" else name
        self._folder = gui.add_folder(shown, order=0.35 + 1e-4 * number)  # between others
        with self._folder:
            self._text = gui.add_html("")
            self._chosen = gui.add_text("curves of contacts", "", hint="ids, such as 3, 7")
            self._plot = gui.add_uplot(
                *curves([], (), page.calibrated), scales={"x": {"time": False}}, aspect=1.7
            )

    def _instances(self, name, corners, frames, places, rgb) -> Any:
        """The same flat shape (n, 3) at places (N, 3), m, turned by frames (N, 3, 3)."""
        return self._page.server.scene.add_batched_meshes_simple(
            f"{self._root}/{name}",
            corners,
            fan(corners),
            Rotation.from_matrix(frames).as_quat()[:, [3, 0, 1, 2]],
            places,
            batched_colors=np.tile(linear(rgb), (len(places), 1)),
            lod="off",
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def remove(self) -> None:
        """Take it off the page, for ever."""
        with self._lock:
            self._last = None
            self._frame.remove()
            self._folder.remove()

    def place(self, pose: Pose) -> bool:
        """Where it is on the robot; whether that was said for the first time."""
        first, self._pose = self._pose is _HERE, pose
        x, y, z, w = pose.rotation.as_quat()
        self._frame.position, self._frame.wxyz = pose.translation, (w, x, y, z)
        return first

    def places_in_world(self) -> np.ndarray:
        """(K, 3) m, its cells."""
        return self._pose.positions(self.cells)

    def pick(self, eye: np.ndarray, direction: np.ndarray) -> tuple[float, float] | None:
        """Where a ray (3,) from an eye (3,), m, meets the flat sheet, m; None where it does not."""
        assert self.layout is not None, "a sheet without a layout cannot be pressed"
        ray = direction / np.linalg.norm(direction)
        ahead = self.cells - eye
        depths = ahead @ ray
        aside = np.linalg.norm(ahead - depths[:, None] * ray, axis=1)
        near = aside < self._cell
        if not near.any():
            return None
        near &= depths < depths[near].min() + 2 * self._cell  # not the far side of what is bent
        first = np.argmin(np.where(near, aside, np.inf))
        normal = self._normals[first]
        place = eye + ahead[first] @ normal / (ray @ normal) * ray  # in the plane of that cell
        x, y = self.layout.surface.nearest(place[None], self.layout.outline.size)[0]
        return float(x), float(y)

    def show(
        self,
        shot: Shot,
        placed: SpatialContacts | None = None,
        truth: Sequence[dict] | None = None,
    ) -> None:
        """Show what is known at one time; costs nothing while nobody has the page open.

        Parameters
        ----------
        shot : see there.
        placed : its contacts in space; by default where the layout's surface has them.
        truth : what really touches, as `Scene.truth` says; None where it is not known.
        """
        with self._lock:
            if placed is None:
                assert self.layout is not None, "contacts on a sheet without a layout"
                placed = in_space(self.layout.surface, shot.contacts)
            self._last = shot, placed, truth
            self._remember(shot, placed)
            if self._page.is_watched and time.monotonic() > self._drawn + _DRAWN_EVERY:
                self._draw()

    def show_last(self, shots: Sequence[Shot]) -> None:
        """Show the last of these, with curves and trails as if the others had been shown before."""
        assert self.layout is not None, "contacts on a sheet without a layout"
        with self._lock:
            known, last = self._forces[-1][0] if self._forces else np.inf, shots[-1]
            if not known <= last.scene_time <= known + LASTING:
                self._forces.clear()
                self._trails = Trails()
                known = last.scene_time - _CURVES
            for shot in shots[:-1]:
                if known < shot.scene_time:
                    self._remember(shot, in_space(self.layout.surface, shot.contacts))
            self.show(last)

    def show_again(self) -> None:
        """Show all that is known, to somebody who has just come."""
        with self._lock:
            self._told = self._curved = -np.inf
            if self._last is not None:
                self._draw()

    def _remember(self, shot: Shot, placed: SpatialContacts) -> None:
        if self._forces and shot.scene_time < self._forces[-1][0]:
            self._forces.clear()
        strengths = {
            number: strength_of(c, self._page.calibrated)
            for number, c in zip(
                numbers_of(shot.contacts, shot.complete), shot.contacts, strict=True
            )
        }
        # 0 stands for all contacts
        strengths[0] = np.nan if shot.reason else sum(strengths.values())
        self._forces.append((shot.scene_time, strengths))
        self._trails.add(shot.contacts, placed.positions, shot.scene_time)

    def _draw(self) -> None:
        assert self._last is not None
        shot, placed, truth = self._last
        now = self._drawn = time.monotonic()
        with self._page.server.atomic():
            scale = self._draw_pressure(shot, now)
            self._draw_contacts(shot, placed)
            self._draw_truth(truth or ())
            colours = np.tile(_WELL, (len(self._electrodes.batched_positions), 1))
            colours[list(shot.faults)] = _DEAD
            _put(self._electrodes, batched_colors=linear(colours))
            if now - self._told > _TOLD_EVERY:
                self._told = now
                self._text.content = self._words(shot, truth, scale)
            if now - self._curved > _CURVED_EVERY:
                self._curved = now
                self._draw_curves()

    def _draw_pressure(self, shot: Shot, now: float) -> float:
        image = shot.pressure
        if shot.reason:
            values = np.full(len(self.cells), np.nan)  # grey: it is not known
        elif image is None or shot.image_age > LASTING:
            values = np.zeros(len(self.cells))
        else:
            values = image[self.inside]
        scale = self._scale(float(np.nanmax(values, initial=0.0)), now)
        _put(self.tiles, batched_colors=linear(colour(values, scale)))
        return scale

    def _draw_contacts(self, shot: Shot, placed: SpatialContacts) -> None:
        contacts = shot.contacts
        frames, s = placed.frames, self._size
        lengths = np.where(np.isfinite(placed.forces), METRES_PER_NEWTON * placed.forces, 0.05)
        above = placed.positions + 0.003 * s * frames[:, :, 2]
        tails = placed.positions + np.reshape(lengths, (-1, 1)) * frames[:, :, 2]
        arrows = np.stack([tails, placed.positions], axis=1)
        size = {"shaft_radius": 0.005 * s, "head_radius": 0.014 * s, "head_length": 0.03 * s}
        self._set("force", arrows, self._page.server.scene.add_arrows, linear(_ORANGE), **size)
        known = np.isfinite(placed.covariances).all(axis=(1, 2))
        if stand_for_all(contacts, shot.complete):
            known[:] = False  # magnified, its spread would be larger than the sheet
        roots = MAGNIFIED * roots_of(placed.covariances[known])
        trails = [np.stack([t[:-1], t[1:]], axis=1) for _, t in self._trails.items()]
        rims = rings(above, frames, discs([c.radius for c in contacts]))
        spreads = rings(above[known], frames[known], roots)
        self._draw_lines("rims", np.concatenate([rims, spreads, *trails]), _ORANGE)
        # a label stays with its contact, also where another one becomes the strongest
        numbers = numbers_of(contacts, shot.complete)
        order = np.argsort(numbers, kind="stable")
        while len(self._labels) < len(numbers):
            name = f"{self._root}/id/{len(self._labels)}"
            self._labels.append(self._page.server.scene.add_label(name, "", visible=False))
        for k, label in enumerate(self._labels):
            _put(label, visible=k < len(numbers))
            if label.visible:
                tip = tails[order[k]]
                _put(label, text=f"{numbers[order[k]] or '?'}")
                if np.abs(label.position - tip).max() > _STEP * s:
                    label.position = tip

    def _draw_truth(self, truth: Sequence[dict]) -> None:
        """What really touches, as circles on the surface of the layout."""
        if self.layout is not None:
            points = np.array([(t["x"], t["y"]) for t in truth], float).reshape(-1, 2)
            frames = self.layout.surface.frames(points)
            above = self.layout.surface.to_3d(points) + 0.004 * self._size * frames[:, :, 2]
            circles = rings(above, frames, discs([t["radius"] for t in truth]))
            self._draw_lines("truth", circles, _TRUE)

    def _draw_lines(self, name: str, points: np.ndarray, rgb: tuple) -> None:
        add = self._page.server.scene.add_line_segments
        self._set(name, points, add, rgb, thickness=3.0, thickness_units="screen")

    def _set(self, name: str, points: np.ndarray, add: Any, rgb: Any, **how: Any) -> None:
        """Draw these (N, 2, 3), m, in place of what had the name."""
        points = points.astype(np.float32)
        drawn = self._lines.get(name)
        if drawn is None and len(points):
            self._lines[name] = add(f"{self._root}/{name}", points, rgb, **how)
        elif drawn is not None:
            if len(points):
                _put(drawn, points=points)
            _put(drawn, visible=bool(len(points)))

    def _words(self, shot: Shot, truth: Sequence[dict] | None, scale: float) -> str:
        """What there is to read, as HTML: state, scale of the colours, contacts, electrodes."""
        head = f"{shot.scene_time:.2f} s, {1e3 * shot.age:.0f} ms old, {shot.rate:.1f} images/s"
        parts = [f"<div>{head}</div>"]
        if shot.late:
            parts.append(f"<div>late: {escape(shot.late)}</div>")
        parts.append(bar(named(scale, self._page.calibrated)))
        if shot.reason:
            parts.append(f"<div><b>{escape(withheld_line(shot.reason))}</b></div>")
        else:
            parts.append(table_of(shot.contacts, truth, self._page.calibrated, shot.complete))
            parts += [f"<div>{line}</div>" for line in other_line(shot.alternative)]
        parts += [f"<div>{escape(line)}</div>" for line in fault_lines(shot.faults)]
        return f'<div style="padding:0 1em">{"".join(parts)}</div>'

    def _draw_curves(self) -> None:
        words = self._chosen.value.replace(",", " ").split()
        chosen = tuple(int(word) for word in words if word.isdigit())[:MOST_CURVES]
        since = self._forces[-1][0] - _CURVES if self._forces else 0.0
        recent = [each for each in self._forces if each[0] >= since]
        data, series = curves(recent, chosen, self._page.calibrated)
        self._plot.data = data
        if len(self._plot.series) != len(series) or self._plot.series[-1] != series[-1]:
            self._plot.series = series


def _put(drawn: Any, **values: Any) -> None:
    """Change what is not yet so: each change is a message to all browsers."""
    for name, value in values.items():
        if not np.array_equal(getattr(drawn, name), value):
            setattr(drawn, name, value)

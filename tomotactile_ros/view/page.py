"""Sheets in 3-D as a page for the browser: pressure, contacts, electrodes, curves of forces.

The page is made with viser, which is installed apart (`pip install "viser>=1.1"`): a pure Python
server whose page holds all that a browser needs, so that it works without the internet. It listens
on this machine only, unless another address is asked for.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from html import escape
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.spatial import Pose, SpatialContacts, in_space
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.view.colours import (
    LEAST_CONDUCTANCE,
    LEAST_PRESSURE,
    SteadyScale,
    colour,
    full_scale,
    named,
    palette,
)
from tomotactile_ros.view.contact_lines import number_of, pair, withheld_line
from tomotactile_ros.view.display import Shot
from tomotactile_ros.view.trails import LASTING, Trails

MISSING = (
    'the page in the browser needs viser, which is not installed here: pip install "viser>=1.1"'
)
LOCALHOST, PORT = "127.0.0.1", 8080
MAGNIFIED = 10.0  # times the deviation: ellipses of 0.1 mm are not seen on a sheet of 200 mm
METRES_PER_NEWTON = 0.01  # length of an arrow
_CURVES = 20.0  # s of forces that are shown
_TOLD_EVERY, _CURVED_EVERY = 0.2, 0.25  # s
_SIDES = 32  # of an ellipse
_ORANGE, _TRUE, _DEAD, _WELL = (255, 128, 26), (40, 200, 90), (230, 40, 40), (200, 200, 200)
_CURVE_COLOURS = ("#888888", "#ff801a", "#3d7dca", "#28c85a", "#b04fc4", "#c0a020")
_TILE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2.0
_HERE = Pose(np.zeros(3), Rotation.identity())
_HALVES = np.array([[0, 1, 2], [0, 2, 3]])
_ANGLES = np.linspace(0.0, 2 * np.pi, _SIDES + 1)
_DISC = np.stack([np.cos(_ANGLES), np.sin(_ANGLES), 0 * _ANGLES], axis=1)[:-1]
_TABLE = "width:100%;font-size:0.8em;text-align:right;white-space:nowrap;border-spacing:0.3em 0"


class Page:
    """A server of one page; a context manager.

    Parameters
    ----------
    title : of the page.
    host, port : where it listens; the next free port where that one is taken, 0 for any.
    calibrated : whether a contact law gives forces; otherwise conductances are shown.
    """

    def __init__(
        self, title: str, host: str = LOCALHOST, port: int = PORT, calibrated: bool = True
    ):
        try:
            import rich
            import viser
        except ImportError:
            raise InputError(MISSING) from None
        rich.reconfigure(quiet=True)  # what viser says of itself
        self.calibrated = calibrated
        self.server: Any = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        shown = "localhost" if host in ("0.0.0.0", "::") else host
        self.url = f"http://{shown}:{self.server.get_port()}"
        self.sheets: dict[str, Sheet] = {}
        gui = self.server.gui
        gui.main_panel.dock_right()
        self._dark(False)
        self._head = gui.add_markdown(title, order=0.0)
        dark = gui.add_checkbox("dark", False, order=1e6)
        dark.on_update(lambda event: self._dark(dark.value))
        scene = self.server.scene
        scene.configure_default_lights(enabled=False)  # colours are pressures, not light and shade
        scene.configure_environment_map(None)
        scene.add_light_ambient("/light", intensity=np.pi)
        scene.set_up_direction("+z")
        self.server.on_client_connect(self._welcome)

    def __enter__(self) -> Page:  # noqa: PYI034 - typing has Self from 3.11 on
        return self

    def __exit__(self, *error: object) -> None:
        with suppress(RuntimeError):  # of an event loop that has ended
            self.server.stop()

    def say(self, text: str) -> None:
        """A line at the top."""
        self._head.content = text

    def add_sheet(self, name: str, *shape: Any) -> Sheet:
        """A sheet under a name; one of that name goes. `shape` as of `Sheet`."""
        if name in self.sheets:
            self.remove_sheet(name)
        sheet = self.sheets[name] = Sheet(self, name, *shape)
        self._look_again()
        return sheet

    def remove_sheet(self, name: str) -> None:
        """Take a sheet off the page."""
        self.sheets.pop(name).remove()

    def place(self, sheet: Sheet, pose: Pose) -> None:
        """Where a sheet is on the robot."""
        first = sheet.place(pose)
        if first:
            self._look_again()

    def add_layout(self, layout: Layout, grid: Grid) -> Sheet:
        """The sheet of a layout, with the cells of its images."""
        cells = layout.surface.to_3d(grid.centres).reshape(*grid.shape, 3)
        electrodes = layout.surface.to_3d(layout.positions)
        shape = cells, grid.cell_size, grid.inside, electrodes, layout.radius
        return self.add_sheet(layout.name, *shape, layout)

    @property
    def is_watched(self) -> bool:
        """Whether somebody has the page open."""
        return bool(self.server.get_clients())

    def _dark(self, dark: bool) -> None:
        self.server.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)

    def _welcome(self, client: Any) -> None:
        """Show all that is known to somebody who has just come."""
        self._look_at_all(client.camera)
        for sheet in list(self.sheets.values()):
            sheet.show_again()

    def _look_again(self) -> None:
        for client in self.server.get_clients().values():
            self._look_at_all(client.camera)

    def _look_at_all(self, camera: Any) -> None:
        """From where all sheets are seen; on a narrow picture, whose words are below, in its upper part."""
        if not self.sheets:
            return
        places = np.vstack([sheet.places_in_world() for sheet in self.sheets.values()])
        size = np.ptp(places, axis=0).max() * max(1.0, 0.67 / camera.aspect)
        middle = (places.max(axis=0) + places.min(axis=0)) / 2
        middle[1] -= 0.75 * size * (camera.aspect < 1.0)
        camera.position = middle + size * np.array([0.0, -0.9, 1.2])
        camera.look_at = middle


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
    ):
        self.name, self.layout, self.inside, self._page = name, layout, inside, page
        self._lock = threading.RLock()
        self._root = f"/{name.strip('/').replace('/', '_') or 'sheet'}"
        frames, self.cells = frames_of(cells)[inside], cells[inside]
        self._normals, self._cell = frames[:, :, 2], float(np.hypot(*cell_size))
        self._least = LEAST_PRESSURE if page.calibrated else LEAST_CONDUCTANCE
        self._scale, self._trails = SteadyScale(self._least), Trails()
        self._last: tuple | None = None
        self._told = self._curved = -np.inf
        self._forces: deque[tuple[float, dict[int, float]]] = deque(maxlen=2000)
        self._size = float(np.ptp(self.cells, axis=0).max())
        scene, gui = page.server.scene, page.server.gui
        self._frame = scene.add_frame(self._root, show_axes=False)
        self._pose = _HERE
        self.tiles = self._instances(
            "pressure", _TILE * [*cell_size, 1.0], _HALVES, frames, self.cells, palette()[0]
        )
        nearest = frames[np.linalg.norm(self.cells[:, None] - electrodes, axis=2).argmin(axis=0)]
        self._electrodes = self._instances(
            "electrodes",
            _DISC * radius,
            np.stack(
                [np.zeros(_SIDES - 2), np.arange(1, _SIDES - 1), np.arange(2, _SIDES)], axis=1
            ),
            nearest,
            electrodes + 0.002 * self._size * nearest[:, :, 2],
            _WELL,
        )
        self._lines: dict[str, Any] = {}
        self._labels: list[Any] = []
        self._folder = gui.add_folder(name, order=0.35)
        with self._folder:
            self._text = gui.add_html("")
            self._chosen = gui.add_text("curves of contacts", "", hint="ids, such as 3, 7")
            self._plot = gui.add_uplot(
                *_curves([], (), page.calibrated), scales={"x": {"time": False}}, aspect=1.7
            )

    def _instances(self, name, corners, triangles, frames, places, rgb) -> Any:
        """The same flat shape (n, 3) with its triangles (m, 3) at places (N, 3), turned by frames."""
        return self._page.server.scene.add_batched_meshes_simple(
            f"{self._root}/{name}",
            corners,
            triangles,
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
            if self._page.is_watched:
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
            number_of(c, k): strength_of(c, self._page.calibrated)
            for k, c in enumerate(shot.contacts, 1)
        }
        # 0 stands for all contacts
        strengths[0] = np.nan if shot.reason else sum(strengths.values())
        self._forces.append((shot.scene_time, strengths))
        self._trails.add(shot.contacts, placed.positions, shot.scene_time)

    def _draw(self) -> None:
        assert self._last is not None
        shot, placed, truth = self._last
        now = time.monotonic()
        with self._page.server.atomic():
            scale = self._draw_pressure(shot, now)
            self._draw_contacts(shot.contacts, placed)
            self._draw_truth(truth or ())
            colours = np.tile(linear(_WELL), (len(self._electrodes.batched_positions), 1))
            colours[list(shot.faults)] = linear(_DEAD)
            _paint(self._electrodes, colours)
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
        scale = self._scale(full_scale(values, 0.0, 0.0), now)
        _paint(self.tiles, linear(colour(values, scale)))
        return scale

    def _draw_contacts(self, contacts: Sequence, placed: SpatialContacts) -> None:
        places, normals = placed.positions, placed.frames[:, :, 2]
        lengths = np.where(np.isfinite(placed.forces), METRES_PER_NEWTON * placed.forces, 0.05)
        lift = 0.003 * self._size * normals
        tails = places + np.reshape(lengths, (-1, 1)) * normals
        self._arrows("force", np.stack([tails, places], axis=1), _ORANGE)
        radii = np.array([c.radius for c in contacts], float)
        rims = [
            ring(place, frame, radius * np.eye(2))
            for place, frame, radius in zip(places + lift, placed.frames, radii, strict=True)
        ]
        known = np.isfinite(placed.covariances).all(axis=(1, 2))
        rims += [
            ring(place, frame, MAGNIFIED * root_of(covariance))
            for place, frame, covariance in zip(
                (places + lift)[known], placed.frames[known], placed.covariances[known], strict=True
            )
        ]
        rims += [np.stack([t[:-1], t[1:]], axis=1) for _, t in self._trails.items()]
        self._segments("rims", rims, _ORANGE)
        numbers = [f"{number_of(c, k)}" for k, c in enumerate(contacts, 1)]
        while len(self._labels) < len(numbers):
            name = f"{self._root}/id/{len(self._labels)}"
            self._labels.append(self._page.server.scene.add_label(name, "", visible=False))
        for k, label in enumerate(self._labels):
            label.visible = k < len(numbers)
            if label.visible:
                label.text, label.position = numbers[k], tails[k] + 2 * lift[k]

    def _draw_truth(self, truth: Sequence[dict]) -> None:
        """What really touches, as rings, where the surface of the layout has them."""
        if self.layout is None:
            return
        points = np.array([(t["x"], t["y"]) for t in truth], float).reshape(-1, 2)
        surface = self.layout.surface
        frames = surface.frames(points)
        lift = 0.004 * self._size * frames[:, :, 2]
        rings = [
            ring(place, frame, each["radius"] * np.eye(2))
            for place, frame, each in zip(surface.to_3d(points) + lift, frames, truth, strict=True)
        ]
        self._segments("truth", rings, _TRUE)

    def _segments(self, name: str, pieces: Sequence[np.ndarray], rgb: tuple) -> None:
        points = np.concatenate([np.empty((0, 2, 3)), *pieces]).astype(np.float32)
        add = partial(
            self._page.server.scene.add_line_segments, thickness=3.0, thickness_units="screen"
        )
        self._set(name, points, add, rgb)

    def _arrows(self, name: str, points: np.ndarray, rgb: tuple) -> None:
        s = self._size
        add = partial(
            self._page.server.scene.add_arrows,
            shaft_radius=0.005 * s,
            head_radius=0.014 * s,
            head_length=0.03 * s,
        )
        self._set(name, points.astype(np.float32), add, linear(rgb))

    def _set(self, name: str, points: np.ndarray, add: Any, rgb: Any) -> None:
        """Draw these (N, 2, 3) in place of what had the name."""
        drawn = self._lines.get(name)
        if not len(points):
            if drawn is not None and drawn.visible:
                drawn.visible = False
        elif drawn is None:
            self._lines[name] = add(f"{self._root}/{name}", points, rgb)
        else:
            drawn.points, drawn.visible = points, True

    def _words(self, shot: Shot, truth: Sequence[dict] | None, scale: float) -> str:
        """What there is to read, as HTML: state, scale of the colours, contacts, electrodes."""
        head = f"{shot.scene_time:.2f} s, {1e3 * shot.age:.0f} ms old, {shot.rate:.1f} images/s"
        parts = [f"<div>{head}</div>"]
        if shot.late:
            parts.append(f"<div>late: {escape(shot.late)}</div>")
        parts.append(_bar(named(scale, self._page.calibrated)))
        if shot.reason:
            parts.append(f"<div><b>{escape(withheld_line(shot.reason))}</b></div>")
        else:
            parts.append(table_of(shot.contacts, truth, self._page.calibrated))
        for electrode, why in sorted(shot.faults.items()):
            parts.append(f"<div>electrode {electrode} left out: {escape(why)}</div>")
        return f'<div style="padding:0 1em">{"".join(parts)}</div>'

    def _draw_curves(self) -> None:
        words = self._chosen.value.replace(",", " ").split()
        chosen = tuple(int(word) for word in words if word.isdigit())[: len(_CURVE_COLOURS) - 1]
        since = self._forces[-1][0] - _CURVES if self._forces else 0.0
        recent = [each for each in self._forces if each[0] >= since]
        data, series = _curves(recent, chosen, self._page.calibrated)
        self._plot.data = data
        if len(self._plot.series) != len(series) or self._plot.series[-1] != series[-1]:
            self._plot.series = series


def linear(rgb: Any) -> np.ndarray:
    """Colours 0 to 255 as light, 0 to 255: what the page takes where many shapes are drawn at once."""
    part = np.asarray(rgb) / 255.0
    light = np.where(part > 0.04045, ((part + 0.055) / 1.055) ** 2.4, part / 12.92)  # sRGB
    return np.rint(255.0 * light).astype(np.uint8)


def _paint(shapes: Any, colours: np.ndarray) -> None:
    """Give these (N, 3) colours to as many shapes, if they are others."""
    if not np.array_equal(colours, shapes.batched_colors):
        shapes.batched_colors = colours


def frames_of(cells: np.ndarray) -> np.ndarray:
    """(H, W, 3, 3) rotations of cells (H, W, 3) of an image: columns tangent, bitangent, normal."""
    height, width = cells.shape[:2]
    x = np.gradient(cells, axis=1) if width > 1 else np.broadcast_to([1.0, 0.0, 0.0], cells.shape)
    y = -np.gradient(cells, axis=0) if height > 1 else np.broadcast_to([0.0, 1.0, 0.0], cells.shape)
    normal = np.cross(x, y)
    frames = np.stack([x, np.cross(normal, x), normal], axis=-1)
    return frames / np.linalg.norm(frames, axis=-2, keepdims=True)


def ring(place: np.ndarray, frame: np.ndarray, root: np.ndarray) -> np.ndarray:
    """(n, 2, 3) segments of the ellipse root x, |x| = 1, in the tangent plane at a place (3,), m."""
    along = root @ np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])
    points = place + (frame[:, :2] @ along).T
    return np.stack([points[:-1], points[1:]], axis=1)


def root_of(covariance: np.ndarray) -> np.ndarray:
    """(2, 2) m: times its transpose it is the covariance (2, 2), m²."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def strength_of(contact: Any, calibrated: bool) -> float:
    """Force, N, or without a contact law conductance, µS."""
    return float(contact.force) if calibrated else 1e6 * float(contact.conductance)


def table_of(contacts: Sequence, truth: Sequence[dict] | None, calibrated: bool) -> str:
    """Contacts as rows of an HTML table, beside the truth where it is known."""
    if not contacts and not truth:
        return "<div>no contact</div>"
    heads = ["", "x, y / mm", "±", "N" if calibrated else "µS"]
    heads += ["off", "true N"] if truth is not None else []
    rows = []
    partners = pair(contacts, truth or ())
    for k, (c, j) in enumerate(zip(contacts, partners, strict=True), 1):
        spread = np.sqrt(max(c.position_covariance[0], c.position_covariance[3], 0.0))
        row = [f"<b>{number_of(c, k)}</b>", f"{1e3 * c.x:.1f}, {1e3 * c.y:.1f}"]
        row += ["–" if np.isnan(spread) else f"{1e3 * spread:.2f}"]
        row += [f"{strength_of(c, calibrated):.2f}"]
        if truth is not None:
            row += ["ghost", ""] if j is None else _beside(c, truth[j])
        rows.append(row)
    for j, each in enumerate(truth or ()):
        if j not in partners:
            force = "" if each["force"] is None else f"{each['force']:.2f}"
            place = f"{1e3 * each['x']:.1f}, {1e3 * each['y']:.1f}"
            rows.append(["", place, "", "", "missed", force])
    lines = ["".join(f"<th>{head}</th>" for head in heads)]
    lines += ["".join(f"<td>{cell}</td>" for cell in row) for row in rows]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f'<table style="{_TABLE}">{body}</table>'


def _beside(contact: Any, true: dict) -> list[str]:
    off = np.hypot(contact.x - true["x"], contact.y - true["y"])
    return [f"{1e3 * off:.1f}", "" if true["force"] is None else f"{true['force']:.2f}"]


def _bar(most: str) -> str:
    """The colours from nothing to full scale."""
    stops = ",".join("#" + bytes(palette()[k]).hex() for k in range(0, 256, 51))
    return (
        f'<div style="height:0.6em;background:linear-gradient(to right,{stops})"></div>'
        f'<div style="display:flex;justify-content:space-between;font-size:0.8em">'
        f"<span>0</span><span>{most}</span></div>"
    )


def _curves(
    recent: Sequence[tuple[float, dict[int, float]]], chosen: Sequence[int], calibrated: bool
) -> tuple[tuple[np.ndarray, ...], tuple[dict, ...]]:
    """Data and series of the plot: time, the sum, and each chosen contact."""
    recent = recent or [(0.0, {0: 0.0})]
    numbers = (0, *chosen)
    data = [np.array([t for t, _ in recent])]
    data += [np.array([each.get(number, np.nan) for _, each in recent]) for number in numbers]
    unit = "N" if calibrated else "µS"
    labels = [f"all, {unit}", *(f"contact {number}" for number in chosen)]
    drawn = [
        {"label": label, "stroke": stroke, "width": 2}
        for label, stroke in zip(labels, _CURVE_COLOURS, strict=False)
    ]
    return tuple(data), ({"label": "s"}, *drawn)

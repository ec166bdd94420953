"""`tomotactile inspect`: what any file of docs/formats.md holds, with a picture."""

from __future__ import annotations

import textwrap
import zipfile
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sized
from itertools import islice
from pathlib import Path

import numpy as np

from tomotactile_ros.commands.describe import (
    describe_calibration,
    describe_search,
    describe_sensor,
    describe_tare,
    known_layout,
)
from tomotactile_ros.devices.recording import BAGS, read_frames, refuse_to_import
from tomotactile_ros.frames_file import DEFAULT_DRIVE, contacts_of, doubt_of, load_arrays
from tomotactile_ros.layouts.layout import FORMAT as LAYOUT_FORMAT
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region
from tomotactile_ros.learning.file import FORMAT as SENSOR_FORMAT
from tomotactile_ros.learning.file import MAX_BYTES as SENSOR_BYTES
from tomotactile_ros.learning.findings import count
from tomotactile_ros.reconstruction.calibration import NODE
from tomotactile_ros.reconstruction.mistakes import refuse_mistakes
from tomotactile_ros.reconstruction.settings import Settings
from tomotactile_ros.reconstruction.tare_file import ARRAYS as TARE
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.course import course_to_dict
from tomotactile_ros.scenes.defects import named_defects
from tomotactile_ros.scenes.scene import FORMAT as SCENE_FORMAT
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.support.checks import at_least, plain, show
from tomotactile_ros.support.errors import InputError, printable
from tomotactile_ros.support.files import find_config
from tomotactile_ros.support.yamlio import read_mapping

HELP = "show what a file holds: layout, scene, frames, result, tare, sensor, calibration, search"
_WIDTH = 79  # of a line; longer ones go on in the next, between words
_LONGEST = 400  # characters of a value
_SHOWN = 16  # rows of a scan, entries of a provenance, contacts of a scene
_PICTURE = "    "  # begins the lines of pictures
_COLUMNS = 60  # of the picture; a character is about twice as high as it is wide

_BRIGHT = 60 * Settings.noise  # V, at least: of an idle sheet, noise is dark

_SHADES = " .:-=+*#%@"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", help="file, or name of an installed layout or scene")
    parser.add_argument(
        "--layout",
        help="sheet to draw a scene on (default: equal-8x8), or that frames are of (default: what they name)",
    )


def run(args: Namespace) -> None:
    path = _find(args.file)
    refuse_to_import(path)
    if path.is_dir() or path.suffix in BAGS:
        _show(_describe_frames(path, _of_bag(path), args.layout))
        return
    if path.suffix == ".npz" or zipfile.is_zipfile(path):
        _show(_describe_arrays(path, args.layout))
        return
    if path.suffix == ".search":
        _show(describe_search(path))
        return
    content = read_mapping(path, SENSOR_BYTES)
    kind = content.get("format")
    if kind == LAYOUT_FORMAT:
        _show(describe_layout(load_layout(path, content)))
    elif kind == SCENE_FORMAT:
        scene = load_scene(path, content)
        _show(_describe_scene(scene, load_layout(scene.layout or args.layout or "equal-8x8")))
    elif kind == SENSOR_FORMAT:
        _show(describe_sensor(path, content, args.layout))
    elif kind is None and NODE in content:
        _show(describe_calibration(path))
    else:
        found = show(kind) if str(kind).startswith("tomotactile-") else "what it names"
        raise InputError(
            f"{path}: format: {found} is none of {LAYOUT_FORMAT}, {SCENE_FORMAT} and {SENSOR_FORMAT}, and "
            f"the file is no calibration ({NODE}) and no .npz"
        )


def _show(lines):
    for line in lines:
        text = printable(line)
        if len(text) <= _WIDTH or text.startswith(_PICTURE):
            print(text)
        else:
            print(textwrap.fill(text, _WIDTH, subsequent_indent=" " * 6, break_long_words=False))


def _find(name):
    if Path(name, "metadata.yaml").is_file():  # of a bag
        return Path(name)
    for kind in ("layouts", "scenes"):
        try:
            return find_config(kind, name)
        except InputError:
            continue
    raise InputError(f"{show(name)}: no such file, layout or scene")


def describe_layout(layout: Layout) -> Iterator[str]:
    """Lines: size, pitch, origin and a picture."""
    a, b = (f"{1e3 * side:g} mm" for side in layout.outline.size)
    pitches = layout.pitches
    yield f"layout {layout.name}: {layout.electrodes} electrodes, {layout.outline.kind}"
    yield f"  id                {layout.id}"
    if layout.surface.kind != "flat":
        yield f"  surface           {layout.surface.kind}"
    yield f"  outline           {a} x {b}, {plain(layout.outline.area * 1e4, 4)} cm2"
    for hole in layout.outline.holes:
        low, high = 1e3 * hole.min(axis=0), 1e3 * hole.max(axis=0)
        (a, b), (x, y) = high - low, (low + high) / 2
        yield f"  hole              {plain(a)} mm x {plain(b)} mm at ({plain(x)}, {plain(y)}) mm"
    yield f"  sheet resistance  {layout.sheet_resistance:g} ohm/sq"
    yield f"  electrode radius  {layout.radius * 1e3:g} mm"
    yield f"  nearest pitch     {plain(pitches.min() * 1e3, 4)} to {plain(pitches.max() * 1e3, 4)} mm"
    for key, value in layout.tolerance.to_dict().items():
        said = f"{100 * value:g} %" if key == "radius" else f"{1e3 * value:g} mm"
        yield f"  {f'tolerance, {key}':17} {said}"
    if layout.scan:
        order = " ".join(map(str, layout.scan[:_SHOWN]))
        order += " ..." if len(layout.scan) > _SHOWN else ""
        yield f"  scan              {len(layout.scan)} rows: {order}"
    for key, value in islice(layout.provenance.items(), _SHOWN):
        yield f"  {key:17} {_short(value)}"
    yield from _more(layout.provenance)
    yield "  electrode 0 is marked 0, the last one $"
    canvas = _Canvas(layout.outline)
    canvas.electrodes(layout.positions)
    yield from canvas.lines()


def _describe_scene(scene, layout):
    yield f"scene {scene.name}: {scene.drive_voltage:g} V, contacts: {len(scene.contacts)}"
    for contact in scene.contacts[:_SHOWN]:
        yield "  " + _describe_contact(contact)
    yield from _more(scene.contacts)
    for key in ("contact_law", "noise", "adc"):
        value = getattr(scene, key)
        if value is not None:
            yield f"  {key:17} {_short({k: v for k, v in vars(value).items() if v is not None})}"
    for key, value in named_defects(scene.defects).items():
        yield f"  {key:17} {_short(value)}"
    for key, meaning in (
        ("live", "contacts also come from outside"),
        ("own_reading", "the grounded electrode is read, too"),
    ):
        if getattr(scene, key):
            yield f"  {key:17} {meaning}"
    yield f"  on {layout.name}, contacts where they begin (#), electrodes (o)"
    canvas = _Canvas(layout.outline)
    for contact in scene.contacts:
        canvas.contact(contact)
    canvas.electrodes(layout.positions, ends=False)
    yield from canvas.lines()


def _more(entries: Sized) -> Iterator[str]:
    """How many were not shown, if any."""
    if len(entries) > _SHOWN:
        yield f"  ... and {len(entries) - _SHOWN} more"


def _describe_contact(contact: Contact):
    x, y = contact.centroid * 1e3
    text = (
        f"{contact.shape} at ({plain(x, 4)}, {plain(y, 4)}) mm, {plain(contact.area * 1e6, 4)} mm2"
    )
    if contact.mean_pressure is None or contact.total_force is None:
        text += ", bare conductor"
    else:
        text += f", {plain(contact.mean_pressure / 1e3, 4)} kPa, {plain(contact.total_force)} N"
    if contact.profile != "even":
        text += f", profile {contact.profile}"
    if contact.course is not None:
        text += f", {_short(course_to_dict(contact.course))}"
    if contact.path is not None:
        round_ = "round and round" if contact.loop else "and stays"
        text += (
            f", along {len(contact.path)} way points at {plain(contact.speed * 1e3)} mm/s {round_}"
        )
    elif contact.moves:
        vx, vy = contact.velocity * 1e3
        text += f", moves at ({plain(vx)}, {plain(vy)}) mm/s"
    until = f" to {contact.end:g}" if np.isfinite(contact.end) else ""
    return text + (f", from {contact.start:g}{until} s" if contact.start or until else "")


def _describe_arrays(path, layout):
    content = load_arrays(path)
    if content.keys() >= TARE:
        yield from describe_tare(path, content)
        yield "  a row for each grounded electrode, dark = 0 V:"
        yield from _shade(content["baseline"])
        return
    yield from _describe_frames(path, content, layout)


def _of_bag(path):
    """Arrays as in a file of frames."""
    frames = list(read_frames(path))
    if any(not np.array_equal(frame.grounded, frames[0].grounded) for frame in frames):
        raise InputError(f"{path}: its frames differ in their ground conditions")
    return {
        "voltages": np.array([frame.voltages for frame in frames]),
        "grounded": frames[0].grounded,
        "stamps": np.array([frame.stamp for frame in frames]),
        "drive_voltage": np.array(frames[0].drive_voltage),
        "row_period": np.median([frame.row_period for frame in frames]),
    }


def _describe_frames(path, content, layout):
    yield f"{Path(path).name}:"
    for key, value in content.items():
        yield f"  {key:14} {value.dtype.name if value.dtype.kind != 'U' else 'text'} {value.shape}"
    if _is_stack(content.get("voltages")):
        yield from _describe_voltages(content["voltages"])
        yield from _describe_order(content, layout or str(content.get("layout_id", "")))
        yield f"  {_row_times(content.get('row_period'))}"
        if doubt := _doubt_of_stamps(content.get("stamps")):
            yield f"  {doubt}"
    if _is_stack(content.get("conductance")):
        last = content["conductance"][-1]
        yield "  no contact law: forces and pressures are not known"
        yield f"  last image, peak {plain(np.nanmax(last, initial=0.0), 4)} S/m2, +y up:"
        yield from _shade(last)
    elif _is_stack(content.get("pressure")):
        last = content["pressure"][-1]
        yield f"  last image, peak {plain(np.nanmax(last, initial=0.0) / 1e3, 4)} kPa, +y up:"
        yield from _shade(last)
    for key in ("truth", "contacts"):
        if key in content:
            yield from _describe_contacts(key, contacts_of(path, key, content[key]))
    reasons = np.ravel(content.get("reason", "")).tolist()
    if withheld := [reason for reason in reasons if reason]:
        yield f"  contacts withheld in {len(withheld)} of {len(reasons)}, last: {withheld[-1]}"


def _doubt_of_stamps(stamps):
    """What is wrong with the times of frames, if anything."""
    if stamps is None or stamps.ndim != 1 or stamps.dtype.kind not in "fiu":
        return ""
    return doubt_of(stamps)


def _row_times(row_period):
    """What a file of frames says about the times of its rows."""
    if row_period is None or not np.any(row_period):
        return "rows of a frame all at once, or their times are not known"
    (period,) = np.ravel(row_period)[:1]
    if not isinstance(period, np.number) or not np.isreal(period):
        return f"row_period: {show(period)} is no number"
    return f"row i of a frame at its stamp + i x {plain(1e3 * float(period), 4)} ms"


def _is_stack(array):
    """Whether there are frames or images in it: (N, rows, columns) numbers."""
    return array is not None and array.ndim == 3 and array.size and array.dtype.kind in "fiu"


def _describe_voltages(voltages):
    valid = ~np.isnan(voltages)
    dead = np.flatnonzero(~valid.any(axis=(0, 1)))
    yield f"  {count(len(voltages), 'frame')} of {voltages.shape[1]} ground conditions"
    if valid.any():
        yield f"  readings {plain(np.nanmin(voltages), 4)} to {plain(np.nanmax(voltages), 4)} V"
    else:
        yield "  no valid reading"
    yield f"  electrodes without a reading: {', '.join(map(str, dead)) or 'none'}"
    bright = max(np.nanmax(voltages[-1], initial=0.0), _BRIGHT)
    yield f"  last frame, a row for each grounded electrode, dark = 0 V, bright = {plain(bright, 2)} V:"
    yield from _shade(voltages[-1], _BRIGHT)


def _describe_order(content, name):
    """Which electrode reads most, and what the readings say against the order of the layout `name`,
    an installed one or a file."""
    frames, grounded = content["voltages"], content.get("grounded")
    means = np.nan_to_num(frames).mean(axis=1)
    highest = means[means.max(axis=1).argmax()]
    if highest.max() < Settings().threshold * Settings().noise:
        alone = "a tare: nothing seems to touch in its one frame"
        yield f"  {alone if len(frames) == 1 else 'nothing seems to touch in any frame'}"
        return
    text = f"  electrode {highest.argmax()} reads most"
    layout = known_layout(name, None)
    if layout is None:
        yield f"{text} (--layout LAYOUT says where that is)"
        return
    if grounded is None or frames.shape[2] != layout.electrodes:
        yield f"{text}; {layout.name} has {layout.electrodes} electrodes"
        return
    x, y = 1e3 * layout.positions[highest.argmax()]
    yield f"{text}: {layout.name} has it at ({x:.1f}, {y:.1f}) mm"
    try:
        drive = float(np.ravel(content.get("drive_voltage", DEFAULT_DRIVE))[0])
        refuse_mistakes(layout, frames, grounded, drive, Settings().noise)
    except InputError as mistake:
        yield f"  {mistake}"


def _describe_contacts(key, frames):
    last = frames[-1] if frames else []
    yield f"  {key} of the last frame:" if last else f"  {key}: none in the last frame"
    for contact in last:
        x_y = f"({contact['x'] * 1e3:.1f}, {contact['y'] * 1e3:.1f}) mm"
        place = _deviation(contact.get("position_std"), 1e3, "mm")
        force = ""
        if contact["force"] is not None:
            spread = contact.get("force_std")
            # a result that says how sure a place is, but not a force, is of a bare conductor
            bare = spread is None and contact.get("position_std") is not None
            least = at_least(np.inf if bare else 0.0)
            force = f", {least}{plain(contact['force'])} N{_deviation(spread, 1.0, 'N')}"
        yield f"    {x_y}{place}{force}"


def _deviation(value, scale, unit):
    """What a result says of how sure something is; nothing of the truth of a simulated frame."""
    if value is None or not np.isfinite(value):
        return ""
    return f" ± {plain(value * scale, 2)} {unit}"


def _shade(image, least=0.0):
    """Lines of a picture, the brightest character for its largest value or `least`, if that is more."""
    rows = max(1, round(image.shape[0] / image.shape[1] * _COLUMNS / 2))
    row = (np.arange(rows) * image.shape[0] / rows).astype(int)
    column = (np.arange(_COLUMNS) * image.shape[1] / _COLUMNS).astype(int)
    small = image[np.ix_(row, column)].astype(float)
    small[~np.isfinite(small)] = 0.0
    level = small / (max(small.max(), least) or 1.0)
    for line in np.clip(level * (len(_SHADES) - 1), 0, len(_SHADES) - 1).round().astype(int):
        yield _PICTURE + "".join(_SHADES[i] for i in line)


class _Canvas:
    """Characters over the bounding box of an outline; the +y edge is the first line."""

    def __init__(self, outline: Outline):
        self._low = np.array(outline.bounds[:2])
        self._size = np.array(outline.size)
        rows = int(np.clip(round(self._size[1] / self._size[0] * _COLUMNS / 2), 1, 60))
        self._shape = np.array([_COLUMNS, rows])
        x, y = ((np.arange(n) + 0.5) / n for n in self._shape)
        y = y[::-1]
        self._cells = np.stack(np.meshgrid(x, y), axis=-1) * self._size + self._low
        inside = outline.contains(self._cells.reshape(-1, 2)).reshape(self._cells.shape[:2])
        self._text = np.where(inside, "·", " ")

    def _put(self, where, mark):
        column, up = np.clip((where - self._low) / self._size * self._shape, 0, self._shape - 1)
        self._text[self._shape[1] - 1 - int(up), int(column)] = mark

    def electrodes(self, positions, ends=True):
        for where in positions:
            self._put(where, "o")
        if ends:
            self._put(positions[-1], "$")
            self._put(positions[0], "0")

    def contact(self, contact):
        inside = Region(contact.vertices).contains(self._cells.reshape(-1, 2))
        self._text[inside.reshape(self._text.shape)] = "#"
        self._put(contact.centroid, "#")

    def lines(self):
        for line in self._text:
            yield _PICTURE + "".join(line)


def _short(value):
    """Text of a value on one line, shortened between words."""
    return textwrap.shorten(_text(value), _LONGEST, placeholder=" …")


def _text(value):
    if hasattr(value, "__dict__"):
        value = vars(value)
    if isinstance(value, dict):
        return ", ".join(
            f"{k} ({_text(v)})" if isinstance(v, dict) else f"{k} {_text(v)}"
            for k, v in value.items()
        )
    if isinstance(value, list) and any(isinstance(each, dict) for each in value):
        return "; ".join(map(_text, value))
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_text, value))}]"
    return str(value)

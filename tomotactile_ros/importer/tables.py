"""Numbers in files of other programs: text (CSV, TSV, logs of a serial port), MATLAB's and numpy's
arrays, arrays in a rosbag2.

What is guessed of a file is told with it, a line each.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tomotactile_ros.devices.bag import read_arrays
from tomotactile_ros.devices.recording import BAGS
from tomotactile_ros.frames_file import MAX_BYTES, load_arrays
from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import open_regular, read_limited

ENDINGS = (".csv", ".tsv", ".txt", ".dat", ".mat", ".npy", ".npz")
_MOST_TEXT = 500_000_000  # bytes
_NOTHING = ("", "nan", "na", "n/a", "null", "none", "-")  # a cell that holds no reading
_COMMENTS = "#%"
_SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas", None: "spaces"}
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
_NUMBERED = re.compile(r"\s*(\d+)\s*:[ \t;,]?")
_DATE = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}:\d\d")
_WITH_UNIT = re.compile(r"[-+]?\d[\d.,]*(?:[eE][-+]?\d+)?\s*(?:[munpkMµμ]?[VA]|%)")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:\.\d{3})+,\d+|[-+]?\d{1,3}(?:,\d{3})+\.\d+")
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")  # how such texts begin
_LOOKED_AT = 50  # lines, for the separator


@dataclass(frozen=True, eq=False)
class Table:
    """Numbers of a file.

    values : float64, of any shape; NaN where there is none
    names : of the columns, where a text has a header
    told : what was found out about the file
    has_columns : it is a text, which may hold more than readings
    times : (N,) s, of the first index
    """

    values: np.ndarray
    names: tuple[str, ...] = ()
    told: list[str] = field(default_factory=list)
    has_columns: bool = False
    times: np.ndarray | None = None


def read_table(
    path: str | os.PathLike, variable: str | None = None, missing: Sequence[str] = ()
) -> Table:
    """The numbers of a file; InputError for one that is none of `ENDINGS`, or damaged.

    variable : of a file that holds several arrays; topic of a bag
    missing : what stands where there is no reading, beside nothing and `nan`
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending in BAGS or path.is_dir():
        return _bag(path, variable)
    if ending not in ENDINGS:
        raise InputError(
            f"{path}: is none of {', '.join(ENDINGS)}; save the readings as one of them"
        )
    if ending == ".mat":
        table = _chosen(path, _matlab(path), variable)
    elif ending == ".npy":
        table = Table(_numbers(path, "the array", _numpy(path)))
    elif ending == ".npz":
        table = _chosen(path, load_arrays(path), variable)
    else:
        table = _text(path, missing)
    for number in filter(None, map(_as_number, missing)):
        np.copyto(table.values, np.nan, where=table.values == number)
    return table


def _as_number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _text(path: Path, missing: Sequence[str]) -> Table:
    data = read_limited(path, _MOST_TEXT)
    try:
        text = data.decode("utf-16" if data[:2] in _UTF_16 else "utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text in UTF-8 or UTF-16; save it as UTF-8") from None
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and line.strip()[0] not in _COMMENTS
    ]
    if not lines:
        raise InputError(f"{path}: holds no numbers")
    numbered = [_NUMBERED.match(line) for _, line in lines]
    if all(numbered):  # `3: ...`, as devices/text.py has it: a column
        mark = next((m for m in "\t;," if m in lines[0][1]), " ")
        lines = [(number, _NUMBERED.sub(rf"\1{mark}", line)) for number, line in lines]
    separator = _separator([line for _, line in lines[:_LOOKED_AT]])
    split = [
        (number, [cell.strip().strip('"') for cell in line.split(separator)])
        for number, line in lines
    ]
    rows = [(number, cells) for number, cells in split if any(cells)]
    if not rows:
        raise InputError(f"{path}: holds no numbers")
    nothing = {*_NOTHING, *(each.lower() for each in missing)}
    comma = separator != "," and any(map(_DECIMAL_COMMA.fullmatch, rows[-1][1]))
    above = _words_above([cells for _, cells in rows], nothing, comma)
    names = tuple(rows[above - 1][1]) if above else ()
    rows = rows[above:]
    if not rows:
        raise InputError(f"{path}: holds a header and no numbers")
    width = len(rows[0][1])
    values = np.empty((len(rows), width))
    for place, (number, cells) in enumerate(rows):
        if len(cells) != width and (len(cells) != width + 1 or cells[-1]):
            raise InputError(
                f"{path}: line {number} has {len(cells)} values, line {rows[0][0]} has {width}"
            )
        values[place] = _line(path, number, cells[:width], nothing, comma)
    told = f"{len(rows)} lines of {width} numbers, separated by {_SEPARATORS[separator]}"
    told += ", decimal commas" if comma else ""
    told += ", below a header" if above else ", no header"
    told += f" of {above} lines" if above > 1 else ""
    return Table(values, names, [told], has_columns=True)


def _separator(lines: list[str]) -> str | None:
    """What splits the lines into equally many cells, and most of them."""
    found: list[tuple[int, str | None]] = []
    for mark in _SEPARATORS:
        counts = [len(line.split(mark)) for line in lines]
        usual = max(set(counts), key=counts.count)
        unlike = mark is None and found  # spaces in cells, as of `1.18 V`
        if usual > 1 and counts.count(usual) >= len(counts) / 2 and not unlike:
            found.append((usual, mark))
    if any(mark in ("\t", ";") for _, mark in found):  # commas may be those of decimals
        found = [(count, mark) for count, mark in found if mark != ","]
    return max(found, key=lambda each: each[0])[1] if found else None


def _line(path: Path, number: int, cells: list[str], nothing: set[str], comma: bool) -> list[float]:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        pass
    found = [_value(cell, nothing, comma) for cell in cells]
    if None in found:
        cell = cells[found.index(None)]
        raise InputError(f"{path}: line {number}: {checks.show(cell)} {_what_it_is(cell)}")
    return found  # type: ignore[return-value] # None was refused


def _what_it_is(cell: str) -> str:
    """What a cell is that is no number, and what would be right."""
    if _DATE.match(cell):
        return "is a date: write times as seconds, or leave the column out"
    if _WITH_UNIT.fullmatch(cell):
        return "has a unit: leave it out of the cells, --unit names that of all readings"
    if _THOUSANDS.fullmatch(cell):
        return "has points and commas: write thousands without a mark"
    mark = f"={checks.show(cell)}" if cell.startswith("-") else f" {checks.show(cell)}"
    return f"is not a number; if it marks a missing reading: --missing{mark}"


def _words_above(rows: list[list[str]], nothing: set[str], comma: bool) -> int:
    """How many lines are above the numbers: the first, where it has words, and those before the last that
    has words alone, or is not as long as most."""
    lengths = [len(cells) for cells in rows]
    usual, above = max(set(lengths), key=lengths.count), 0
    for number, cells in enumerate(rows):
        found = [_value(cell, nothing, comma) for cell in cells]
        words = [cell for cell, value in zip(cells, found, strict=True) if value is None]
        if not words or (len(cells) == usual and any(map(_like_a_number, words))):
            break
        alone = all(value is None or np.isnan(value) for value in found)
        if number and len(cells) == usual and not alone:
            break
        above = number + 1
    return above


def _like_a_number(cell: str) -> bool:
    shapes = _DATE.match, _WITH_UNIT.fullmatch, _THOUSANDS.fullmatch
    return any(shape(cell) for shape in shapes)


def _value(cell: str, nothing: set[str], comma: bool) -> float | None:
    if cell.lower() in nothing:
        return np.nan
    return _as_number(cell.replace(",", ".") if comma else cell)


def _numpy(path: Path) -> np.ndarray:
    os.close(open_regular(path, MAX_BYTES))
    try:
        return np.load(
            path, mmap_mode="r", allow_pickle=False
        )  # a map is never larger than its file
    except (ValueError, EOFError, OSError, SyntaxError):
        raise InputError(f"{path}: is not a plain array (.npy)") from None


def _matlab(path: Path) -> dict[str, object]:
    from scipy import io

    os.close(open_regular(path, MAX_BYTES))
    try:
        size = sum(8 * float(np.prod(shape)) for _, shape, _ in io.whosmat(path))
        if size > MAX_BYTES:
            raise InputError(
                f"{path}: its arrays have {plain(size / 1e6, 4)} MB, at most {MAX_BYTES / 1e6:g}"
            )
        found = io.loadmat(path, struct_as_record=True)
    except NotImplementedError:
        raise InputError(
            f"{path}: is of MATLAB's version 7.3, which is HDF5; save it with save(..., '-v7')"
        ) from None
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged file ends in errors of many kinds
        raise InputError(f"{path}: is not a file of MATLAB ({type(error).__name__})") from None
    found = {name: value for name, value in found.items() if not name.startswith("__")}
    structs = {
        name: np.hstack([np.atleast_2d(one["meas"]) for one in value.ravel()])
        for name, value in found.items()
        if value.dtype.names and "meas" in value.dtype.names  # data of EIDORS
    }
    return {**found, **structs}


def _bag(path: Path, topic: str | None) -> Table:
    """Arrays of a topic, (N, ...) as their layout says, and when they were recorded."""
    times: list[float] = []
    arrays: list[np.ndarray] = []
    for time, message in read_arrays(path, topic):
        shape = [dimension.size for dimension in message.layout.dim]
        array = np.asarray(message.data, float)
        if arrays and array.size != arrays[0].size:
            raise InputError(
                f"{path}: array {len(arrays)} has {array.size} numbers, those before {arrays[0].size}"
            )
        arrays.append(array.reshape(shape) if np.prod(shape) == array.size else array)
        times.append(time)
    if not arrays:
        raise InputError(f"{path}: holds no array")
    values = np.stack(arrays)
    shown = " x ".join(map(str, values.shape[1:]))
    told = f"{len(values)} arrays of {shown} numbers, times as they were recorded"
    return Table(values, told=[told], times=np.array(times))


def _chosen(path: Path, arrays: dict, variable: str | None) -> Table:
    """The array that is named, or the only one with numbers for a frame."""
    if variable is not None and variable not in arrays:
        raise InputError(
            f"{path}: variable: there is no {checks.show(variable)}, {_listed(arrays)}"
        )
    if variable is None:
        likely = [
            name
            for name, value in arrays.items()
            if value.dtype.kind in "fiuc" and np.squeeze(value).ndim > 0 and value.size > 3
        ]
        likely = [name for name in likely if name in ("voltages", "meas")] or likely
        if len(likely) != 1:
            raise InputError(
                f"{path}: say which array holds the readings (--variable): {_listed(arrays)}"
            )
        variable = likely[0]
    value = _numbers(path, variable, arrays[variable])
    shape = " x ".join(map(str, value.shape))
    return Table(value, told=[f"array {checks.show(variable).strip(chr(39))}, {shape}"])


def _listed(arrays: dict) -> str:
    each = (f"{name} ({'x'.join(map(str, np.shape(value)))})" for name, value in arrays.items())
    return f"it holds {', '.join(each) or 'nothing'}"


def _numbers(path: Path, name: str, value: np.ndarray) -> np.ndarray:
    if value.dtype.kind == "c":
        raise InputError(f"{path}: {name} is complex; the sheet is resistive: save its real part")
    if value.dtype.kind not in "fiub" or not value.size:
        raise InputError(f"{path}: {name} holds no real numbers ({value.dtype}, {value.shape})")
    return np.array(value, float)

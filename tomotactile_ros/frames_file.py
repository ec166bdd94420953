"""Files of arrays (`.npz`): recorded or simulated frames, and the results of the commands."""

from __future__ import annotations

import io
import json
import math
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from typing import IO

import numpy as np

from tomotactile_ros.frame import DEFAULT_DRIVE, Frame
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.layout_ids import matches, note_bare
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError, complaints_at
from tomotactile_ros.support.files import open_regular, write_atomic

MAX_BYTES = 4_000_000_000  # of all arrays together
MAX_STREAMED = 1_000_000_000_000  # the same where frames are read one after the other
MAX_GROWTH = 100  # times the size of the file; measured readings hardly compress at all
HARMLESS_BYTES = 256_000_000  # however much they were compressed
_INFINITE = "infinite; NaN is what marks an invalid reading"
_OVERLONG = 2.0  # times the distance between stamps, which may be those of arrivals
_LONGEST_HEADER = 10_000  # bytes, of numpy's arrays


@dataclass(frozen=True, eq=False)
class FramesFile:
    """What a file of frames says; None where it does not.

    Attributes
    ----------
    voltages, grounded : (N, L, E) V, an array or `StoredFrames`; (L,).
    drive_voltage : V.
    stamps : (N,) s.
    truth : for each frame a list of contacts, see `contacts_of`.
    contact_law : of the contacts.
    lawless : the file says that there is no contact law, as of bare conductors; otherwise it says
        nothing of one where `contact_law` is None.
    row_period : s; row i of a frame was taken at its stamp + i * row_period; 0 for all at once, and
        where the file says nothing.
    """

    voltages: np.ndarray | StoredFrames
    grounded: np.ndarray
    drive_voltage: float | None = None
    stamps: np.ndarray | None = None
    truth: list[list[dict]] | None = None
    contact_law: ContactLaw | None = None
    row_period: float = 0.0
    lawless: bool = False

    @property
    def drive(self) -> float:
        """The drive voltage, V, or the usual one."""
        return DEFAULT_DRIVE if self.drive_voltage is None else self.drive_voltage

    def __len__(self) -> int:
        """Number of frames N."""
        return len(self.voltages)

    def __iter__(self) -> Iterator[Frame]:
        """The frames, one after the other, with their times as far as the file has them."""
        stamps = repeat(math.nan) if self.stamps is None else self.stamps
        for number, (voltages, stamp) in enumerate(zip(self.voltages, stamps)):
            yield Frame(voltages, self.grounded, number, float(stamp), self.drive, self.row_period)


class StoredFrames:
    """Frames (N, L, E), V, that are read from their file each time one goes through them.

    Parameters
    ----------
    read : begins anew and gives arrays (L, E), V; shape : (N, L, E)
    """

    def __init__(self, read: Callable[[], Iterator[np.ndarray]], shape: tuple[int, int, int]):
        self._read, self.shape = read, shape

    def __iter__(self) -> Iterator[np.ndarray]:
        return self._read()

    def __len__(self) -> int:
        return self.shape[0]


def load_frames(path: str | os.PathLike, layout_id: str | None = None) -> FramesFile:
    """Read frames of a layout, of any if None; InputError for anything else."""
    arrays = load_arrays(path)
    if "voltages" in arrays:
        voltages = arrays["voltages"]
        _check_frames(path, voltages.shape, voltages.dtype)
        if np.isinf(voltages).any():
            raise InputError(f"{path}: voltages: one is {_INFINITE}")
    return _file_of(path, arrays, arrays.get("voltages"), layout_id)


def open_frames(path: str | os.PathLike, layout_id: str | None = None) -> FramesFile:
    """As `load_frames`, of any length in little memory: `StoredFrames`, and no truth.

    Frames that are stored column by column (Fortran order) do not stand one behind the other in
    their file: these are read whole.
    """
    arrays = load_arrays(path, without=("voltages", "truth", "truth_last"), most=MAX_STREAMED)
    with _complaining(path), _opened(path, "voltages", MAX_STREAMED) as (_, header):
        stored = None
        if header is not None:
            shape, in_columns, dtype = header
            if in_columns:
                return load_frames(path, layout_id)
            _check_frames(path, shape, dtype)
            stored = StoredFrames(partial(_stream, path), shape)
    return _file_of(path, arrays, stored, layout_id)


def _stream(path) -> Iterator[np.ndarray]:
    """(L, E) frame after frame of a file."""
    with _complaining(path), _opened(path, "voltages", MAX_STREAMED) as (member, header):
        assert header is not None  # of `open_frames`
        (count, *shape), _, dtype = header
        size = math.prod(shape) * dtype.itemsize
        for number in range(count):
            data = member.read(size)
            if len(data) < size:
                raise InputError(f"{path}: voltages: ends in frame {number} of {count}")
            frame = np.frombuffer(data, dtype).reshape(shape)
            if np.isinf(frame).any():
                raise InputError(f"{path}: voltages: one of frame {number} is {_INFINITE}")
            yield frame


def _file_of(path, arrays, voltages, layout_id) -> FramesFile:
    """What a file says with these arrays and `voltages` (N, L, E), V."""
    found = str(arrays.get("layout_id", layout_id))
    if layout_id is not None:
        if not matches(found, layout_id):
            raise InputError(f"{path}: layout_id: frames of '{found}', not of '{layout_id}'")
        note_bare(found, layout_id, path)
    for name, array in (("voltages", voltages), ("grounded", arrays.get("grounded"))):
        if array is None:
            raise InputError(f"{path}: {name}: is missing, a file of frames has it")
    grounded = arrays["grounded"]
    _, rows, electrodes = voltages.shape
    if grounded.shape == (rows,) and np.array_equal(np.sort(grounded), 1 + np.arange(electrodes)):
        raise InputError(f"{path}: grounded: electrodes are numbered from 0, not from 1")
    if grounded.shape != (rows,) or not np.isin(grounded, np.arange(electrodes)).all():
        raise InputError(
            f"{path}: grounded: one of the electrodes 0 ... {electrodes - 1} is needed for each of "
            f"{rows} rows; voltages of shape {voltages.shape} are (frames, rows, electrodes), are the "
            "axes exchanged?"
        )
    row_period = _number(path, arrays, "row_period", checks.not_negative, "time in s") or 0.0
    stamps = _stamps(path, arrays, len(voltages))
    _check_times(path, stamps, row_period * rows)
    return FramesFile(
        voltages,
        grounded.astype(np.uint16),
        _number(path, arrays, "drive_voltage", checks.positive, "voltage in V"),
        stamps,
        contacts_of(path, "truth", arrays["truth"]) if "truth" in arrays else None,
        _contact_law(path, arrays),
        row_period,
        "contact_law" in arrays and not arrays["contact_law"].size,
    )


def _check_frames(path: str | os.PathLike, shape: tuple[int, ...], dtype: np.dtype) -> None:
    """Refuse what is no array of frames."""
    if dtype.kind not in "fiu":
        raise InputError(
            f"{path}: voltages: holds {checks.show(str(dtype))}, volts are real numbers"
        )
    if len(shape) != 3:
        raise InputError(f"{path}: voltages: shape {shape}, frames x rows x electrodes are needed")
    if not shape[0]:
        raise InputError(f"{path}: voltages: holds no frame")


def load_arrays(
    path: str | os.PathLike, *, without: Sequence[str] = (), most: int = MAX_BYTES
) -> dict[str, np.ndarray]:
    """All arrays of an `.npz` file but some; InputError for anything else, also for one too
    large."""
    with _complaining(path), os.fdopen(open_regular(path, most), "rb") as file:
        _check_sizes(path, file, most)
        with np.lib.npyio.NpzFile(file, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files if name not in without}
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):
            raise InputError(f"{path}: {checks.show(name)}: is not an array, the file is no .npz")
    return arrays


@contextmanager
def _complaining(path: str | os.PathLike) -> Iterator[None]:
    """One line for whatever a damaged file ends in."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except InputError:
        raise
    except (
        ValueError, EOFError, KeyError, RuntimeError, RecursionError, MemoryError,
        zipfile.BadZipFile, zlib.error, struct.error,
    ):  # fmt: skip
        raise InputError(f"{path}: is not a file of plain arrays (.npz)") from None


@contextmanager
def _opened(path, name: str, most: int) -> Iterator[tuple[IO[bytes], tuple | None]]:
    """The bytes of one array, and its shape, order and type; None where there is no such array."""
    with (
        os.fdopen(open_regular(path, most), "rb") as file,
        zipfile.ZipFile(file) as archive,
    ):
        if f"{name}.npy" not in archive.namelist():
            yield io.BytesIO(), None
            return
        with archive.open(f"{name}.npy") as member:
            yield member, _header(member)


def _check_sizes(path: str | os.PathLike, file: IO[bytes], most: int) -> None:
    """Refuse what grows beyond `most` bytes, and an array that says it is larger than it is."""
    with zipfile.ZipFile(file) as archive:
        total = sum(member.file_size for member in archive.infolist())
        packed = os.fstat(file.fileno()).st_size
        if total > most or total > max(MAX_GROWTH * packed, HARMLESS_BYTES):
            raise InputError(
                f"{path}: {checks.size(packed)} would grow to {checks.size(total)}; at most "
                f"{checks.size(min(most, max(MAX_GROWTH * packed, HARMLESS_BYTES)))} is read"
            )
        for member in archive.infolist():
            with archive.open(member) as stream:
                header = stream.read(_LONGEST_HEADER)
            declared = _declared_bytes(header)
            if declared is not None and declared > member.file_size:
                raise InputError(
                    f"{path}: {checks.show(member.filename)}: {checks.size(declared)} declared, "
                    f"{checks.size(member.file_size)} there"
                )
    file.seek(0)


def _declared_bytes(header: bytes) -> int | None:
    """Size of the array that begins so; None where it is no array."""
    if header[:6] != b"\x93NUMPY":
        return None
    shape, _, dtype = _header(io.BytesIO(header))
    return math.prod(shape) * dtype.itemsize


def _header(stream: IO[bytes]) -> tuple:
    """Shape, order and type of the array that begins there."""
    if np.lib.format.read_magic(stream) == (1, 0):
        return np.lib.format.read_array_header_1_0(stream)
    return np.lib.format.read_array_header_2_0(stream)


def contacts_of(path: str | os.PathLike, key: str, text: object) -> list[list[dict]]:
    """Contacts of every frame from their JSON text: x, y in m and force in N or None, and more."""
    try:
        frames = json.loads(str(text))
        for contact in [contact for frame in frames for contact in frame]:
            checks.pair((contact["x"], contact["y"]), "center", "position in m")
            if contact["force"] is not None:
                checks.number(contact["force"], "force", "force in N")
    except (ValueError, TypeError, KeyError, RecursionError):
        raise InputError(
            f"{path}: {key}: is not JSON of a list of contacts (x, y, force) for each frame"
        ) from None
    return frames


def save_frames(
    path: str | os.PathLike,
    layout: Layout,
    scene: Scene,
    voltages: np.ndarray,
    grounded: np.ndarray,
    stamps: np.ndarray,
    row_period: float = 0.0,
) -> None:
    """Write voltages (N, L, E) V, grounded (L,), stamps (N,) s, and the scene's truth at these.

    The truth is JSON, a list of contacts for each frame. Beside these layout_id, drive_voltage (V),
    row_period (s), contact_law (coefficient, exponent), empty if none, and, where the rows of a
    frame differ in time, truth_last: the truth at the time of each frame's last row.
    """
    law = scene.contact_law
    last = stamps + row_period * (len(grounded) - 1)
    content = {
        "voltages": voltages.astype(np.float32),
        "grounded": grounded.astype(np.uint16),
        "stamps": stamps,
        "truth": json.dumps([scene.truth(t) for t in stamps]),
        "layout_id": layout.id,
        "drive_voltage": scene.drive_voltage,
        "row_period": float(row_period),
        "contact_law": law_entry(law),
    }
    if row_period > 0:
        content["truth_last"] = json.dumps([scene.truth(t) for t in last])
    save_arrays(path, content)


def law_entry(law: ContactLaw | None) -> list[float]:
    """A contact law as a file of frames or of results says it; empty: there is none."""
    return [] if law is None else [law.coefficient, law.exponent]


def save_arrays(path: str | os.PathLike, content: dict) -> None:
    """Write arrays as compressed `.npz`, whole or not at all."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **content)
    write_atomic(path, buffer.getvalue())


def _number(path, arrays, key: str, check: Callable[..., float], kind: str) -> float | None:
    """The number of that name, checked; None where there is none."""
    if key not in arrays:
        return None
    (value,) = _numbers(path, key, arrays[key], 1)
    return check(value, f"{path}: {key}", kind)


def _check_times(path: str | os.PathLike, stamps: np.ndarray | None, lasts: float) -> None:
    """Refuse rows that take far longer, s, than from one frame to the next: they are not in s."""
    steps = np.diff(np.empty(0) if stamps is None else stamps.astype(float))
    if not (steps > 0).any() or lasts <= _OVERLONG * (step := np.median(steps[steps > 0])):
        return
    raise InputError(
        f"{path}: row_period: the rows of a frame would take {plain(lasts)} s, and frames follow one another "
        f"after {plain(step)} s: row_period and stamps are in s"
    )


def _stamps(
    path: str | os.PathLike, arrays: dict[str, np.ndarray], frames: int
) -> np.ndarray | None:
    stamps = arrays.get("stamps")
    if stamps is None:
        return None
    if stamps.shape != (frames,) or stamps.dtype.kind not in "fiu" or not np.isfinite(stamps).all():
        raise InputError(f"{path}: stamps: a finite time is needed for each of {frames} frames, s")
    return stamps


def doubt_of(stamps: np.ndarray) -> str:
    """What to tell of (N,) stamps, s, that do not rise from frame to frame; empty where they do."""
    steps = np.diff(np.asarray(stamps, float))
    falls = np.flatnonzero(steps <= 0)
    if not falls.size:
        return ""
    first = int(falls[0])
    how = f"{plain(-steps[first])} s before" if steps[first] < 0 else "at the time of"
    return (
        f"stamps: {falls.size} of {len(stamps)} frames are not later than the one before, the first "
        f"is frame {first + 1}, {how} frame {first}; ids and ages of "
        "contacts are wrong there"
    )


def _contact_law(path: str | os.PathLike, arrays: dict[str, np.ndarray]) -> ContactLaw | None:
    if "contact_law" not in arrays or not arrays["contact_law"].size:
        return None
    numbers = _numbers(path, "contact_law", arrays["contact_law"], 2)
    with complaints_at(f"{path}: contact_law: "):
        return ContactLaw(*numbers)


def _numbers(path: str | os.PathLike, key: str, value: np.ndarray, count: int) -> list:
    """The values of an array that holds so many numbers."""
    array = np.ravel(value)
    if array.dtype.kind not in "fiu" or len(array) != count:
        what = "one number" if count == 1 else f"{count} numbers"
        raise InputError(f"{path}: {key}: {checks.show(array.tolist())} is not {what}")
    return array.tolist()

"""Files of arrays (`.npz`): recorded or simulated frames, and what the commands make of them."""

from __future__ import annotations

import io
import json
import math
import os
import struct
import zipfile
import zlib
from dataclasses import dataclass
from typing import IO

import numpy as np

from tomotactile_ros import checks
from tomotactile_ros.contact import ContactLaw
from tomotactile_ros.errors import InputError, complaints_at
from tomotactile_ros.files import open_regular, write_atomic
from tomotactile_ros.layout import Layout
from tomotactile_ros.scene import Scene

DEFAULT_DRIVE = 3.3  # V
MAX_BYTES = 4_000_000_000  # of all arrays together
MAX_GROWTH = 100  # times the size of the file; measured readings hardly compress at all
HARMLESS_BYTES = 256_000_000  # however much they were compressed
_LONGEST_HEADER = 10_000  # bytes, of numpy's arrays


@dataclass(frozen=True, eq=False)
class FramesFile:
    """What a file of frames says; None where it does not.

    Attributes
    ----------
    voltages, grounded : (N, L, E) V; (L,).
    drive_voltage : V.
    stamps : (N,) s.
    truth : for each frame a list of contacts, see `contacts_of`.
    contact_law : of the contacts.
    row_period : s; row i of a frame was taken at its stamp + i * row_period; 0 for all at once, and
        where the file says nothing.
    """

    voltages: np.ndarray
    grounded: np.ndarray
    drive_voltage: float | None = None
    stamps: np.ndarray | None = None
    truth: list[list[dict]] | None = None
    contact_law: ContactLaw | None = None
    row_period: float = 0.0


def load_frames(path: str | os.PathLike, layout_id: str | None = None) -> FramesFile:
    """Read frames of a layout, of any if None; InputError for anything else."""
    arrays = load_arrays(path)
    found = str(arrays.get("layout_id", layout_id))
    if layout_id not in (None, found):
        raise InputError(f"{path}: layout_id: the frames are of '{found}', not of '{layout_id}'")
    for name in ("voltages", "grounded"):
        if name not in arrays:
            raise InputError(f"{path}: {name}: is missing, a file of frames has it")
    voltages, grounded = arrays["voltages"], arrays["grounded"]
    if voltages.ndim != 3 or voltages.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: voltages: shape {voltages.shape}, frames x rows x electrodes are needed"
        )
    if not len(voltages):
        raise InputError(f"{path}: voltages: holds no frame")
    if np.isinf(voltages).any():
        raise InputError(f"{path}: voltages: one is infinite; NaN is what marks an invalid reading")
    _, rows, electrodes = voltages.shape
    if grounded.shape != (rows,) or not np.isin(grounded, np.arange(electrodes)).all():
        raise InputError(
            f"{path}: grounded: one of the electrodes 0 ... {electrodes - 1} is needed for each of "
            f"{rows} rows"
        )
    return FramesFile(
        voltages,
        grounded.astype(np.uint16),
        _drive_voltage(path, arrays),
        _stamps(path, arrays, len(voltages)),
        contacts_of(path, "truth", arrays["truth"]) if "truth" in arrays else None,
        _contact_law(path, arrays),
        _row_period(path, arrays),
    )


def load_arrays(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """All arrays of an `.npz` file; InputError for anything else, also for one too large."""
    try:
        with os.fdopen(open_regular(path, MAX_BYTES), "rb") as file:
            _check_sizes(path, file)
            with np.lib.npyio.NpzFile(file, allow_pickle=False) as content:
                arrays = {name: content[name] for name in content.files}
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except InputError:
        raise
    except (
        ValueError, EOFError, KeyError, RuntimeError, RecursionError, MemoryError,
        zipfile.BadZipFile, zlib.error, struct.error,
    ):  # fmt: skip
        raise InputError(f"{path}: is not a file of plain arrays (.npz)") from None
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):
            raise InputError(f"{path}: {checks.show(name)}: is not an array, the file is no .npz")
    return arrays


def _check_sizes(path: str | os.PathLike, file: IO[bytes]) -> None:
    """Refuse what grows beyond `MAX_BYTES`, and an array that says it is larger than it is."""
    with zipfile.ZipFile(file) as archive:
        total = sum(member.file_size for member in archive.infolist())
        packed = os.fstat(file.fileno()).st_size
        if total > MAX_BYTES or total > max(MAX_GROWTH * packed, HARMLESS_BYTES):
            raise InputError(
                f"{path}: {packed / 1e6:.3g} MB would grow to {total / 1e6:.4g} MB, "
                f"at most {MAX_BYTES / 1e6:.4g} MB and {MAX_GROWTH} times are read"
            )
        for member in archive.infolist():
            with archive.open(member) as stream:
                header = stream.read(_LONGEST_HEADER)
            declared = _declared_bytes(header)
            if declared is not None and declared > member.file_size:
                raise InputError(
                    f"{path}: {checks.show(member.filename)}: {declared / 1e6:.4g} MB are declared, "
                    f"{member.file_size / 1e6:.4g} MB are there"
                )
    file.seek(0)


def _declared_bytes(header: bytes) -> int | None:
    """Size of the array that begins so; None where it is no array."""
    stream = io.BytesIO(header)
    if header[:6] != b"\x93NUMPY":
        return None
    version = np.lib.format.read_magic(stream)
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(stream)
    return math.prod(shape) * dtype.itemsize


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
        "contact_law": [] if law is None else [law.coefficient, law.exponent],
    }
    if row_period > 0:
        content["truth_last"] = json.dumps([scene.truth(t) for t in last])
    save_arrays(path, content)


def save_arrays(path: str | os.PathLike, content: dict) -> None:
    """Write arrays as compressed `.npz`, whole or not at all."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **content)
    write_atomic(path, buffer.getvalue())


def _drive_voltage(path: str | os.PathLike, arrays: dict[str, np.ndarray]) -> float | None:
    if "drive_voltage" not in arrays:
        return None
    (volts,) = _numbers(path, "drive_voltage", arrays["drive_voltage"], 1)
    return checks.positive(volts, f"{path}: drive_voltage", "voltage in V")


def _row_period(path: str | os.PathLike, arrays: dict[str, np.ndarray]) -> float:
    if "row_period" not in arrays:
        return 0.0
    (seconds,) = _numbers(path, "row_period", arrays["row_period"], 1)
    return checks.not_negative(seconds, f"{path}: row_period", "time in s")


def _stamps(
    path: str | os.PathLike, arrays: dict[str, np.ndarray], frames: int
) -> np.ndarray | None:
    stamps = arrays.get("stamps")
    if stamps is None:
        return None
    if stamps.shape != (frames,) or stamps.dtype.kind not in "fiu" or not np.isfinite(stamps).all():
        raise InputError(f"{path}: stamps: a finite time is needed for each of {frames} frames, s")
    return stamps


def _contact_law(path: str | os.PathLike, arrays: dict[str, np.ndarray]) -> ContactLaw | None:
    if "contact_law" not in arrays or not arrays["contact_law"].size:
        return None
    numbers = _numbers(path, "contact_law", arrays["contact_law"], 2)
    with complaints_at(f"{path}: contact_law: "):
        return ContactLaw(*numbers)


def _numbers(path: str | os.PathLike, key: str, value: object, count: int) -> list:
    """The values of an array that holds so many numbers."""
    array = np.ravel(value)
    if array.dtype.kind not in "fiu" or len(array) != count:
        what = "one number" if count == 1 else f"{count} numbers"
        raise InputError(f"{path}: {key}: {checks.show(array.tolist())} is not {what}")
    return array.tolist()

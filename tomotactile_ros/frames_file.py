"""Files of arrays (`.npz`): recorded or simulated frames, and what the commands make of them."""

from __future__ import annotations

import io
import json
import os
import zipfile
import zlib
from dataclasses import dataclass

import numpy as np

from tomotactile_ros import checks
from tomotactile_ros.contact import ContactLaw
from tomotactile_ros.errors import InputError, complaints_at
from tomotactile_ros.files import write_atomic
from tomotactile_ros.layout import Layout
from tomotactile_ros.scene import Scene

DEFAULT_DRIVE = 3.3  # V


@dataclass(frozen=True, eq=False)
class FramesFile:
    """voltages (N, L, E) V, grounded (L,), and what else is known (None otherwise)."""

    voltages: np.ndarray
    grounded: np.ndarray
    drive_voltage: float
    truth: list[list[dict]] | None
    contact_law: ContactLaw | None


def load_frames(
    path: str | os.PathLike, layout: Layout, drive_voltage: float | None = None
) -> FramesFile:
    """Read frames of a layout; InputError for anything else.

    `drive_voltage` (V) stands for the file's own.
    """
    arrays = load_arrays(path)
    layout_id = str(arrays.get("layout_id", layout.id))
    if layout_id != layout.id:
        raise InputError(
            f"{path}: layout_id: the frames are of '{layout_id}', not of '{layout.id}'"
        )
    for name in ("voltages", "grounded"):
        if name not in arrays:
            raise InputError(f"{path}: {name}: is missing, a file of frames has it")
    voltages, grounded = arrays["voltages"], arrays["grounded"]
    if voltages.ndim != 3 or voltages.dtype.kind not in "fiu" or not len(voltages):
        raise InputError(
            f"{path}: voltages: shape {voltages.shape}, frames x rows x electrodes are needed"
        )
    if np.isinf(voltages).any():
        raise InputError(f"{path}: voltages: one is infinite; NaN is what marks an invalid reading")
    if grounded.shape != voltages.shape[1:2] or grounded.dtype.kind not in "iu":
        raise InputError(
            f"{path}: grounded: one electrode for each of {voltages.shape[1]} rows is needed"
        )
    if drive_voltage is None:
        (drive_voltage,) = _numbers(
            path, "drive_voltage", arrays.get("drive_voltage", DEFAULT_DRIVE), 1
        )
    return FramesFile(
        voltages,
        grounded,
        checks.positive(drive_voltage, f"{path}: drive_voltage", "voltage in V"),
        contacts_of(path, "truth", arrays["truth"]) if "truth" in arrays else None,
        _contact_law(path, arrays),
    )


def load_arrays(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """All arrays of an `.npz` file; InputError for anything else."""
    try:
        with open(path, "rb") as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, EOFError, KeyError, RuntimeError, zipfile.BadZipFile, zlib.error):
        raise InputError(f"{path}: is not a file of plain arrays (.npz)") from None
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):
            raise InputError(f"{path}: {name}: is not an array, the file is no .npz")
    return arrays


def contacts_of(path: str | os.PathLike, key: str, text: object) -> list[list[dict]]:
    """Contacts of every frame from their JSON text: x, y in m and force in N or None, and more."""
    try:
        frames = json.loads(str(text))
        for contact in [contact for frame in frames for contact in frame]:
            checks.pair((contact["x"], contact["y"]), "center", "position in m")
            if contact["force"] is not None:
                checks.number(contact["force"], "force", "force in N")
    except (ValueError, TypeError, KeyError):
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
) -> None:
    """Write voltages (N, L, E) V, grounded (L,), stamps (N,) s, and the scene's truth at these.

    The truth is JSON, a list of contacts for each frame. Beside these layout_id, drive_voltage (V)
    and contact_law (coefficient, exponent), empty if none.
    """
    law = scene.contact_law
    content = {
        "voltages": voltages.astype(np.float32),
        "grounded": grounded.astype(np.uint16),
        "stamps": stamps,
        "truth": json.dumps([scene.truth(t) for t in stamps]),
        "layout_id": layout.id,
        "drive_voltage": scene.drive_voltage,
        "contact_law": [] if law is None else [law.coefficient, law.exponent],
    }
    save_arrays(path, content)


def save_arrays(path: str | os.PathLike, content: dict) -> None:
    """Write arrays as compressed `.npz`, whole or not at all."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **content)
    write_atomic(path, buffer.getvalue())


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

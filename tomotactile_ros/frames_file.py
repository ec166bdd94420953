"""Recorded or simulated frames in an `.npz` file."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass

import numpy as np

from tomotactile_ros import checks
from tomotactile_ros.contact import ContactLaw
from tomotactile_ros.errors import InputError

DEFAULT_DRIVE = 3.3  # V


@dataclass(frozen=True, eq=False)
class FramesFile:
    """voltages (N, L, E) V, grounded (L,), stamps (N,) s, and what else is known (None otherwise)."""

    voltages: np.ndarray
    grounded: np.ndarray
    stamps: np.ndarray
    drive_voltage: float
    truth: list | None
    contact_law: ContactLaw | None
    layout_id: str | None


def load_frames(path, drive_voltage: float | None = None) -> FramesFile:
    """Read `path`; `drive_voltage` (V) stands for the file's own. Raises InputError for anything else."""
    try:
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or 'no .npz file'}") from None
    except (ValueError, EOFError, zipfile.BadZipFile, AttributeError, KeyError):
        raise InputError(f"{path}: is not a file of frames (.npz)") from None
    for name in ("voltages", "grounded"):
        if name not in arrays:
            raise InputError(f"{path}: {name}: is missing, a file of frames has it")
    voltages, grounded = arrays["voltages"], arrays["grounded"]
    if voltages.ndim != 3 or voltages.dtype.kind not in "fiu" or not len(voltages):
        raise InputError(f"{path}: voltages: shape {voltages.shape}, frames x rows x electrodes are needed")
    if grounded.shape != voltages.shape[1:2] or grounded.dtype.kind not in "iu":
        raise InputError(f"{path}: grounded: one electrode for each of {voltages.shape[1]} rows is needed")
    drive = drive_voltage if drive_voltage is not None else arrays.get("drive_voltage", DEFAULT_DRIVE)
    law = np.ravel(arrays.get("contact_law", []))
    layout_id = str(arrays["layout_id"]) if "layout_id" in arrays else None
    return FramesFile(
        voltages,
        grounded,
        np.asarray(arrays.get("stamps", np.arange(len(voltages)))),
        checks.positive(np.asarray(drive).item(), f"{path}: drive_voltage", "voltage in V"),
        _truth(path, arrays.get("truth")),
        ContactLaw(*map(float, law)) if len(law) == 2 else None,
        layout_id,
    )


def _truth(path, text):
    if text is None:
        return None
    try:
        return json.loads(str(text))
    except ValueError:
        raise InputError(f"{path}: truth: is not JSON") from None

"""The tare of a sensor in a file, so that it survives a crash of whoever uses it."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from tomotactile_ros.frames_file import load_arrays, save_arrays
from tomotactile_ros.support.errors import InputError

_BOOT = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True)
class Tare:
    """What an untouched sheet reads.

    Attributes
    ----------
    layout_id : of the layout that it was read with.
    baseline : (E, E) V, row i with electrode i grounded.
    frames : how many were averaged.
    stamp : s, Unix time.
    boot : names the run of the machine it was made in; empty where that is not known.
    """

    layout_id: str
    baseline: np.ndarray
    frames: int
    stamp: float
    boot: str

    def save(self, path: str | os.PathLike) -> None:
        """Write it, whole or not at all; its folder is made."""
        try:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        save_arrays(path, vars(self))


ARRAYS = frozenset(each.name for each in fields(Tare))  # of the file


def this_boot() -> str:
    """Names the present run of the machine; empty where it does not say."""
    try:
        return _BOOT.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def is_tare(path: str | os.PathLike) -> bool:
    """Whether it is a file of a tare, of whatever layout."""
    try:
        return load_arrays(path).keys() >= ARRAYS
    except InputError:
        return False


def load_tare(path: str | os.PathLike, layout_id: str, electrodes: int) -> Tare:
    """The tare of a layout; InputError for anything else."""
    arrays = load_arrays(path)
    try:
        found = Tare(
            str(arrays["layout_id"]),
            np.array(arrays["baseline"], float),
            int(arrays["frames"]),
            float(arrays["stamp"]),
            str(arrays["boot"]),
        )
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path}: is no file of a tare") from None
    if found.layout_id != layout_id:
        raise InputError(f"{path}: is the tare of '{found.layout_id}', not of '{layout_id}'")
    if found.baseline.shape != (electrodes, electrodes) or np.isinf(found.baseline).any():
        raise InputError(f"{path}: baseline: is none of {electrodes} electrodes")
    return found

"""Writes `.npz` files of any length in little memory: arrays grow entry by entry on the disk.

An `.npz` is a zip of `.npy` files, whose header says how many entries there are. That is known at
the end only: until then each array is a temporary file of bare numbers beside the result.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

import numpy as np

from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import atomic_file, check_folder

_PIECE = 1 << 20


@contextmanager
def npz_writer(path: str | os.PathLike) -> Iterator[NpzWriter]:
    """A writer whose file is there at the end, whole or, where something was raised, not at all.

    Raises
    ------
    InputError
        It cannot be written there.
    """
    check_folder(path)
    writer = NpzWriter(path)
    try:
        yield writer
        writer.finish()
    finally:
        writer.close()


class NpzWriter:
    """Arrays on their way into a file, see `npz_writer`."""

    def __init__(self, path: str | os.PathLike) -> None:
        self._path = path
        self._grown: dict[str, _Growing] = {}
        self._whole: dict[str, np.ndarray] = {}

    def append(self, **entries: object) -> None:
        """Add one entry to each of these arrays; all entries of one have one shape and type."""
        for name, entry in entries.items():
            self._extend(name, np.asarray(entry)[None])

    def append_text(self, **pieces: str) -> None:
        """Go on with each of these texts, which are arrays of one entry in the file."""
        for name, piece in pieces.items():
            self._extend(name, np.array(list(piece), "<U1"))

    def _extend(self, name: str, entries: np.ndarray) -> None:
        try:
            if name not in self._grown:
                self._grown[name] = _Growing(entries, Path(os.path.realpath(self._path)).parent)
            self._grown[name].extend(entries)
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written: {error.strerror}") from None

    def put(self, **arrays: object) -> None:
        """Add whole arrays."""
        self._whole.update({name: np.asarray(array) for name, array in arrays.items()})

    def close(self) -> None:
        """Remove what was kept on the way."""
        for grown in self._grown.values():
            with suppress(OSError):  # what a full disk does not take is thrown away here anyway
                grown.file.close()

    def finish(self) -> None:
        """Write the file."""
        try:
            self._finish()
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written: {error.strerror}") from None

    def _finish(self) -> None:
        with (
            atomic_file(self._path) as file,
            zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive,
        ):
            for name, array in self._whole.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)
            for name, grown in self._grown.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    grown.write_to(member)


class _Growing:
    """An array whose entries, or a text whose characters, are in a file."""

    def __init__(self, first: np.ndarray, folder: Path) -> None:
        self.file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed by the writer
        self._dtype, self._shape = first.dtype, first.shape[1:]
        self._length = 0

    def extend(self, entries: np.ndarray) -> None:
        if entries.shape[1:] != self._shape:
            raise ValueError(f"an entry of shape {entries.shape[1:]} among those of {self._shape}")
        self.file.write(np.ascontiguousarray(entries, self._dtype).tobytes())
        self._length += len(entries)

    def write_to(self, member: IO[bytes]) -> None:
        """The array in the format of numpy."""
        shape, dtype = (self._length, *self._shape), self._dtype
        if dtype.kind == "U":
            shape, dtype = (), np.dtype(f"<U{max(self._length, 1)}")
        header = {
            "descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape,
        }  # fmt: skip
        np.lib.format.write_array_header_1_0(member, header)
        self.file.seek(0)
        shutil.copyfileobj(self.file, member, _PIECE)

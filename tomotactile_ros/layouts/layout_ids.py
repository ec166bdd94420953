"""What frames call their layout: its name and a short hash of its geometry, ``name#1a2b3c4d``.

Two different files that are both called ``optimized`` thereby never match. Recordings and drivers
from before the hash give the bare name, which is taken with a warning.
"""

import hashlib
from collections.abc import Sequence

import numpy as np

from tomotactile_ros.support.errors import doubt

_MARK = "#"
_DIGITS = 8
_PARTS = 1e9  # of a metre: lengths that differ by less than 1 nm are the same


def make_id(name: str, kind: str, lengths: Sequence[np.ndarray]) -> str:
    """The id of a layout: its name, and a hash of words and arrays of lengths (m)."""
    digest = hashlib.sha256(kind.encode())
    for array in lengths:
        whole = np.rint(np.asarray(array, dtype=float) * _PARTS).astype("<i8")
        digest.update(f"{whole.shape}".encode() + whole.tobytes())
    return f"{name}{_MARK}{digest.hexdigest()[:_DIGITS]}"


def is_bare(found: str, expected: str) -> bool:
    """Whether `found` is the name of the layout `expected` without the hash."""
    return found == expected.rpartition(_MARK)[0]


def matches(found: str, expected: str) -> bool:
    """Whether frames of `found` may be of the layout `expected`."""
    return found == expected or is_bare(found, expected)


def note_bare(found: str, expected: str, where: object) -> None:
    """Say so, if a recording (`where`) only names its layout."""
    if is_bare(found, expected):
        doubt(
            f"{where}: names its layout '{found}' without the hash of its geometry (now {expected}): "
            "whether they are the same cannot be told"
        )

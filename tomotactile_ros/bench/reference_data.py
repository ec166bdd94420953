"""Reference data of the benchmark: made once by `reference`, kept as one npz file for each family.

    packed     (S, E (E + 1) / 2) float32, `Admittance.packed` of each state
    states     JSON, for each state {"case": words, "contacts": [`reference_cases.truth`]}
    layout     JSON: name, outline, sheet_resistance, radius, positions (E, 2)

Gains, offsets, resistances to ground, noise and converters are not in them: they follow by formula.
`bench.sensor.states` makes and reads them.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tomotactile_ros.layouts.layout import FORMAT, Layout, load_layout
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import shared_folders, write_atomic
from tomotactile_ros.support.yamlio import plain

FOLDER = Path("benchmark/data")


def write(path: str | os.PathLike, layout: Layout, arrays: dict, texts: dict) -> None:
    """Write arrays and what JSON says; an existing file is replaced whole or not at all."""
    keys = "name", "sheet_resistance", "radius", "positions"
    words = {key: getattr(layout, key) for key in keys} | {"outline": layout.outline.to_dict()}
    every = texts | {"layout": words}
    texts = {key: np.array(json.dumps(plain(value))) for key, value in every.items()}
    file = io.BytesIO()
    np.savez_compressed(file, **arrays, **texts)
    write_atomic(path, file.getvalue())


def read(
    name: str | os.PathLike, arrays: Sequence[str], texts: Sequence[str], folder: Path = FOLDER
) -> tuple[Layout, dict]:
    """The layout, and what is under these keys in a file by `write`, by its path or by its name in
    a shared `folder`."""
    folders = [each / folder for each in shared_folders()]
    paths = [Path(name), *(each / f"{os.fspath(name)}.npz" for each in folders)]
    path = next((each for each in paths if each.is_file()), None)
    if path is None:
        known = sorted({each.stem for folder in folders for each in folder.glob("*.npz")})
        raise InputError(
            f"{name}: no such file of reference data, and none of {', '.join(known) or '-'}"
        )
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {key: file[key] for key in arrays}
            found |= {key: json.loads(str(file[key])) for key in (*texts, "layout")}
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: is not a file of reference data: {error}") from None
    words = found.pop("layout")
    electrodes = {key: words.pop(key) for key in ("radius", "positions")}
    return load_layout(path, {"format": FORMAT, **words, "electrodes": electrodes}), found

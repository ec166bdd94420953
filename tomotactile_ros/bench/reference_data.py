"""Reference data of the benchmark: made once by `reference`, kept as one npz file for each family.

    packed     (S, E (E + 1) / 2) float32, `Admittance.packed` of each state
    states     JSON, for each state {"case": words, "contacts": [`reference_cases.truth`]}
    layout     JSON: name, outline, sheet_resistance, radius, positions (E, 2)

Gains, offsets, resistances to ground, noise and converters are not in them: they follow by formula.
`bench.sensor.states` reads them.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tomotactile_ros.bench.reference import ReferenceSheet
from tomotactile_ros.bench.reference_cases import Family, truth
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.scenes.sheet_field import conductance_of
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import shared_folders, write_atomic
from tomotactile_ros.support.yamlio import plain

FOLDER = Path("benchmark/data")


def make(family: Family, path: str | os.PathLike, h: float | None = None) -> None:
    """Solve all states of a family and write them; an existing file is replaced whole or not at all."""
    layout = family.layout
    models = [
        ReferenceSheet(layout, conductance_of(layout, s.field, s.variation), h=h)
        for s in family.sheets
    ]
    packed, states = [], []
    for state in family.states:
        contacts = [(press.shape, press.conductance) for press in state.contacts]
        packed.append(models[state.sheet].solve(contacts).packed)
        truths = [truth(press, layout.outline) for press in state.contacts]
        states.append({"case": state.case, "contacts": truths})
    write(path, layout, {"packed": np.array(packed, np.float32)}, {"states": states})


def write(path: str | os.PathLike, layout: Layout, arrays: dict, texts: dict) -> None:
    """Write arrays and what JSON says; an existing file is replaced whole or not at all."""
    words = {
        "name": layout.name,
        "outline": layout.outline.to_dict(),
        "sheet_resistance": layout.sheet_resistance,
        "radius": layout.radius,
        "positions": layout.positions,
    }
    texts = {
        key: np.array(json.dumps(plain(value)))
        for key, value in (texts | {"layout": words}).items()
    }
    file = io.BytesIO()
    np.savez_compressed(file, **arrays, **texts)
    write_atomic(path, file.getvalue())


def read(
    path: str | os.PathLike, arrays: Sequence[str], texts: Sequence[str]
) -> tuple[Layout, dict]:
    """The layout, and what is in a file by `write` under these keys."""
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {key: file[key] for key in arrays}
            found |= {key: json.loads(str(file[key])) for key in (*texts, "layout")}
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: is not a file of reference data: {error}") from None
    return _layout(found.pop("layout")), found


def names(folder: Path = FOLDER) -> list[str]:
    """Files of data in a shared `folder`: of families, if not said otherwise."""
    return sorted(
        {path.stem for each in shared_folders() for path in (each / folder).glob("*.npz")}
    )


def find(name: str | os.PathLike, folder: Path = FOLDER) -> Path:
    """A file of data by its path or by its name in a shared `folder`."""
    named = [each / folder / f"{os.fspath(name)}.npz" for each in shared_folders()]
    for path in (Path(name), *named):
        if path.is_file():
            return path
    raise InputError(
        f"{name}: no such file of reference data, and none of {', '.join(names(folder)) or '-'}"
    )


def _layout(content) -> Layout:
    outline = dict(content["outline"])
    holes = outline.pop("holes", ())
    [(kind, form)] = outline.items()
    sizes = form if kind == "rectangle" else [form]
    return Layout(
        content["name"],
        getattr(Outline, kind)(*sizes, holes=holes),
        content["sheet_resistance"],
        content["radius"],
        np.array(content["positions"]),
    )

"""Reference data of the benchmark: made once by `reference`, kept as one npz file for each family.

    packed     (S, E (E + 1) / 2) float32, `Admittance.packed` of each state
    sheet      (S,) number of the sheet that the state is one of
    untouched  (sheets, E (E + 1) / 2) float32, of each sheet without contacts
    states     JSON, for each state {"case": words, "contacts": [`reference_cases.truth`]}
    sheets     JSON, for each sheet its words and what is uneven about it
    layout     JSON: name, outline, sheet_resistance, radius, positions (E, 2)
    made       JSON: how

Gains, offsets, resistances to ground, noise and converters are not in them: they follow by formula.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.bench.reference import Admittance, ReferenceSheet, reference_frame
from tomotactile_ros.bench.reference_cases import Family, truth
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.scenes.sheet_field import conductance_of
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import shared_folders, write_atomic
from tomotactile_ros.support.yamlio import plain

FOLDER = Path("benchmark/data")


@dataclass(frozen=True, eq=False)
class ReferenceData:
    """States of the sheets of one layout, and what presses in each; keys as in the file."""

    name: str
    layout: Layout
    packed: np.ndarray
    sheet: np.ndarray
    untouched: np.ndarray
    states: list[dict]
    sheets: list[dict]
    made: dict

    def __len__(self) -> int:
        return len(self.packed)

    def cases(self) -> dict[str, np.ndarray]:
        """Numbers of the states of each case, in the order of the file."""
        names = [state["case"] for state in self.states]
        return {
            name: np.flatnonzero([each == name for each in names]) for name in dict.fromkeys(names)
        }

    def state(self, number: int) -> Admittance:
        """What the electrodes see."""
        return Admittance.unpack(self.packed[number])

    def frame(
        self,
        number: int,
        drive_voltage: float,
        *,
        ground_resistance: ArrayLike = 0.0,
        grounded: ArrayLike | None = None,
    ) -> np.ndarray:
        """(L, E) voltages of a state, V, before channels and noise; see `reference_frame`."""
        return reference_frame(
            self.state(number),
            drive_voltage,
            ground_resistance=ground_resistance,
            grounded=grounded,
        )


def make(
    family: Family, h: float | None = None, progress: Callable[[int], None] = lambda done: None
) -> ReferenceData:
    """Solve all states of a family; `progress` gets the number of those done."""
    models = [
        ReferenceSheet(family.layout, conductance_of(family.layout, s.field, s.variation), h=h)
        for s in family.sheets
    ]
    packed = []
    for state in family.states:
        contacts = [(press.shape, press.conductance) for press in state.contacts]
        packed.append(models[state.sheet].solve(contacts).packed)
        progress(len(packed))
    return ReferenceData(
        family.name,
        family.layout,
        np.array(packed, np.float32),
        np.array([state.sheet for state in family.states], np.int32),
        np.array([model.solve([]).packed for model in models], np.float32),
        [_described(state, family.layout) for state in family.states],
        [_sheet_words(sheet) for sheet in family.sheets],
        {"model": "reference", "h": models[0].h},
    )


def _described(state, layout):
    contacts = [truth(press, layout.outline) for press in state.contacts]
    return {"case": state.case, "contacts": contacts}


def _sheet_words(sheet):
    content = {"case": sheet.words}
    if sheet.variation is not None:
        content["sheet_variation"] = dataclasses.asdict(sheet.variation)
    for key, value in vars(sheet.field).items():
        if value:
            content[key] = dataclasses.asdict(value)
    return content


def save(data: ReferenceData, path: str | os.PathLike) -> None:
    """Write a family; an existing file is replaced whole or not at all."""
    arrays = {"packed": data.packed, "sheet": data.sheet, "untouched": data.untouched}
    texts = {"states": data.states, "sheets": data.sheets, "made": data.made}
    write(path, data.layout, arrays, texts)


def load(name: str | os.PathLike) -> ReferenceData:
    """Read a family by its name or by the path of its file."""
    path = find(name)
    arrays, texts = ("packed", "sheet", "untouched"), ("states", "sheets", "made")
    layout, content = read(path, arrays, texts)
    return ReferenceData(path.stem, layout, **content)


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

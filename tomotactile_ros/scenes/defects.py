"""What is wrong with a measurement: noise, conversion, drift, hum, wiring, uneven sheet.

Only the descriptions, and how they are read from a scene file; the simulation applies them.
"""

import dataclasses
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from tomotactile_ros.layouts.layout import OUTLINE, Layout, read_outline
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.scenes.channels import Channels, read_channels
from tomotactile_ros.scenes.sheet_field import SheetField, SheetVariation
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import Reader, keys_of, mapping_of


@dataclass(frozen=True)
class Noise:
    """Gaussian noise of every reading: ``rms`` in V, and the seed of the random numbers."""

    rms: float
    seed: int = 0

    def __post_init__(self):
        checks.not_negative(self.rms, "rms", "voltage in V")
        _check_seed(self.seed)


@dataclass(frozen=True)
class Adc:
    """Analog-digital conversion: 2^bits steps from 0 V to ``range`` V."""

    bits: int
    range: float

    def __post_init__(self):
        checks.integer(self.bits, "bits", 1, 32)
        checks.positive(self.range, "range", "voltage in V")


@dataclass(frozen=True)
class Drift:
    """Slow wandering of the readings: ``amplitude`` in V, ``period`` in s, seed of its phases."""

    amplitude: float
    period: float
    seed: int = 0

    def __post_init__(self):
        checks.not_negative(self.amplitude, "amplitude", "voltage in V")
        checks.positive(self.period, "period", "time in s")
        _check_seed(self.seed)


@dataclass(frozen=True)
class Hum:
    """Mains hum on the readings: ``amplitude`` in V, ``frequency`` in Hz."""

    amplitude: float
    frequency: float

    def __post_init__(self):
        checks.not_negative(self.amplitude, "amplitude", "voltage in V")
        checks.positive(self.frequency, "frequency", "number of Hz")


@dataclass(frozen=True)
class Defects:
    """What is wrong with the sensor; each part is modelled only if it is named.

    Parameters
    ----------
    dead : electrodes without a valid reading.
    swapped : pairs of electrodes whose wires are exchanged.
    drift, hum, sheet_variation : see there; None for none.
    switch_resistance : between the grounded electrode and ground, ohm.
    outline : of the sheet as it was cut, where it is not that of the layout.
    holes : polygons [[x, y], ...] in it, m, beside those that the outline has.
    electrode_radius : of the electrodes as they were printed, m, the same.
    sheet, channels : what else is wrong with the sheet; with the readings, and what lies between
        each electrode and ground. In a scene file their keys stand beside the others.
    """

    dead: tuple[int, ...] = ()
    swapped: tuple[tuple[int, int], ...] = ()
    drift: Drift | None = None
    hum: Hum | None = None
    switch_resistance: float = 0.0
    sheet_variation: SheetVariation | None = None
    outline: Outline | None = None
    holes: tuple[np.ndarray, ...] = ()
    electrode_radius: float | None = None
    sheet: SheetField = field(default_factory=SheetField)
    channels: Channels = field(default_factory=Channels)

    def __post_init__(self):
        checks.not_negative(self.switch_resistance, "switch_resistance", "resistance in ohm")
        if self.electrode_radius is not None:
            checks.length(self.electrode_radius, "electrode_radius")
        wires = [wire for pair in self.swapped for wire in pair]
        for key, numbers in (("dead", self.dead), ("swapped", wires)):
            if len(set(numbers)) < len(numbers):
                raise InputError(f"{key}: {checks.show(list(numbers))} names an electrode twice")
            if min(numbers, default=0) < 0:
                raise InputError(f"{key}: {min(numbers)} is not an electrode, they count from 0")

    def made(self, layout: Layout) -> Layout:
        """The sensor as it was made after `layout`; InputError where electrodes do not lie on that."""
        if self.outline is None and not self.holes and self.electrode_radius is None:
            return layout
        outline = layout.outline if self.outline is None else self.outline
        radius = layout.radius if self.electrode_radius is None else self.electrode_radius
        try:
            holes = *outline.holes, *self.holes
            outline = dataclasses.replace(outline, holes=holes)
            return dataclasses.replace(layout, outline=outline, radius=radius)
        except InputError as error:
            raise InputError(f"defects: {layout.name} as it was made: {error}") from None


def _check_seed(seed: int) -> None:
    checks.integer(seed, "seed", 0, 2**32 - 1)


def by_key(defects: Defects) -> dict[str, object]:
    """Everything that a scene file can name, under its key there; falsy where the sensor does not have it."""
    everything = {**vars(defects), **vars(defects.sheet), **vars(defects.channels)}
    return {key: each for key, each in everything.items() if key not in ("sheet", "channels")}


def named_defects(defects: Defects) -> dict[str, object]:
    """What a scene file says of all defects that there are."""
    return {key: _content(each) for key, each in by_key(defects).items() if each}


def _content(value):
    if isinstance(value, tuple):
        return [_content(each) for each in value]
    if isinstance(value, Outline):
        return value.to_dict()
    return mapping_of(value) if dataclasses.is_dataclass(value) else value


def read_defects(reader: Reader) -> Defects:
    """The defects in a mapping of a scene file."""
    parts = {"sheet": SheetField, "channels": Channels}
    reader.only(*keys_of(Defects, *parts), *chain(*map(keys_of, parts.values())))
    swapped = []
    for key, entry in reader.entries("swapped"):
        swapped.append(entry.integers(key))
        if len(swapped[-1]) != 2:
            reader.refuse(key, list(swapped[-1]), "is not a pair of electrodes")
    outline = None
    if "outline" in reader:
        outline = read_outline(reader.section("outline", OUTLINE), False)
    return reader.build(
        Defects,
        **reader.values(Defects, "swapped", "outline", "holes", *parts),
        swapped=tuple(swapped),
        outline=outline,
        holes=tuple(entry.points(key) for key, entry in reader.entries("holes")),
        sheet=SheetField(**reader.values(SheetField)),
        channels=read_channels(reader),
    )

"""What touches the sheet and what is wrong with the measurement; YAML in and out.

Anything a scene does not name is not modelled.
"""

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.region import FAR_OFF
from tomotactile_ros.scenes.contact import Contact, read_contact
from tomotactile_ros.scenes.contact_law import ContactLaw
from tomotactile_ros.scenes.defects import (
    Adc,
    Defects,
    Noise,
    named_defects,
    read_defects,
)
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError, doubt, printable
from tomotactile_ros.support.files import find_config
from tomotactile_ros.support.yamlio import Reader, keys_of, mapping_of, write_mapping

FORMAT = "tomotactile-scene/1"
MAX_CONTACTS = 1000  # over all times
_HIGH = 100.0  # V: nobody drives a sheet for fingers with so much; millivolts do


@dataclass(frozen=True, eq=False)
class Scene:
    """What a sensor measures: contacts, drive and defects.

    Parameters
    ----------
    name : for people.
    drive_voltage : of the driving layer, V.
    contacts : any number, also none; they may coincide.
    contact_law : makes a pressure a conductance; None: all contacts are bare conductors at the
        drive voltage and their pressure is only part of the truth.
    live : whether contacts also come from outside while the scene is simulated, see `touches`.
    noise, adc, defects : of the measurement.
    own_reading : the grounded electrode is read, too: what drops between it and ground.
    layout : name of the layout that the scene was made for, or None for any.
    """

    name: str
    drive_voltage: float
    contacts: tuple[Contact, ...] = ()
    contact_law: ContactLaw | None = None
    noise: Noise | None = None
    adc: Adc | None = None
    defects: Defects = field(default_factory=Defects)
    layout: str | None = None
    live: bool = False
    own_reading: bool = False

    def __post_init__(self):
        drive = checks.positive(self.drive_voltage, "drive_voltage", "voltage in V")
        if drive > _HIGH:
            doubt(
                f"scene {self.name}: drive_voltage: {drive:g} V is high for a sheet that is touched; "
                f"was {drive:g} mV meant? That is {drive / 1e3:g}"
            )
        contacts = tuple(contact.under(self.contact_law) for contact in self.contacts)
        object.__setattr__(self, "contacts", contacts)

    def check(self, layout: Layout) -> None:
        """Refuse a layout that the scene does not fit."""
        place = f"scene {self.name}: "
        if self.layout is not None and self.layout != layout.name:
            raise InputError(
                f"{place}layout: the scene is for '{self.layout}', not for '{layout.name}'"
            )
        for i, contact in enumerate(self.contacts):
            if not _reaches(contact, layout):
                far = np.abs(contact.centroid).max() > FAR_OFF * max(layout.outline.size)
                in_mm = far and layout.outline.contains(contact.centroid[None] / 1e3).all()
                raise InputError(
                    f"{place}contacts[{i}]: never touches the sheet of {layout.name}"
                    + ("; is it in mm? Lengths are in m" if in_mm else "")
                )
        wires = [wire for pair in self.defects.swapped for wire in pair]
        for key, numbers in (("dead", self.defects.dead), ("swapped", wires)):
            if max(numbers, default=0) >= layout.electrodes:
                raise InputError(
                    f"{place}defects.{key}: electrode {max(numbers)} does not exist, "
                    f"{layout.name} has 0 to {layout.electrodes - 1}"
                )
        self.defects.channels.check(layout.electrodes, f"{place}defects.")

        self.defects.sheet.check(layout, f"{place}defects.")

    def truth(self, t: float) -> list[dict]:
        """What really touches at the time ``t`` (s), in the order of the scene.

        For each contact x, y (centroid, m), force (N), pressure (peak, Pa; of a punch, whose rim
        has no finite one, the mean), area (m²) and radius (of the disc of the same area, m); force
        and pressure are None where the scene names neither.
        """
        return [described(now) for contact in self.contacts if (now := contact.at(t)) is not None]

    def save(self, path: str | os.PathLike) -> None:
        """Write the scene as YAML; an existing file is replaced whole or not at all."""
        content = {"format": FORMAT, "drive_voltage": float(self.drive_voltage)}
        if self.own_reading:
            content["own_reading"] = True
        if self.layout is not None:
            content["layout"] = self.layout
        if self.live:
            content["live"] = True
        content["contacts"] = [contact.to_dict() for contact in self.contacts]
        for key in ("contact_law", "noise", "adc"):
            if getattr(self, key) is not None:
                content[key] = mapping_of(getattr(self, key))
        defects = named_defects(self.defects)
        if defects:
            content["defects"] = defects
        write_mapping(path, content)


def load_scene(path: str | os.PathLike, content: dict | None = None) -> Scene:
    """Read a scene from a path, or by the name of an installed one.

    ``content`` is the file's mapping where it was read already.
    """
    path = find_config("scenes", path)
    reader = Reader.open(path, FORMAT, content=content)
    reader.only("format", *keys_of(Scene, "name"))
    count = len(reader.items("contacts", []))
    if count > MAX_CONTACTS:
        raise InputError(f"{reader.place}contacts: {count} are named, at most {MAX_CONTACTS} work")
    return reader.build(
        Scene,
        name=printable(Path(path).stem),
        **reader.values(Scene, "name", "contacts", "defects"),
        contacts=[read_contact(contact) for contact in reader.sections("contacts")],
        defects=read_defects(reader.section("defects")) if "defects" in reader else Defects(),
    )


def _reaches(contact: Contact, layout: Layout) -> bool:
    """Whether the contact touches the sheet at any time."""
    farthest = np.linalg.norm(contact.vertices, axis=1).max() + np.linalg.norm(layout.outline.size)
    return any(layout.outline.is_met_by(*leg) for leg in contact.legs(2 * farthest))


def described(contact: Contact) -> dict:
    """An entry of `Scene.truth`."""
    x, y = contact.centroid
    return {
        "x": float(x),
        "y": float(y),
        "force": contact.total_force,
        "pressure": contact.peak_pressure,
        "area": contact.area,
        "radius": math.sqrt(contact.area / math.pi),
    }

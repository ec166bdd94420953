"""Errors of voltages and of places where one thing of an ordinary set-up is extreme.

Ordinary are 8 x 8 electrodes on 200 mm x 200 mm, one contact of 5 mm radius, 1 mV of noise, 12
bits, 20 x 20 pixels. Voltages, V per V of drive, are compared with those of another sheet model;
places, in parts of the longer side, with the true one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, PRESSURE, record
from tomotactile_ros.contact import Contact, ContactLaw
from tomotactile_ros.defects import Adc, Defects, Noise
from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import Layout, equal_grid
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scene import Scene
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.contacts import contact_points
from tomotactile_ros.sheet.frames import frame

PLACE = np.array([0.13, -0.21])  # of the contact, in parts of the sides
CELLS = 20
_CORNER = np.array([0.38, -0.36])  # the same, near one of 2 x 2 electrodes


def grid(side=0.2, count=8, resistance=1e4, size=None) -> Layout:
    """An ordinary layout but for what is said."""
    size = size or (side, side)
    return equal_grid(count, count, size, 0.1 * min(size) / count, resistance)


def voltages(layout: Layout, conductance: float, model: str, place=PLACE) -> np.ndarray:
    """(E, E) of a contact of 1/40 of the shorter side, V per V of drive."""
    size = np.array(layout.outline.size)
    contact = Contact("disc", center=place * size, radius=size.min() / 40)
    sheet = make_sheet(layout, model, h=max(size.min() / 40, size.max() / 400))
    return frame(*contact_points(sheet, [(contact.patches(), conductance)]), 1.0)


def voltage_by_resistance(resistance: float) -> float:
    """Bare contacts: the sheet resistance changes no voltage."""
    layouts = grid(resistance=resistance), grid()
    return _apart(*(voltages(layout, np.inf, "closed_form") for layout in layouts))


def voltage_by_conductance(conductance: float) -> float:
    return _models_apart(grid(), conductance)


def voltage_by_aspect(ratio: float) -> float:
    return _models_apart(grid(size=(0.2, 0.2 / ratio)))


def voltage_by_gap(gap: float) -> float:
    """2 x 2 electrodes with a gap of so many radii between them."""
    radius = 0.075 / (2 + gap)
    return _models_apart(equal_grid(2, 2, (0.2, 0.2), radius, 1e4, margin=0.0625), place=_CORNER)


def voltage_by_rim(distance: float) -> float:
    """2 x 2 electrodes whose centres are so many radii from the rim."""
    radius = 0.005
    return _models_apart(
        equal_grid(2, 2, (0.2, 0.2), radius, 1e4, margin=distance * radius), place=_CORNER
    )


def _models_apart(layout, conductance=np.inf, place=PLACE):
    """Largest difference of closed form and finite elements."""
    return _apart(
        *(voltages(layout, conductance, model, place) for model in ("closed_form", "fem"))
    )


def _apart(one, other):
    """Largest difference of two frames; infinite where one has readings that the other lacks."""
    if (np.isfinite(one) != np.isfinite(other)).any():
        return np.inf
    return float(np.nanmax(np.abs(one - other)))


def place_by_resistance(resistance: float) -> float:
    """A contact as conductive as the sheet."""
    law = ContactLaw(3e4 / resistance / PRESSURE, 1.0)
    return _place(grid(resistance=resistance), law=law)


def place_by_conductance(conductance: float) -> float:
    if conductance == 0:
        return _place(grid(), pressure=0.0)
    bare = conductance == np.inf
    return _place(grid(), law=None if bare else ContactLaw(conductance / PRESSURE, 1.0))


def place_by_lambda(level: float) -> float:
    return _place(grid(), level=level)


def place_by_noise(noise: float) -> float:
    return _place(grid(), noise=noise)


def place_by_bits(bits: int) -> float:
    return _place(grid(), bits=bits)


def place_by_dead(number: int) -> float:
    order = np.random.default_rng(5).permutation(64)
    return _place(grid(), dead=sorted(order[:number].tolist()))


def place_by_side(side: float) -> float:
    law = replace(LAW, coefficient=LAW.coefficient * (0.2 / side) ** 2)
    return _place(grid(side=side), law=law)


def place_by_electrodes(number: int) -> float:
    return _place(grid(count=number))


def _place(layout, *, law=LAW, pressure=PRESSURE, noise=NOISE, bits=12, dead=(), level=None):
    """Distance of the strongest contact from the true one; InputError where none is reported."""
    size = np.array(layout.outline.size)
    defects, wire = Defects(dead=tuple(dead)), Noise(noise, 1) if noise else None
    scene = Scene("extreme", DRIVE, (), law, wire, Adc(bits, DRIVE), defects)
    recording = record(layout, scene, [(PLACE * size)[None]], pressure, size.max() / 40)
    settings = Settings(
        resolution=CELLS, noise=max(noise, 1e-6), regularization=level, contact_law=law or LAW,
        contact_radius=size.max() / 40,
    )  # fmt: skip
    pipeline = Pipeline(layout, settings)
    result = pipeline.process(recording.frames[0], np.arange(layout.electrodes), DRIVE)
    for image in (result.potential, result.pressure):
        if not np.isfinite(image[pipeline.grid.inside]).all():
            raise InputError("the image is not finite")
    if not result.contacts:
        raise InputError(
            "idle: no contact is reported" if result.idle else "no contact is reported"
        )
    found = result.contacts[0]
    return float(np.hypot(*([found.x, found.y] - PLACE * size)) / size.max())

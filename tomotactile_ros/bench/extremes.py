"""The stability table: errors of places and forces, or the refusal, where one property of an ordinary set-up
is extreme.

Ordinary are 8 x 8 electrodes on 200 mm x 200 mm, one contact of 5 mm radius, 1 mV of noise, 12
bits, 20 x 20 pixels. Places, in parts of the longer side, are compared with the true ones: the mean
distance of a true contact from the nearest that is reported; forces are the sum over all that are
reported, with that on the sheet. The place of a contact that the rim cuts is the centre of what lies on
the sheet.

What is reported has deviations of its own; `place_off` and `force_off` are the errors in units of
them. Beyond `BEYOND` of either (a few in a thousand where the deviations are right) a value looks
right and is not: the table marks it.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tomotactile_ros.bench.cases import PROFILES
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, PRESSURE
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Defects, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import Doubt, InputError

PLACE = np.array([0.13, -0.21])  # of the contact, in parts of the sides
CELLS = 20
BEYOND = 3.5  # stated deviations; 0.2 % of right places (two dimensions), 0.05 % of right forces
MOST = 1000.0  # deviations that are told apart; also where a covariance claims no area
_RADIUS = 0.005  # of a contact, m


@dataclass(frozen=True)
class Trial:
    """An extreme: `given(value)` are arguments of `outcomes` for each of `values`."""

    what: str
    values: tuple
    given: Callable[[Any], dict]


def run(step: int = 1, tick: Callable[[float], None] = lambda fraction: None) -> Iterator[dict]:
    """Rows: what, value, profiles (None where refused), refusal, warnings; see `Trial`.

    Every `step`-th value of each extreme, and the last; `tick` is told which fraction is done.
    """
    todo = [(trial, value) for trial in TRIALS for value in values(trial, step)]
    for number, each in enumerate(todo, 1):
        yield row(*each)
        tick(number / len(todo))


def values(trial: Trial, step: int) -> tuple:
    """Every `step`-th value, and the last."""
    return tuple(dict.fromkeys([*trial.values[::step], trial.values[-1]]))


def row(trial: Trial, value: float) -> dict:
    """What comes out at one value."""
    profiles, refusal = None, None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            profiles = outcomes(**trial.given(value))
        except InputError as refused:
            refusal = str(refused)
    return {
        "what": trial.what,
        "value": float(value) if np.isfinite(value) else str(value),  # JSON knows no other
        "profiles": profiles,
        "refusal": refusal,
        "warnings": sorted({str(w.message) for w in caught if not issubclass(w.category, Doubt)}),
    }


def grid(side: float = 0.2, resistance: float = 1e4) -> Layout:
    """An ordinary layout but for what is said."""
    return equal_grid(8, 8, (side, side), 0.1 * side / 8, resistance)


def of_conductance(conductance: float) -> dict:
    """By another contact law; a bare conductor has none, and without conductance nothing presses."""
    if conductance == 0:
        return {"pressure": 0.0}
    return {"law": None if conductance == np.inf else ContactLaw(conductance / PRESSURE, 1.0)}


def of_dead(number: int) -> dict:
    return {"dead": sorted(np.random.default_rng(5).permutation(64)[:number].tolist())}


def of_electrodes(number: int) -> dict:
    rows = math.isqrt(number)
    cols = number // rows
    size = (0.2 * cols / max(rows, cols), 0.2 * rows / max(rows, cols))
    return {"layout": equal_grid(rows, cols, size, 0.02 / max(rows, cols), 1e4)}


def of_rim(inside: float) -> dict:
    """A contact whose centre is so many of its radii inside the rim."""
    cut = min(inside, 1.0)  # where the rim is, in radii from the centre
    half_chord = math.sqrt(1 - cut**2)
    part = 1 - (math.acos(cut) - cut * half_chord) / np.pi
    aside = 2 / 3 * half_chord**3 / (np.pi * part)  # of the centre of what is left, in radii
    places = np.array([[0.1 - inside * _RADIUS, 0.026]])
    return {"places": places, "part": part, "true": places - [[aside * _RADIUS, 0.0]]}


def of_number(number: int) -> dict:
    """Contacts evenly spread, a square of them."""
    side = math.ceil(math.sqrt(number))
    steps = 0.17 * ((np.arange(side) + 0.5) / side - 0.5)
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)[:number]
    return {"places": places + [0.003, -0.002]}


def outcomes(
    layout=None, *, law=LAW, pressure=PRESSURE, noise=NOISE, bits=12, dead=(), level=None,
    radius=_RADIUS, places=None, part=1.0, true=None, said=None,
) -> list[dict]:  # fmt: skip
    """For each profile: place, force, ghosts, how far off both are, or the refusal.

    The contact law, the contacts and what the reconstruction is told of them are the ordinary ones
    but for what is said. `part` of each contact is on the sheet, its centre in `true` (N, 2), None:
    in `places`; `said`: V rms of noise, None: what it is.
    """
    layout = layout or grid()
    size = np.array(layout.outline.size)
    places = (PLACE * size)[None] if places is None else places
    scene = Scene(
        "extreme",
        DRIVE,
        tuple(Contact("disc", center=where, radius=radius, pressure=pressure) for where in places),
        law,
        Noise(noise, 1) if noise else None,
        Adc(bits, DRIVE),
        Defects(dead=tuple(dead)),
    )
    frames: list[np.ndarray] = []

    def found(profile):
        settings = Settings(
            profile, resolution=CELLS, noise=said or max(noise, 1e-6), regularization=level,
            contact_law=law or LAW, contact_radius=radius,
        )  # fmt: skip
        pipeline = Pipeline(layout, settings)
        if not frames:
            frames.append(Simulator(layout, scene, h=size.max() / 40).frame(0.5))
        result = pipeline.process(frames[0], np.arange(layout.electrodes), DRIVE)
        if result.state != "valid":
            raise InputError(f"withheld: {result.reason}")
        for image in (result.potential, result.pressure):
            if not np.isfinite(image[pipeline.grid.inside]).all():
                raise InputError("the image is not finite")
        if not result.contacts:
            raise InputError("idle" if result.idle else "no contact is reported")
        return result.contacts

    force = part * pressure * np.pi * radius**2 * len(places)
    true = places if true is None else true
    return [_row(profile, found, true, size.max(), force if law else None) for profile in PROFILES]


def _row(profile, found, places, side, force) -> dict:
    """How far contacts are off: place in parts of the side, force in parts of the true one."""
    row = dict.fromkeys(("place", "force", "ghosts", "place_off", "force_off", "refusal"))
    row["profile"] = profile
    try:
        contacts = found(profile)
    except InputError as refused:
        return {**row, "refusal": str(refused)}
    at = np.array([[contact.x, contact.y] for contact in contacts])
    distance = np.hypot(*(places[:, None] - at).transpose(2, 0, 1))
    row["place"] = float(distance.min(axis=1).mean() / side)
    nearest = [contacts[k] for k in distance.argmin(axis=1)]
    row["place_off"] = _place_off(places, nearest)
    row["ghosts"] = max(len(contacts) - len(places), 0)
    if force:
        found_force = sum(contact.force for contact in contacts)
        row["force"] = found_force / force - 1
        row["force_off"] = _force_off(found_force - force, contacts)
    return row


def _place_off(places, nearest):
    """Largest distance of a true place from its contact, in deviations (Mahalanobis); None: untold."""
    covariance = np.reshape([contact.position_covariance for contact in nearest], (-1, 2, 2))
    if np.isnan(covariance).any():
        return None
    off = places - [[contact.x, contact.y] for contact in nearest]
    if (np.linalg.det(covariance) <= 0).any():
        return MOST
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)
    return min(float(np.sqrt(squared.max())), MOST)


def _force_off(error, contacts):
    """The error of the sum of forces, in deviations, taken as independent; None: untold.

    0 where a contact is said to be a bare conductor, of whose force no more is known than a bound.
    """
    deviation = math.hypot(*(contact.force_std for contact in contacts))
    if math.isnan(deviation):
        return None
    return float(min(abs(error) / deviation, MOST)) if deviation > 0 else MOST


_POWERS = 1e-12, 1e-6, 1e-3, 1.0, 1e3
TRIALS = (
    Trial(
        "sheet resistance, ohm/sq",
        tuple(10.0**n for n in range(-3, 10, 2)),
        lambda resistance: {"layout": grid(resistance=resistance)},
    ),
    Trial("contact conductance, S/m2", (0.0, *_POWERS, 1e9, 1e30, np.inf), of_conductance),
    Trial("lambda^2, eq. 1", (0.0, 1e-30, *_POWERS, 1e12, 1e30), lambda level: {"level": level}),
    Trial("noise, V", (0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0), lambda noise: {"noise": noise}),
    Trial(
        "noise, V; 1 mV said",
        (1e-5, 3e-3, 1e-2, 3e-2, 0.1),
        lambda noise: {"noise": noise, "said": NOISE},
    ),
    Trial("converter, bits", (1, 2, 4, 8, 12, 16, 24), lambda bits: {"bits": bits}),
    Trial("dead channels of 64", (0, 1, 4, 16, 32, 48, 60, 62, 63), of_dead),
    Trial("side, m", (1e-3, 0.02, 0.2, 1.0, 10.0), lambda side: {"layout": grid(side)}),
    Trial("electrodes", (1, 4, 6, 9, 16, 64, 2500), of_electrodes),
    Trial(
        "radius of the contact, m",
        (1e-4, 1e-3, 0.005, 0.02, 0.05, 1.0),
        lambda radius: {"radius": radius},
    ),
    Trial("centre inside the rim, radii", (2.0, 1.0, 0.5, 0.0, -0.5), of_rim),
    Trial("contacts", (1, 16, 49, 200), of_number),
)

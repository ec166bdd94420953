"""The stability table: what comes out at the extremes, the error against a reference or the
refusal."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.bench import extremes, one_step
from tomotactile_ros.support.errors import Doubt, InputError

VOLTAGE, IMAGE = "voltage / drive", "image / its norm"
CONTACTS = "contacts"  # place / side and force, of every profile
_RESISTANCES = tuple(10.0**n for n in range(-3, 10, 2))
_CONDUCTANCES = (0.0, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e9, 1e30, np.inf)
_LAMBDAS = (0.0, 1e-30, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e12, 1e30)
_NOISES = (0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
_UNSAID = (1e-5, 3e-3, 1e-2, 3e-2, 0.1)
_BITS = (1, 2, 4, 8, 12, 16, 24)
_DEAD = (0, 1, 4, 16, 32, 48, 60, 62, 63)
_ELECTRODES = (1, 4, 6, 9, 16, 64, 2500)
_RADII = (1e-4, 1e-3, 0.005, 0.02, 0.05, 1.0)
_INSIDE = (2.0, 1.0, 0.5, 0.0, -0.5)
_CONDITIONS = (1.0, 1e2, 1e4, 1e6, 1e8, 1e10, 1e12, 1e14, 1e16)


@dataclass(frozen=True)
class Trial:
    """An extreme: `error(value)` is the error of what `measure` says, for each of `values`.

    Of `CONTACTS` it is a list with profile, place, force, ghosts, refusal, None where one has none.
    """

    what: str
    measure: str
    values: tuple
    error: Callable[[float], float | list[dict]]


def trials() -> tuple[Trial, ...]:
    """All extremes."""
    return (
        Trial("sheet resistance, ohm/sq", VOLTAGE, _RESISTANCES, extremes.voltage_by_resistance),
        Trial("sheet resistance, ohm/sq", CONTACTS, _RESISTANCES, extremes.contacts_by_resistance),
        Trial("contact conductance, S/m2", VOLTAGE, _CONDUCTANCES, extremes.voltage_by_conductance),
        Trial(
            "contact conductance, S/m2", CONTACTS, _CONDUCTANCES, extremes.contacts_by_conductance
        ),
        Trial("lambda^2, eq. 1", IMAGE, _LAMBDAS, one_step.as_used),
        Trial("lambda^2, eq. 1", CONTACTS, _LAMBDAS, extremes.contacts_by_lambda),
        Trial("noise, V", CONTACTS, _NOISES, extremes.contacts_by_noise),
        Trial("noise, V; 1 mV said", CONTACTS, _UNSAID, extremes.contacts_by_unsaid_noise),
        Trial("converter, bits", CONTACTS, _BITS, extremes.contacts_by_bits),
        Trial("dead channels of 64", CONTACTS, _DEAD, extremes.contacts_by_dead),
        Trial("side, m", CONTACTS, (1e-3, 0.02, 0.2, 1.0, 10.0), extremes.contacts_by_side),
        Trial("aspect ratio", VOLTAGE, (1, 3, 10, 30, 100), extremes.voltage_by_aspect),
        Trial("electrodes", CONTACTS, _ELECTRODES, extremes.contacts_by_electrodes),
        Trial("radius of the contact, m", CONTACTS, _RADII, extremes.contacts_by_radius),
        Trial("centre inside the rim, radii", CONTACTS, _INSIDE, extremes.contacts_by_rim),
        Trial("contacts", CONTACTS, (1, 16, 49, 200), extremes.contacts_by_number),
        Trial("gap of electrodes, radii", VOLTAGE, (0, 1e-6, 0.01, 1), extremes.voltage_by_gap),
        Trial("electrodes from rim, radii", VOLTAGE, (0, 0.02, 0.5, 1), extremes.voltage_by_rim),
        Trial("condition, float32", IMAGE, _CONDITIONS, one_step.in_single_precision),
        Trial("condition, float64", IMAGE, _CONDITIONS, one_step.in_double_precision),
        Trial("condition, as used", IMAGE, _CONDITIONS, one_step.as_used_by_condition),
    )


def run(step: int = 1, tick: Callable[[], None] = lambda: None) -> Iterator[dict]:
    """Rows: what, value, measure, error (None where refused), refusal, warnings; see `Trial`.

    Every `step`-th value of each extreme, and the last; `tick` is called after each.
    """
    for trial in trials():
        for value in values(trial, step):
            yield row(trial, value)
            tick()


def count(step: int = 1) -> int:
    """Number of rows."""
    return sum(len(values(trial, step)) for trial in trials())


def values(trial: Trial, step: int) -> tuple:
    """Every `step`-th value, and the last."""
    return tuple(dict.fromkeys([*trial.values[::step], trial.values[-1]]))


def row(trial: Trial, value: float) -> dict:
    """What comes out at one value."""
    error, refusal = None, None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            error = trial.error(value)
            error = error if trial.measure == CONTACTS else _finite(error)
        except InputError as refused:
            refusal = str(refused)
    return {
        "what": trial.what,
        "value": _finite(value),
        "measure": trial.measure,
        "error": error,
        "refusal": refusal,
        "warnings": sorted({str(w.message) for w in caught if not issubclass(w.category, Doubt)}),
    }


def _finite(number):
    """The number, as text where JSON knows none."""
    return float(number) if np.isfinite(number) else str(number)

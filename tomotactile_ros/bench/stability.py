"""The stability table: what comes out at the extremes, the error against a reference or the
refusal."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.bench import extremes, one_step
from tomotactile_ros.errors import InputError

VOLTAGE, PLACE, IMAGE = "voltage / drive", "place / side", "image / its norm"
_RESISTANCES = tuple(10.0**n for n in range(-3, 10, 2))
_CONDUCTANCES = (0.0, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e9, 1e30, np.inf)
_LAMBDAS = (0.0, 1e-30, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e12, 1e30)
_NOISES = (0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
_BITS = (1, 2, 4, 8, 12, 16, 24)
_DEAD = (0, 1, 4, 16, 32, 48, 60, 62, 63)
_CONDITIONS = (1.0, 1e2, 1e4, 1e6, 1e8, 1e10, 1e12, 1e14, 1e16)


@dataclass(frozen=True)
class Trial:
    """An extreme: `error(value)` is the error of what `measure` says, for each of `values`."""

    what: str
    measure: str
    values: tuple
    error: Callable[[float], float]


def trials() -> tuple[Trial, ...]:
    """All extremes."""
    return (
        Trial("sheet resistance, ohm/sq", VOLTAGE, _RESISTANCES, extremes.voltage_by_resistance),
        Trial("sheet resistance, ohm/sq", PLACE, _RESISTANCES, extremes.place_by_resistance),
        Trial("contact conductance, S/m2", VOLTAGE, _CONDUCTANCES, extremes.voltage_by_conductance),
        Trial("contact conductance, S/m2", PLACE, _CONDUCTANCES, extremes.place_by_conductance),
        Trial("lambda^2, eq. 1", IMAGE, _LAMBDAS, one_step.as_used),
        Trial("lambda^2, eq. 1", PLACE, _LAMBDAS, extremes.place_by_lambda),
        Trial("noise, V", PLACE, _NOISES, extremes.place_by_noise),
        Trial("converter, bits", PLACE, _BITS, extremes.place_by_bits),
        Trial("dead channels of 64", PLACE, _DEAD, extremes.place_by_dead),
        Trial("side, m", PLACE, (1e-3, 1e-2, 0.2, 1.0, 10.0), extremes.place_by_side),
        Trial("aspect ratio", VOLTAGE, (1, 3, 10, 30, 100), extremes.voltage_by_aspect),
        Trial("electrodes to a side", PLACE, (1, 2, 3, 4, 8, 16), extremes.place_by_electrodes),
        Trial("gap of electrodes, radii", VOLTAGE, (0, 1e-6, 0.01, 1), extremes.voltage_by_gap),
        Trial("electrodes from rim, radii", VOLTAGE, (0, 0.02, 0.5, 1), extremes.voltage_by_rim),
        Trial("condition, float32", IMAGE, _CONDITIONS, one_step.in_single_precision),
        Trial("condition, float64", IMAGE, _CONDITIONS, one_step.in_double_precision),
        Trial("condition, as used", IMAGE, _CONDITIONS, one_step.as_used_by_condition),
    )


def run(step: int = 1, tick: Callable[[], None] = lambda: None) -> Iterator[dict]:
    """Rows: what, value, measure, error (None where refused), refusal, warnings.

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
            error = _finite(trial.error(value))
        except InputError as refused:
            refusal = str(refused)
    return {
        "what": trial.what,
        "value": _finite(value),
        "measure": trial.measure,
        "error": error,
        "refusal": refusal,
        "warnings": sorted({str(warning.message) for warning in caught}),
    }


def _finite(number):
    """The number, as text where JSON knows none."""
    return float(number) if np.isfinite(number) else str(number)

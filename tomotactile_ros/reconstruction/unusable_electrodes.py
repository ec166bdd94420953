"""Electrodes whose readings cannot be used.

A channel is dead where less than half of its readings are valid, stuck where they are all the same,
and broken where they contradict reciprocity: rho_ln f_l = rho_nl f_n (see `admittance`) holds for
every sheet and all contacts, whatever the model. Two channels whose wires are swapped do not
contradict it. But contacts only lower the couplings Y_nl between electrodes, and swapped electrodes
seem to be coupled to those next to the other one.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from tomotactile_ros.estimation import screening
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction.admittance import (
    AdmittanceMeter,
    Grounded,
    symmetric_part,
    symmetric_scaling,
)
from tomotactile_ros.reconstruction.settings import ContactEstimate

_GAINS_DIFFER = 0.1  # as far as those of usable channels do
_STUCK = 0.25  # least standard deviation of a channel's readings, in parts of the noise
_DOUBT = 1.15  # asymmetry of a frame, in parts of the noise, from which on channels are compared
_LEAST_PAIRS = 16  # of readings to compare; with fewer, the scaling follows the error
_SWAPPED = 0.12  # coupling of distant electrodes, in parts of their own, that no contact makes
_CLEAR = 0.02  # noise of an admittance, in the same parts, up to which that can be told
_SUSPECTS = 3  # electrodes that are exchanged with all others in turn
_GAIN = 0.8  # of the squares, that an exchange leaves at most
_EXPLAINED = 0.5  # of the squares, that all exchanges together leave at most
_CONTRADICTION = 6.0  # allowed asymmetry, in parts of the noise and of the median channel


def dead_channels(valid: np.ndarray) -> np.ndarray:
    """(E,) bool: less than half of the readings that rows (E, E) of `valid` could hold are
    there."""
    rows = valid.any(axis=1)
    possible = np.count_nonzero(rows) - rows
    return np.count_nonzero(valid, axis=0) < possible / 2


def why_left_out(
    frame: np.ndarray, bad: np.ndarray, excluded: np.ndarray, noise: float
) -> dict[int, str]:
    """{electrode: reason} for all electrodes of `bad` (E,), by what a frame (E, E), V, shows of
    them.

    `excluded` (E,) are those that the settings leave out; `noise` of a reading, V rms.
    """
    dead = dead_channels(np.isfinite(frame))
    stuck = stuck_channels(frame, noise) | screening.stuck_channels(
        frame, np.isfinite(frame), noise
    )
    found = {}
    for electrode in np.flatnonzero(bad).tolist():
        if excluded[electrode]:
            found[electrode] = "excluded by the settings"
        elif dead[electrode]:
            found[electrode] = "no readings"
        elif stuck[electrode]:
            found[electrode] = screening.STUCK
        else:
            found[electrode] = "its readings contradict all others, or its wire is swapped"
    return found


def covered_electrodes(
    layout: Layout, contacts: Sequence[ContactEstimate], readings: np.ndarray, drive_voltage: float
) -> np.ndarray:
    """(E,) bool: electrodes that read (E,) V no less than the drive voltage, but for the gain of a channel,
    and that one of the `contacts` may cover: what conducts that well on an electrode pins its reading, which
    is no defect. The end of a long one is as far from the disc that it is told as as a spacing."""
    pinned = readings > (1 - _GAINS_DIFFER) * drive_voltage
    covered, reach = np.zeros(len(pinned), bool), float(np.median(layout.pitches))
    for contact in contacts:
        apart = np.hypot(*(layout.positions - [contact.x, contact.y]).T)
        covered |= apart < contact.radius + reach
    return covered & pinned


def is_doubtful(
    meter: AdmittanceMeter, frame: np.ndarray, measured: Grounded, noise: float
) -> bool:
    """Whether a complete frame (n, n), V, deserves a closer look; cheap."""
    if measured.asymmetry > _DOUBT or meter.excess(measured) > _SWAPPED:
        return True
    readings = frame.ravel()[1:].reshape(len(frame) - 1, -1)[:, :-1]  # without the diagonal
    some = readings[0] - readings[0].mean()
    if some.dot(some) > readings.size * (_STUCK * noise) ** 2:  # the variance of all is no less
        return False
    return float(readings.std()) < _STUCK * noise


def stuck_channels(frame: np.ndarray, noise: float) -> np.ndarray:
    """(n,) bool: all readings of a channel are the same but for less than the noise (V)."""
    valid = np.isfinite(frame)
    counts = np.maximum(np.count_nonzero(valid, axis=0), 1)
    mean = np.where(valid, frame, 0.0).sum(axis=0) / counts
    spread = np.sqrt((np.where(valid, frame - mean, 0.0) ** 2).sum(axis=0) / counts)
    return (counts > 2) & (spread < _STUCK * noise)


def broken_channels(frame: np.ndarray, drive_voltage: float, noise: float) -> np.ndarray:
    """(n,) bool: channels that are stuck, or contradict all others, worst first until the rest
    agrees.

    Parameters
    ----------
    frame : (n, n) V; NaN where there is no reading
    noise : of a reading, V rms
    """
    electrodes = len(frame)
    used = np.flatnonzero(~stuck_channels(frame, noise))
    while len(used) > max(3, electrodes // 2):
        excess = _contradiction(frame[np.ix_(used, used)], drive_voltage, noise)
        worst = int(np.argmax(excess))
        if excess[worst] <= _CONTRADICTION * max(1.0, float(np.median(excess))):
            break
        used = np.delete(used, worst)
    broken = np.ones(electrodes, bool)
    broken[used] = False
    return broken


def _contradiction(frame, drive_voltage, noise):
    """(n,) root mean square asymmetry of each channel in parts of the noise."""
    valid = np.isfinite(frame)
    both = valid & valid.T
    least = noise / drive_voltage
    # what has no counterpart counts as a full drop: rho = 0 on both sides
    scaled = symmetric_scaling(np.where(both, frame, drive_voltage), drive_voltage, least)
    factor = scaled.diagonal()
    error = least * np.hypot(factor[:, None], factor)
    squares = np.where(both, ((scaled - scaled.T) / error) ** 2, 0.0)
    count = np.count_nonzero(both, axis=0)
    return np.where(count >= _LEAST_PAIRS, np.sqrt(squares.sum(axis=0) / np.maximum(count, 1)), 0.0)


def swapped_channels(
    meter: AdmittanceMeter, frame: np.ndarray, drive_voltage: float, measured: Grounded
) -> np.ndarray:
    """(n,) bool: channels of a complete frame (n, n), V, that fit the sheet only if exchanged with
    each other."""
    swapped = np.zeros(len(frame), bool)
    if not (meter.excess(measured) > _SWAPPED and measured.noise < _CLEAR * meter.own):
        return swapped
    least = meter.noise / drive_voltage
    impedance, _ = symmetric_part(symmetric_scaling(frame, drive_voltage, least), least)
    admittance, order = meter.scaled(impedance), np.arange(len(frame))
    excess = _excess(admittance, meter)
    first = before = (excess**2).sum()
    while excess.any():
        trials = []
        suspects = np.argsort(-(excess**2).sum(axis=0))[:_SUSPECTS]
        for i, j in product(suspects, range(len(frame))):
            trial = order.copy()
            trial[[i, j]] = order[[j, i]]
            left = _excess(admittance[np.ix_(trial, trial)], meter)
            trials.append(((left**2).sum(), trial, left))
        cost, trial, excess = min(trials, key=lambda trial: trial[0])
        if cost > _GAIN * before:
            break
        order, before = trial, cost
        swapped |= order != np.arange(len(frame))
    return swapped & (before < _EXPLAINED * first)


def _excess(admittance, meter):
    """(n, n) how far couplings are beyond those of the sheet, in parts of an own admittance."""
    excess = np.maximum(meter.sheet.admittance - admittance, 0.0) / meter.scale
    np.fill_diagonal(excess, 0.0)
    return np.where(excess > 0.75 * _SWAPPED, excess, 0.0)

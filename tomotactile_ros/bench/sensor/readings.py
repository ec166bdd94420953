"""Frames of voltages from what the electrodes see: wiring, channels, noise, conversion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tomotactile_ros.bench.reference import Admittance, reference_frame
from tomotactile_ros.bench.trials import BITS, DRIVE, NOISE
from tomotactile_ros.scenes.channels import Channels
from tomotactile_ros.simulation import convert


@dataclass(frozen=True)
class Wiring:
    """What is wrong between electrodes and numbers.

    channels : gains, offsets, resistances, open wires, stuck channels
    swapped : pairs of electrodes whose wires are exchanged
    dead : electrodes without a valid reading
    """

    channels: Channels = field(default_factory=Channels)
    swapped: tuple[tuple[int, int], ...] = ()
    dead: tuple[int, ...] = ()


IDEAL = Wiring()


def potentials(seen: Admittance, wiring: Wiring = IDEAL) -> np.ndarray:
    """(E, E) V, of all electrodes with each of them grounded in turn; NaN on the grounded one."""
    electrodes = len(seen.drive)
    numbers = wiring.channels.of(electrodes)
    to_ground = np.zeros(electrodes)
    if numbers.ground_resistance is not None:
        to_ground += numbers.ground_resistance
    to_ground[numbers.open] = np.inf
    out = reference_frame(seen, DRIVE, ground_resistance=to_ground)
    if numbers.settling is not None:
        np.fill_diagonal(out, 0.0)
        out = numbers.settled(np.vstack([out[-1:], out]))
        np.fill_diagonal(out, np.nan)
    for pair in map(list, wiring.swapped):
        out[pair] = out[pair[::-1]]
        out[:, pair] = out[:, pair[::-1]]
    return out


def untouched(electrodes: int) -> np.ndarray:
    """(E, E) V where nothing touches; NaN on the grounded electrode."""
    out = np.zeros((electrodes, electrodes))
    np.fill_diagonal(out, np.nan)
    return out


def readings(
    potentials: np.ndarray, wiring: Wiring = IDEAL, seed: Sequence[int] = (0,)
) -> np.ndarray:
    """(L, E) V as a 12-bit converter returns them, with 1 mV of noise that `seed` chooses."""
    numbers = wiring.channels.of(potentials.shape[1])
    out = potentials + NOISE * np.random.default_rng(seed).standard_normal(potentials.shape)
    numbers.amplify(out)
    numbers.stick(out)
    out = convert(out, BITS, DRIVE)
    out[:, list(wiring.dead)] = np.nan
    return out

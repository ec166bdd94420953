"""What is wrong between the electrodes and the numbers: gains, offsets, wires, a hasty multiplexer.

A reading of electrode n while electrode l is grounded is

    v_n = a_n ((1 - s_n) u_n + s_n u'_n) + o_n

with u_n the potential of electrode n, behind R_l from electrode l to ground, u'_n the same in the
row before, and gain a_n, offset o_n and settling s_n of the channel. A field holds one number per
electrode, or how such numbers are drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import Reader

_WIDEST = 0.25  # rms of gains: at four standard deviations a channel is dead
_GAIN, _OFFSET, _GROUND = 1, 2, 3  # keep numbers of equal seeds apart


@dataclass(frozen=True)
class Rms:
    """Normal distribution about what is right: ``rms``, and the seed of the random numbers."""

    rms: float
    seed: int = 0

    def __post_init__(self):
        checks.not_negative(self.rms, "rms", "number")
        checks.integer(self.seed, "seed", 0, 2**32 - 1)


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution of numbers >= 0 from ``mean - spread`` to ``mean + spread``."""

    mean: float
    spread: float = 0.0
    seed: int = 0

    def __post_init__(self):
        checks.not_negative(self.mean, "mean", "resistance in ohm")
        checks.not_negative(self.spread, "spread", "resistance in ohm")
        if self.spread > self.mean:
            raise InputError(f"spread: {self.spread:g} is above the mean ({self.mean:g} ohm)")
        checks.integer(self.seed, "seed", 0, 2**32 - 1)


@dataclass(frozen=True)
class Channels:
    """Channels and wires of a sensor; each part is modelled only if it is named.

    Parameters
    ----------
    gain : (E,) factors, or `Rms` (relative).
    offset : (E,) V, or `Rms` in V.
    ground_resistance : (E,) ohm between each electrode and ground, in addition to the one switch
        that all share, or `Uniform`.
    settling : part of the row before that a reading keeps, below 1; one for all, or (E,).
    open : electrodes that are never grounded: their rows read the drive voltage wherever something
        touches.
    stuck : voltage, V, that an electrode reads whatever happens.
    """

    gain: tuple[float, ...] | Rms | None = None
    offset: tuple[float, ...] | Rms | None = None
    ground_resistance: tuple[float, ...] | Uniform | None = None
    settling: tuple[float, ...] | float | None = None
    open: tuple[int, ...] = ()
    stuck: dict[int, float] = field(default_factory=dict)

    def __post_init__(self):
        _check_each(self.gain, "gain", checks.positive, "factor")
        _check_each(self.offset, "offset", checks.number, "voltage in V")
        resistance = self.ground_resistance
        _check_each(resistance, "ground_resistance", checks.not_negative, "resistance in ohm")
        _check_each(self.settling, "settling", _part, "part from 0 to below 1")
        if isinstance(self.gain, Rms) and self.gain.rms > _WIDEST:
            raise InputError(f"gain.rms: {self.gain.rms:g} is above {_WIDEST:g}")
        for electrode in (*self.open, *self.stuck):
            if electrode < 0:
                raise InputError(f"{electrode} is not an electrode, they count from 0")
        if len(set(self.open)) < len(self.open):
            raise InputError(f"open: {checks.show(list(self.open))} names an electrode twice")
        for electrode, volts in self.stuck.items():
            checks.number(volts, f"stuck.{electrode}", "voltage in V")

    def check(self, electrodes: int, place: str) -> None:
        """Refuse what does not fit a layout of so many electrodes; `place` begins the complaint."""
        for key in ("gain", "offset", "ground_resistance", "settling"):
            value = getattr(self, key)
            if isinstance(value, tuple) and len(value) != electrodes:
                raise InputError(
                    f"{place}{key}: a list of {len(value)} numbers, the layout has {electrodes} "
                    "electrodes"
                )
        for key, numbers in (("open", self.open), ("stuck", tuple(self.stuck))):
            if max(numbers, default=0) >= electrodes:
                raise InputError(
                    f"{place}{key}: electrode {max(numbers)} does not exist, the layout has 0 to "
                    f"{electrodes - 1}"
                )

    def of(self, electrodes: int) -> ChannelNumbers:
        """The numbers of each of so many electrodes."""
        gain = _drawn(self.gain, electrodes, lambda d: 1 + d.rms * _normal(d, _GAIN, electrodes))
        offset = _drawn(self.offset, electrodes, lambda d: d.rms * _normal(d, _OFFSET, electrodes))
        resistance = _drawn(
            self.ground_resistance,
            electrodes,
            lambda d: d.mean + d.spread * (2 * _random(d, _GROUND).random(electrodes) - 1),
        )
        return ChannelNumbers(
            gain,
            offset,
            resistance,
            _drawn(self.settling, electrodes),
            np.array(self.open, int),
            np.array(list(self.stuck), int),
            np.array(list(self.stuck.values()), float),
        )


@dataclass(frozen=True, eq=False)
class ChannelNumbers:
    """`Channels` as arrays (E,), None for what is not modelled; `open` and `stuck` electrodes."""

    gain: np.ndarray | None
    offset: np.ndarray | None
    ground_resistance: np.ndarray | None
    settling: np.ndarray | None
    open: np.ndarray
    stuck: np.ndarray
    stuck_at: np.ndarray

    def settled(self, rows: np.ndarray) -> np.ndarray:
        """(L, E) V of (L + 1, E) potentials, the first of which are those of the row before."""
        kept = 0.0 if self.settling is None else self.settling
        return (1 - kept) * rows[1:] + kept * rows[:-1]

    def amplify(self, voltages: np.ndarray) -> None:
        """Put the gains and offsets into (L, E) voltages, V."""
        if self.gain is not None:
            voltages *= self.gain
        if self.offset is not None:
            voltages += self.offset

    def stick(self, voltages: np.ndarray) -> None:
        """Put the stuck channels into (L, E) voltages, V; NaN stays NaN."""
        for electrode, volts in zip(self.stuck, self.stuck_at):
            column = voltages[:, electrode]
            column[~np.isnan(column)] = volts


def read_channels(reader: Reader) -> Channels:
    """The channels' part of the defects in a scene file."""
    return reader.build(Channels, **reader.values(Channels, "stuck"), stuck=_stuck(reader))


def _stuck(reader):
    stuck = {}
    for key in reader.free("stuck"):
        if not str(key).isdecimal():
            reader.refuse("stuck", key, "is not the number of an electrode")
        stuck[int(key)] = reader.section("stuck").number(key)
    return stuck


def _check_each(value, key, check, kind):
    if isinstance(value, tuple):
        for i, number in enumerate(value):
            check(number, f"{key}[{i}]", kind)
    elif value is not None and not isinstance(value, (Rms, Uniform)):
        check(value, key, kind)


def _part(value, key, kind):
    if checks.not_negative(value, key, kind) >= 1:
        raise InputError(f"{key}: {value:g} is not a {kind}")


def _drawn(value, electrodes: int, draw: Callable | None = None) -> np.ndarray | None:
    if value is None:
        return None
    if draw is not None and isinstance(value, (Rms, Uniform)):
        return draw(value)
    return np.broadcast_to(np.asarray(value, float), electrodes)


def _random(drawn, what):
    return np.random.default_rng([drawn.seed, 0, what])


def _normal(drawn, what, electrodes):
    return _random(drawn, what).standard_normal(electrodes)

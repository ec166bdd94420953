"""Gains, offsets and settling from reciprocity alone: no model of the sheet, no place, no force.

With electrode l grounded, 1 - (v_ln - o_n) / a_n = Z_ln / N_l, and the transfer impedance Z is
symmetric (reciprocity; Geselowitz 1971). Two readings of each pair of electrodes have one Z_ln in
common:

    r_ln = rho_ln N_l - rho_nl N_n = 0,    rho_ln = 1 - (v_ln - o_n) / a_n

For each frame N_l is free (contacts, sheet and resistances to ground are all in it), a and o are
those of the sensor. Readings err, and so do the factors that they are compared with: to fit them in
the space of readings, each Z_ln eliminated, is to divide r by its own standard deviation,
parameters included (errors in variables; Fuller 1987),

    e_ln = r_ln / s_ln,    s_ln^2 = s^2 (N_l^2 / a_n^2 + N_n^2 / a_l^2)

which is free of the bias that plain least squares of r has. Gauss-Newton; the N of each frame are
eliminated. The common factor of all gains shows only in how N differs between electrodes: weakly,
its prior decides.

A multiplexer that is read before it has settled leaves a part s_n of the row before in a reading:

    rho_ln = 1 - x_ln,    x_ln = w_ln - s_n (w_pn - w_ln),    w_ln = (v_ln - o_n) / a_n

to first order in s, with p the row before l. That contradicts reciprocity, too, and nothing else
does in that way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

_STEPS = 30  # steps: most of a fit of gains and offsets
_HALVINGS = 12  # of a step that does not lower the cost
_SETTLED = 0.01  # of the cost, in units of the noise: a hundredth of a standard deviation squared
_LOOSE = 1e-6  # of a row's weight: holds the common factor of a frame's N
_CLEAR = 5.0  # deviations of noise: shares above have a logarithm
_LEAST = 1e-3  # of a share: below, logarithms of it say nothing


@dataclass(frozen=True)
class Gains:
    """What reciprocity says: gain (n,), offset (n,) V, their covariance (2 n, 2 n), and of each
    frame chi-squared per equation (F,), and what is left, e of all pairs (F, n, n). With settling:
    settling (n,), whose covariance follows those of gains and offsets, (3 n, 3 n)."""

    gain: np.ndarray
    offset: np.ndarray
    covariance: np.ndarray
    misfit: np.ndarray
    left: np.ndarray
    settling: np.ndarray = field(default_factory=lambda: np.empty(0))


def fit_gains(
    frames: np.ndarray,
    drive: float,
    noise: float,
    gain: tuple[np.ndarray, np.ndarray],
    offset: tuple[np.ndarray, np.ndarray],
    steps: int = _STEPS,
    settling: tuple[np.ndarray, np.ndarray] | None = None,
) -> Gains:
    """Gains and offsets of n channels; LinAlgError where no gains explain the readings.

    Parameters
    ----------
    frames : (F, n, n) V, row l with electrode l grounded; NaN: not read. Of touches, not of the
        untouched sheet
    drive, noise : V; of a reading, V rms
    gain, offset : means and standard deviations (n,) of the prior; relative, V
    steps : of each of the two forms, at most; one is near enough to look at a frame
    settling : inverse covariance (n, n) of its prior about 0, and the potentials (n, n) in the row
        before each, V, NaN: not known; None: readings have settled
    """
    readings = np.asarray(frames, float) / drive
    count = readings.shape[-1]
    mean = np.concatenate([gain[0], np.asarray(offset[0]) / drive])
    precision = np.diag(np.concatenate([gain[1], np.asarray(offset[1]) / drive]) ** -2.0)
    before = None
    if settling is not None:
        mean = np.concatenate([mean, np.zeros(count)])
        precision = block_diag(precision, settling[0])
        before = np.asarray(settling[1], float) / drive
        readings = np.where(np.isfinite(before), readings, np.nan)
        before = np.where(np.isfinite(before), before, 0.0)
    own = np.arange(count)
    both = np.isfinite(readings) & np.isfinite(readings.transpose(0, 2, 1))
    both[:, own, own] = False
    readings = np.where(both, readings, 0.0)
    now = mean.copy()
    scale = np.array([_first_scale(v, m, now) for v, m in zip(readings, both)])

    for form in (_logarithms, _differences):  # the first converges from afar, the second is right

        def at(
            now: np.ndarray,
            scale: np.ndarray,
            form: Callable[..., tuple[np.ndarray, list[np.ndarray]]] = form,
        ) -> tuple[list[_Terms], float]:
            """One term for each frame, and the cost of all; no number where steps are far too long."""
            with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
                terms = [
                    _Terms(m, *form(v, m, n, now, noise / drive, before))
                    for v, m, n in zip(readings, both, scale)
                ]
            return terms, sum(t.cost for t in terms) + (now - mean) @ precision @ (now - mean)

        terms, cost = at(now, scale)
        for _ in range(steps):
            normal, right = (sum(each) for each in zip(*(t.equations for t in terms)))
            factor = cho_factor(precision + normal)
            change = cho_solve(factor, precision @ (mean - now) + right)
            follow = np.array([t.follow(change) for t in terms])
            for part in 0.5 ** np.arange(_HALVINGS):
                tried, reached = at(now + part * change, scale + part * follow)
                if reached <= cost:
                    break
            gained = cost - reached
            if not gained > 0:
                break
            now, scale, terms, cost = now + part * change, scale + part * follow, tried, reached
            if gained < _SETTLED:
                break
    covariance = cho_solve(factor, np.eye(len(now)))
    units = np.ones(len(now))
    units[count : 2 * count] = drive
    covariance = covariance * units[:, None] * units
    misfit, left = (np.array(each) for each in zip(*((t.misfit, t.left) for t in terms)))
    known = now[:count], now[count : 2 * count] * drive
    return Gains(*known, covariance, misfit, left, now[2 * count :])


def _first_scale(readings: np.ndarray, both: np.ndarray, now: np.ndarray) -> np.ndarray:
    """(n,) ln N from the ratios of the two readings of each pair."""
    count = len(readings)
    share = 1 - (readings - now[count : 2 * count]) / now[:count]
    seen = both & (share > _LEAST) & (share.T > _LEAST)
    ratio = np.where(seen, np.log(np.where(seen, share.T / np.where(seen, share, 1), 1)), 0.0)
    weight = np.where(seen, np.minimum(share, share.T) ** 2, 0.0)
    # ln N_l - ln N_n = ratio_ln: a weighted graph Laplacian
    laplacian = np.diag(weight.sum(axis=1)) - weight
    right = (weight * ratio).sum(axis=1)
    return np.linalg.lstsq(laplacian + weight.sum() / count**3, right, rcond=None)[0]


def _settled(
    v: np.ndarray, both: np.ndarray, now: np.ndarray, before: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """(n, n) x, and how it falls with s."""
    count = len(v)
    gain, offset = now[:count], now[count : 2 * count]
    read = (v - offset) / gain
    if before is None:
        return read, None
    fallen = np.where(both, (before - v) / gain, 0.0)
    return read - now[2 * count :] * fallen, fallen


def _differences(
    v: np.ndarray,
    both: np.ndarray,
    log_scale: np.ndarray,
    now: np.ndarray,
    noise: float,
    before: np.ndarray | None,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """(n, n) e, and its derivatives by ln N, gain, offset and settling of the electrode of the row."""
    gain = now[: len(v)]
    read, fallen = _settled(v, both, now, before)
    size = np.exp(log_scale)[:, None]
    own = (1 - read) * size  # rho_ln N_l
    r = own - own.T
    spread = (noise * size / gain) ** 2
    variance = spread + spread.T
    inverse = np.where(both, 1 / np.sqrt(variance), 0.0)
    half = np.where(both, r / (2 * variance**1.5), 0.0)
    other = (size / gain).T  # (l, n): N_n / a_l
    by_scale = own * inverse - half * 2 * spread
    by_gain = -other * read.T * inverse + half * 2 * spread.T / gain[:, None]
    kinds = [by_scale, by_gain, -other * inverse]
    if fallen is not None:
        kinds.append(-(fallen * size).T * inverse)
    return r * inverse, kinds


def _logarithms(
    v: np.ndarray,
    both: np.ndarray,
    log_scale: np.ndarray,
    now: np.ndarray,
    noise: float,
    before: np.ndarray | None,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """The same of ln (rho_ln N_l / rho_nl N_n), nearly linear; biased where shares are not far
    above noise."""
    gain = now[: len(v)]
    read, fallen = _settled(v, both, now, before)
    share = 1 - read
    seen = both & (np.minimum(share, share.T) > _CLEAR * noise)
    share = np.where(seen, share, 1.0)
    own = np.log(share) + log_scale[:, None]
    inverse = np.where(seen, 1 / (noise * np.sqrt(share**-2.0 + share.T**-2.0)), 0.0)
    by_offset = -inverse / (gain * share).T
    kinds = [inverse, by_offset * read.T, by_offset]
    if fallen is not None:
        kinds.append(-inverse * (fallen / share).T)
    return (own - own.T) * inverse, kinds


class _Terms:
    """One frame's part of the normal equations, its N eliminated.

    both (n, n): which pairs were read; e, kinds: as `_differences` has them
    cost; misfit, chi-squared per equation
    """

    def __init__(self, both: np.ndarray, e: np.ndarray, kinds: list[np.ndarray]) -> None:
        self.left, self._kinds = e, kinds
        self.cost = float((e**2).sum() / 2)
        factors = np.count_nonzero(both.any(axis=1))
        self.misfit = self.cost / max(np.count_nonzero(both) / 2 - factors, 1)

    @cached_property
    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """(2 n, 2 n), (2 n,) the normal matrix of gains and offsets, and its right side; of 3 n with
        settling."""
        mixed, pull, back, start = self._eliminated
        block = [[_block(a, b) for b in self._kinds[1:]] for a in self._kinds[1:]]
        normal = np.block(block) - mixed.T @ back
        return (normal + normal.T) / 2, np.concatenate(pull) - mixed.T @ start

    def follow(self, change: np.ndarray) -> np.ndarray:
        """(n,) change of ln N with that of gains and offsets (2 n,)."""
        *_, back, start = self._eliminated
        return start - back @ change

    @cached_property
    def _eliminated(self) -> tuple[np.ndarray, list[np.ndarray], np.ndarray, np.ndarray]:
        """Of ln N: (n, 2 n) its block with gains and offsets, what these are pulled by, and what it
        follows them and the readings by."""
        if not np.isfinite(self._kinds).all() or not np.isfinite(self.left).all():
            raise np.linalg.LinAlgError("no gains explain the readings")
        scale, *others = self._kinds
        pull = [-(kind * self.left).sum(axis=1) for kind in self._kinds]
        first = _block(scale, scale)
        told = first.diagonal()  # 0: of none of an electrode's pairs there is an equation
        first = first + np.diag(np.where(told > 0, _LOOSE * told, 1.0))
        first += first.diagonal().mean() / len(first) ** 2  # one factor of all N is free
        mixed = np.hstack([_block(scale, other) for other in others])
        found = cho_solve(cho_factor(first), np.column_stack([mixed, pull[0]]))
        return mixed, pull[1:], found[:, :-1], found[:, -1]


def _block(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, n) normal block of two kinds of parameters, of all unordered pairs.

    first, second (n, n): derivative of e_ln by the parameter of its row's electrode l; that by n's
        is -(..)_nl.
    """
    out = -(first * second.T)
    np.fill_diagonal(out, (first * second).sum(axis=1))
    return out

"""Gains and offsets from reciprocity alone: no model of the sheet, no place, no force.

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
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

_STEPS = 30
_HALVINGS = 12  # of a step that does not lower the cost
_SETTLED = 0.01  # of the cost, in units of the noise: a hundredth of a standard deviation squared
_LOOSE = 1e-6  # of a row's weight: holds the common factor of a frame's N
_CLEAR = 5.0  # deviations of noise: shares above have a logarithm
_LEAST = 1e-3  # of a share: below, logarithms of it say nothing


@dataclass(frozen=True)
class Gains:
    """What reciprocity says: gain (n,), offset (n,) V, their covariance (2 n, 2 n), and of each
    frame chi-squared per equation (F,), and what is left, e of all pairs (F, n, n)."""

    gain: np.ndarray
    offset: np.ndarray
    covariance: np.ndarray
    misfit: np.ndarray
    left: np.ndarray


def fit_gains(
    frames: np.ndarray,
    drive: float,
    noise: float,
    gain: tuple[np.ndarray, np.ndarray],
    offset: tuple[np.ndarray, np.ndarray],
    steps: int = _STEPS,
) -> Gains:
    """Gains and offsets of n channels; LinAlgError where no gains explain the readings.

    Parameters
    ----------
    frames : (F, n, n) V, row l with electrode l grounded; NaN: not read. Of touches, not of the
        untouched sheet
    drive, noise : V; of a reading, V rms
    gain, offset : means and standard deviations (n,) of the prior; relative, V
    steps : of each of the two forms, at most; one is near enough to look at a frame
    """
    readings = np.asarray(frames, float) / drive
    count = readings.shape[-1]
    mean = np.concatenate([gain[0], np.asarray(offset[0]) / drive])
    deviation = np.concatenate([gain[1], np.asarray(offset[1]) / drive])
    own = np.arange(count)
    both = np.isfinite(readings) & np.isfinite(readings.transpose(0, 2, 1))
    both[:, own, own] = False
    readings = np.where(both, readings, 0.0)
    now = mean.copy()
    scale = np.array([_first_scale(v, m, now) for v, m in zip(readings, both)])

    for form in (_logarithms, _differences):  # the first converges from afar, the second is right

        def at(now, scale, form=form):
            """One term for each frame, and the cost of all; no number where steps are far too long."""
            with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
                terms = [
                    _Terms(m, *form(v, m, n, now, noise / drive))
                    for v, m, n in zip(readings, both, scale)
                ]
            return terms, sum(t.cost for t in terms) + (((now - mean) / deviation) ** 2).sum()

        terms, cost = at(now, scale)
        for _ in range(steps):
            normal, right = (sum(each) for each in zip(*(t.equations for t in terms)))
            total = np.diag(deviation**-2.0) + normal
            factor = cho_factor(total)
            change = cho_solve(factor, (mean - now) / deviation**2 + right)
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
    covariance = cho_solve(factor, np.eye(2 * count))
    units = np.concatenate([np.ones(count), np.full(count, drive)])
    covariance = covariance * units[:, None] * units
    misfit, left = (np.array(each) for each in zip(*((t.misfit, t.left) for t in terms)))
    return Gains(now[:count], now[count:] * drive, covariance, misfit, left)


def _first_scale(readings, both, now):
    """(n,) ln N from the ratios of the two readings of each pair."""
    count = len(readings)
    share = 1 - (readings - now[count:]) / now[:count]
    seen = both & (share > _LEAST) & (share.T > _LEAST)
    ratio = np.where(seen, np.log(np.where(seen, share.T / np.where(seen, share, 1), 1)), 0.0)
    weight = np.where(seen, np.minimum(share, share.T) ** 2, 0.0)
    # ln N_l - ln N_n = ratio_ln: a weighted graph Laplacian
    laplacian = np.diag(weight.sum(axis=1)) - weight
    right = (weight * ratio).sum(axis=1)
    return np.linalg.lstsq(laplacian + weight.sum() / count**3, right, rcond=None)[0]


def _differences(v, both, log_scale, now, noise):
    """(n, n) e, and its derivatives by ln N, gain and offset of the electrode of the row."""
    gain, offset = now[: len(v)], now[len(v) :]
    size = np.exp(log_scale)[:, None]
    own = (1 - (v - offset) / gain) * size  # rho_ln N_l
    r = own - own.T
    spread = (noise * size / gain) ** 2
    variance = spread + spread.T
    inverse = np.where(both, 1 / np.sqrt(variance), 0.0)
    half = np.where(both, r / (2 * variance**1.5), 0.0)
    other = (size / gain).T  # (l, n): N_n / a_l
    by_scale = own * inverse - half * 2 * spread
    by_gain = -other * ((v - offset) / gain).T * inverse + half * 2 * spread.T / gain[:, None]
    return r * inverse, (by_scale, by_gain, -other * inverse)


def _logarithms(v, both, log_scale, now, noise):
    """The same of ln (rho_ln N_l / rho_nl N_n), nearly linear; biased where shares are not far
    above noise."""
    gain, offset = now[: len(v)], now[len(v) :]
    share = 1 - (v - offset) / gain
    seen = both & (np.minimum(share, share.T) > _CLEAR * noise)
    share = np.where(seen, share, 1.0)
    own = np.log(share) + log_scale[:, None]
    inverse = np.where(seen, 1 / (noise * np.sqrt(share**-2.0 + share.T**-2.0)), 0.0)
    by_offset = -inverse / (gain * share).T
    return (
        (own - own.T) * inverse,
        (inverse, by_offset * ((v - offset) / gain).T, by_offset),
    )


class _Terms:
    """One frame's part of the normal equations, its N eliminated.

    both (n, n): which pairs were read; e, kinds: as `_differences` has them
    cost; misfit, chi-squared per equation
    """

    def __init__(self, both, e, kinds):
        self.left, self._kinds = e, kinds
        self.cost = float((e**2).sum() / 2)
        factors = np.count_nonzero(both.any(axis=1))
        self.misfit = self.cost / max(np.count_nonzero(both) / 2 - factors, 1)

    @cached_property
    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """(2 n, 2 n), (2 n,) the normal matrix of gains and offsets, and its right side."""
        mixed, pull, back, start = self._eliminated
        block = [[_block(a, b) for b in self._kinds[1:]] for a in self._kinds[1:]]
        normal = np.block(block) - mixed.T @ back
        return (normal + normal.T) / 2, np.concatenate(pull) - mixed.T @ start

    def follow(self, change: np.ndarray) -> np.ndarray:
        """(n,) change of ln N with that of gains and offsets (2 n,)."""
        *_, back, start = self._eliminated
        return start - back @ change

    @cached_property
    def _eliminated(self):
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


def _block(first, second):
    """(n, n) normal block of two kinds of parameters, of all unordered pairs.

    first, second (n, n): derivative of e_ln by the parameter of its row's electrode l; that by n's
        is -(..)_nl.
    """
    out = -(first * second.T)
    np.fill_diagonal(out, (first * second).sum(axis=1))
    return out

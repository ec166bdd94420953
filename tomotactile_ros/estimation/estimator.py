"""Frames in, contacts with their uncertainty out.

What is left out, and why, is part of the answer: channels that contradict all others, rows from before a change,
frames that no contacts explain.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse.csgraph import connected_components

from tomotactile_ros.contact import ContactLaw
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.screening import (
    dead_channels,
    latest_state,
    open_grounds,
    stuck_channels,
)
from tomotactile_ros.estimation.search import Search
from tomotactile_ros.estimation.solver import Fit, Prior, Rows
from tomotactile_ros.estimation.touch import CONDUCTANCE, RADIUS, X, Y, touches
from tomotactile_ros.layout import Layout

_KEPT = 4  # operators for sets of electrodes in use
_UNEXPLAINED = (
    2e-3  # of the readings' sum of squares: with more, the frame is not what the model knows
)
_SUSPECT = 12.0  # chi-squared per reading from which on channels are doubted and other rows tried
_REFUSED = (
    60.0  # the same from which on nothing is said; errors of 8 standard deviations everywhere
)
_FEWEST = 4  # rows that contacts are found from
_FEWEST_READINGS = 8  # a contact has four unknowns
_LATEST = 12  # rows of a frame that are looked at first where it changes
_MOST_LEFT_OUT = 3  # channels that are only known by their misfit
_SECOND_LOOK = 50  # budget of a search in other rows or without a channel
_TOUCHING = 1.15  # of the sum of two radii: discs nearer to each other are one contact
_CERTAIN = 3.0  # standard deviations of ln c: below, it is not even known that a contact conducts
_PLACE_FLOOR = (
    1.5e-3  # spacings: what the model of electrodes and contacts errs in places, standard deviation
)
_FORCE_FLOOR = 0.02  # the same of forces, relative


@dataclass(frozen=True)
class Contact:
    """One contact: place x, y (m), force (N), pressure (Pa), area (m²), radius (m), with uncertainty.

    conductance : g as a whole, S
    covariance : (4,) of x and y, row by row, m²; force_std : N; radius_std : m
    probability : that it is there
    """

    x: float
    y: float
    force: float
    pressure: float
    area: float
    radius: float
    conductance: float
    covariance: tuple[float, float, float, float]
    force_std: float
    radius_std: float
    probability: float


@dataclass(frozen=True)
class Estimate:
    """What rows say.

    contacts : strongest first; parts : the discs that they consist of
    state : `valid`, or `withheld` with the reason why
    left_out : {electrode: what is wrong with its channel}
    misfit : chi-squared per reading, about 1 where noise explains what the model does not
    first : number of the first row that was used; earlier ones belong to another state of the sheet
    """

    contacts: list[Contact]
    parts: list[Contact] = field(default_factory=list)
    state: str = "valid"
    reason: str = ""
    left_out: dict[int, str] = field(default_factory=dict)
    misfit: float = 0.0
    first: int = 0


@dataclass
class State:
    """What lasts from frame to frame: where the last fit ended, and of which electrodes."""

    unknowns: Unknowns | None = None
    used: tuple[int, ...] = ()

    def forget(self) -> None:
        self.unknowns = None


class Estimator:
    """Contacts from frames of one layout.

    Parameters
    ----------
    noise : of a reading, V rms; law : `ContactLaw`; radius : typical of a contact, m
    model : of the sheet; excluded : electrodes never used; channels : what is expected of them
    """

    def __init__(
        self,
        layout: Layout,
        *,
        noise: float,
        law: ContactLaw,
        radius: float,
        model: str = "auto",
        excluded=(),
        channels: ChannelPrior | None = None,
    ):
        self.layout, self.noise, self.law, self.radius = layout, noise, law, radius
        self.model, self.excluded = model, frozenset(excluded)
        self.channels = channels or ChannelPrior()
        self._searches: dict[tuple[int, ...], Search] = {}
        self._search(tuple(e for e in range(layout.electrodes) if e not in self.excluded))

    def estimate(self, voltages, grounded, drive_voltage: float, state: State) -> Estimate:
        """Contacts of rows `voltages` (L, E), V (NaN: not read), with electrodes `grounded` (L,) in turn."""
        voltages = np.asarray(voltages, float)
        grounded = np.asarray(grounded, int)
        valid = np.isfinite(voltages)
        left_out = {e: "excluded" for e in self.excluded}
        own = np.arange(len(grounded)), grounded
        read = valid.copy()
        read[own] = True
        valid[own] = False
        for electrode in np.flatnonzero(dead_channels(read)):
            left_out.setdefault(int(electrode), "no readings")
        for electrode in np.flatnonzero(stuck_channels(voltages, valid, self.noise)):
            left_out.setdefault(int(electrode), "its reading never changes")
        used = tuple(e for e in range(self.layout.electrodes) if e not in left_out)
        if len(used) < 2:
            return Estimate([], [], "withheld", "fewer than two electrodes can be read", left_out)
        search = self._search(used)
        rows, silent = self._rows(search, voltages, valid, grounded, drive_voltage)
        for electrode in silent:
            left_out.setdefault(int(electrode), "it is never grounded: its switch or wire is open")
        if rows.count < _FEWEST_READINGS:
            return Estimate([], [], "withheld", "too little was read", left_out)
        begun = latest_state(1 - rows.readings, rows.weights > 0, self.noise / drive_voltage)
        rows = rows.part(slice(begun, None))
        if rows.count < _FEWEST_READINGS or (begun and len(rows.grounded) < _FEWEST):
            reason = f"it was touched or let go within the last {len(rows.grounded)} rows"
            return Estimate([], [], "withheld", reason, left_out, first=begun)
        prior = Prior.unknown(search.operator, self.channels, self.radius, drive_voltage)
        start = state.unknowns if state.used == used else None
        fit, first = self._fit(search, rows, prior, start)
        first += begun
        fit = self._without_bad_channels(search, fit, left_out)
        state.unknowns, state.used = fit.unknowns, used
        reason, misfit = self._refusal(fit), fit.chi_squared / fit.rows.count
        if reason:
            state.forget()
            return Estimate([], [], "withheld", reason, left_out, misfit, first)
        parts = self._contacts(fit)
        if not parts and len(fit.unknowns.contacts) and search.untouched(fit.rows, prior) is None:
            reason = "something touches, too weakly or too widely to say where"
            return Estimate([], [], "withheld", reason, left_out, misfit, first)
        return Estimate(joined(parts), parts, "valid", "", left_out, misfit, first)

    def _search(self, used) -> Search:
        if used not in self._searches:
            if len(self._searches) >= _KEPT:
                self._searches.pop(next(iter(self._searches)))
            self._searches[used] = Search(SheetOperator(self.layout, self.model, used))
        return self._searches[used]

    def _rows(self, search, voltages, valid, grounded, drive_voltage):
        """`Rows` of the electrodes in use, and electrodes that were never grounded."""
        operator = search.operator
        used = operator.used
        variance = (self.noise / drive_voltage) ** 2
        at = operator.position[grounded]
        readings = np.where(valid, voltages, 0.0)[:, used] / drive_voltage
        weights = valid[:, used] / variance
        silent = open_grounds(1 - readings, weights > 0, self.noise / drive_voltage)
        kept = (at >= 0) & ~silent & (weights > 0).any(axis=1)
        return Rows(readings[kept], weights[kept], at[kept]), grounded[silent & (at >= 0)]

    def _fit(self, search: Search, rows: Rows, prior: Prior, start) -> tuple[Fit, int]:
        """The fit of all rows, or of those since the last change where they contradict each other."""
        fit = search.contacts(rows, prior, start)
        if start is not None and _is_suspect(fit):
            fit = _better(fit, search.contacts(rows, prior))
        if not _is_suspect(fit) or len(rows.grounded) < 2 * _FEWEST:
            return fit, 0
        return self._since_change(search, rows, prior, fit)

    def _since_change(self, search, rows, prior, whole: Fit) -> tuple[Fit, int]:
        """The fit of the last rows, of as many as one state explains; `whole` where that is no better."""
        count = len(rows.grounded)
        latest = min(_LATEST, count // 2)
        late = search.contacts(rows.part(slice(count - latest, count)), prior, budget=_SECOND_LOOK)
        if _share_left(late) > _share_left(whole) / 4:
            return whole, 0
        first = count - latest
        everywhere = Fit(search.operator, late.unknowns, rows, prior)
        by_row = (rows.weights * everywhere.misfit**2).sum(axis=1)
        signal = (rows.weights * rows.readings**2).sum(axis=1)
        fits = by_row < np.maximum(4.0 * (rows.weights > 0).sum(axis=1), _UNEXPLAINED * signal)
        while first > 0 and fits[first - 1]:
            first -= 1
        if first < count - latest:
            late = _better_share(
                late, search.contacts(rows.part(slice(first, count)), prior, late.unknowns)
            )
        return late, count - len(late.rows.grounded)

    def _without_bad_channels(self, search, fit: Fit, left_out) -> Fit:
        """Leaves out the channels that contradict all others, one after the other, as long as that helps."""
        used = search.operator.used
        for _ in range(_MOST_LEFT_OUT):
            if not _is_suspect(fit):
                break
            by_column = (fit.rows.weights * fit.misfit**2).sum(axis=0)
            np.add.at(by_column, fit.rows.grounded, (fit.rows.weights * fit.misfit**2).sum(axis=1))
            worst = int(by_column.argmax())
            weights = fit.rows.weights.copy()
            weights[:, worst] = 0.0
            weights[fit.rows.grounded == worst] = 0.0
            rows = replace(fit.rows, weights=weights)
            tried = search.contacts(rows, fit.prior, budget=_SECOND_LOOK)
            if tried.chi_squared / tried.rows.count > 0.25 * fit.chi_squared / fit.rows.count:
                break
            left_out[int(used[worst])] = "its readings contradict all others"
            fit = tried
        return fit

    def _refusal(self, fit: Fit) -> str:
        if fit.chi_squared > _REFUSED * fit.rows.count:
            left = np.sqrt(_share_left(fit))
            return (
                "no contacts explain the readings, or they changed within the last rows: "
                f"{left:.1%} of them is left over"
            )
        return ""

    def _contacts(self, fit: Fit) -> list[Contact]:
        u = fit.unknowns
        if not len(u.contacts):
            return []
        operator, prediction = fit.operator, fit.prediction
        moved, _ = touches(operator, u.contacts, u.across, u.free, u.sheet)
        inflation = max(1.0, fit.chi_squared / fit.rows.count)
        covariance = fit.covariance * inflation
        found, first = [], 0
        for i, (touch, contact, free) in enumerate(zip(moved, u.contacts, u.free)):
            count = int(free.sum())
            own = covariance[first : first + count, first : first + count]
            first += count
            index = {which: k for k, which in enumerate(np.flatnonzero(free))}
            area = np.pi * float(np.exp(2 * contact[RADIUS])) * touch.covered
            g = prediction.conductances[i] * touch.covered
            pressure = float(self.law.pressure(g / area))
            slope = prediction.force_slope(i, touch, self.law.exponent)[free]
            relative = float(np.sqrt(slope @ own @ slope + _FORCE_FLOOR**2))
            place = own[np.ix_([index[X], index[Y]], [index[X], index[Y]])]
            place = place + np.eye(2) * (_PLACE_FLOOR * operator.pitch) ** 2
            x, y = touch.centre(operator)
            radius = float(np.sqrt(area / np.pi))
            certainty = 1 / max(own[index[CONDUCTANCE], index[CONDUCTANCE]], 1e-12)
            if certainty < _CERTAIN**2:
                continue
            found.append(
                Contact(
                    float(x),
                    float(y),
                    pressure * area,
                    pressure,
                    area,
                    radius,
                    g,
                    tuple(float(each) for each in place.ravel()),
                    abs(pressure * area) * min(relative, 10.0),
                    radius * float(np.sqrt(own[index[RADIUS], index[RADIUS]])),
                    float(1 - np.exp(-certainty / 2)),
                )
            )
        return sorted(found, key=lambda each: -each.force)


def joined(parts: list[Contact]) -> list[Contact]:
    """Contacts from discs: those that touch each other are one, wide or of a free shape; strongest first."""
    if len(parts) < 2:
        return parts
    places = np.array([[each.x, each.y] for each in parts])
    radii = np.array([each.radius for each in parts])
    apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    touching = apart < _TOUCHING * np.add.outer(radii, radii)
    count, group = connected_components(touching, directed=False)
    found = [_joined([parts[i] for i in np.flatnonzero(group == each)]) for each in range(count)]
    return sorted(found, key=lambda each: -each.force)


def _joined(parts: list[Contact]) -> Contact:
    if len(parts) == 1:
        return parts[0]
    force = np.array([each.force for each in parts])
    share = force / max(force.sum(), 1e-300)
    area = sum(each.area for each in parts)
    covariance = sum(s**2 * np.array(each.covariance) for s, each in zip(share, parts))
    radius = float(np.sqrt(area / np.pi))
    return Contact(
        float(sum(s * each.x for s, each in zip(share, parts))),
        float(sum(s * each.y for s, each in zip(share, parts))),
        float(force.sum()),
        max(each.pressure for each in parts),
        area,
        radius,
        sum(each.conductance for each in parts),
        tuple(float(each) for each in covariance),
        float(np.sqrt(sum(each.force_std**2 for each in parts))),
        float(np.sqrt(sum(each.radius_std**2 for each in parts))),
        max(each.probability for each in parts),
    )


def _share_left(fit: Fit) -> float:
    """Part of the readings' sum of squares that neither the model nor noise explains."""
    signal = float((fit.rows.weights * fit.rows.readings**2).sum())
    excess = max(fit.chi_squared - 1.5 * fit.rows.count, 0.0)
    return excess / max(signal, 1e-300)


def _is_suspect(fit: Fit) -> bool:
    return fit.chi_squared > _SUSPECT * fit.rows.count


def _better(first: Fit, second: Fit) -> Fit:
    return first if first.cost <= second.cost else second


def _better_share(first: Fit, second: Fit) -> Fit:
    """The second unless it explains much less."""
    return (
        second if not _is_suspect(second) or _share_left(second) < 2 * _share_left(first) else first
    )

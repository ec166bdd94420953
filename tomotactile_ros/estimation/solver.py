"""The one solver: maximum a posteriori of contacts, sheet and channels by Gauss-Newton with
Levenberg's damping.

Minimises the sum of ((reading - prediction) / noise)^2 and of what the priors take for each unknown
(Tarantola 2005, chapter 3). Channels are eliminated first; the damping acts on contacts alone, the
rest is nearly linear.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tomotactile_ros.estimation.channels import KINDS, ChannelFit, ChannelPrior, Slopes
from tomotactile_ros.estimation.forward import RATED, Prediction, Unknowns
from tomotactile_ros.estimation.motion import predicted
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.touch import CONDUCTANCE, RADIUS, STRETCH, X, Y

# of the cost, which is in units of the noise: a twentieth of one standard deviation squared
_CONVERGED = 0.05
REACH, REACH_STRENGTH = 0.3, 1.5  # spacings and of ln c: one linearisation holds for it
STEPS = 12  # at most, from one start
_TRIES = 6  # of damping in one step
_FEW_TRIES, _LITTLE = (
    2,
    0.2,
)  # after so many tries a step that promises less of the cost is not insisted on
_LEAST = 1e-9  # conductance of a contact in parts of an electrode's: far below what noise hides
# conductance of a contact, in parts of one over its mean D: a bare conductor, beyond which no reading changes
_MOST = 1.2
_FIRST_DAMPING = 1e-3
_NEARER = (
    1.0  # of the doubted cost: a standard deviation, squared; the whole fit takes on from there
)
_HELD = 1e-2  # of the deviations of a sensor that is held
_ROUNDING = 1e-11  # of the diagonal of the normal matrix
_HOPE = 3.0  # times what a step gained, all that follow may gain
RATES = (
    0.3,
    0.3,
    10.0,
)  # m/s, m/s, 1/s: a hand slides at up to 1 m/s, and presses or lets go within 0.1 s
# spacings that contacts move before derivatives by the sheet are taken anew, and as much in form
SIMILAR = 0.04
_STILL = 0.01  # the same for derivatives by the contacts


@dataclass(frozen=True)
class Rows:
    """What was read: L rows of the n electrodes in use.

    readings (L, n) in parts of V0; weights (L, n) one over the variance of the noise, 0 where
        nothing was read
    grounded (L,) electrode in use that is grounded in each row
    times (L,) s, of each row against the time for which contacts are estimated; None where all were
        read at once
    """

    readings: np.ndarray
    weights: np.ndarray
    grounded: np.ndarray
    times: np.ndarray | None = None

    @property
    def count(self) -> int:
        """Number of readings."""
        return int(np.count_nonzero(self.weights))

    def corrected(self, channels) -> Rows:
        """What channels without gains and offsets would have read; `channels` has both: `Prior`,
        `Unknowns`."""
        read = (self.readings - channels.offset) / channels.gain
        return replace(self, readings=np.where(self.weights > 0, read, 0.0))

    def part(self, chosen) -> Rows:
        """Only the rows `chosen`; contacts are estimated for the middle of their time."""
        times = None if self.times is None else self.times[chosen]
        if times is not None and len(times):
            times = times - (times.min() + times.max()) / 2
        return Rows(self.readings[chosen], self.weights[chosen], self.grounded[chosen], times)


@dataclass(frozen=True)
class Prior:
    """What is expected before the readings.

    radius, spread : median of contacts' radii, m, and standard deviation of their logarithm
    stretch : standard deviation of p and q of a contact that is no disc
    rates : (3,) of how fast x and y change, m/s, and ln c, 1/s
    sheet, sheet_deviation : (J,) means and standard deviations of the sheet's coefficients
    gain, offset, resistance : (n,) means, 1, parts of V0, ohm; aside (2, n) m
    deviations : (n,) standard deviation of each of them, aside in x and y last
    precision : (J + 5 n, J + 5 n) inverse covariance of sheet, gains, offsets, resistances and ways
        aside, of which the deviations are the marginal ones; None: all are independent
    learned : whether all this is of this very sensor: contacts are then fitted first, the sensor is
        only trimmed
    """

    radius: float
    spread: float
    stretch: float
    sheet: np.ndarray
    sheet_deviation: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    resistance: np.ndarray
    aside: np.ndarray
    deviations: tuple[np.ndarray, ...]
    rates: tuple[float, float, float] = RATES
    learned: bool = False
    precision: np.ndarray | None = None

    def held(self) -> Prior:
        """The same sensor, as good as certain."""
        return self.narrowed(_HELD)

    def narrowed(self, part: float) -> Prior:
        """The same sensor, all its deviations times `part`."""
        return replace(
            self,
            sheet_deviation=part * self.sheet_deviation,
            deviations=tuple(part * each for each in self.deviations),
            precision=None if self.precision is None else self.precision / part**2,
        )

    def told(self, found: Unknowns, information: np.ndarray) -> Prior:
        """The sensor as it was `found`, with what rows say of it: `information` (J + 5 n, J + 5 n)
        in the units of `precision`."""
        before = self.precision
        if before is None:
            before = np.diag(np.concatenate([self.sheet_deviation, *self.deviations]) ** -2.0)
        precision = before + information
        deviation = np.sqrt(np.linalg.inv(precision).diagonal())
        modes = len(self.sheet)
        return replace(
            self,
            sheet=found.sheet,
            gain=found.gain,
            offset=found.offset,
            resistance=found.resistance,
            aside=found.aside,
            sheet_deviation=deviation[:modes],
            deviations=tuple(deviation[modes:].reshape(KINDS, -1)),
            precision=precision,
        )

    def apart(self, unknowns: Unknowns) -> np.ndarray:
        """(J + 5 n,) what sheet, gains, offsets, resistances and ways aside are more than
        expected."""
        expected = self.sheet, self.gain, self.offset, self.resistance, *self.aside
        found = (
            unknowns.sheet,
            unknowns.gain,
            unknowns.offset,
            unknowns.resistance,
            *unknowns.aside,
        )
        return np.concatenate([now - mean for now, mean in zip(found, expected)])

    def pull(self, apart: np.ndarray) -> np.ndarray:
        """(J + 5 n,) inverse covariance times `apart`."""
        if self.precision is not None:
            return self.precision @ apart
        return apart / np.concatenate([self.sheet_deviation, *self.deviations]) ** 2

    @classmethod
    def unknown(
        cls, operator: SheetOperator, channels: ChannelPrior, radius: float, drive: float
    ) -> Prior:
        """Nothing has been learned of this sensor; its switches are of one kind."""
        count, modes = operator.count, operator.modes
        deviations = channels.deviations(count, drive, operator.pitch)
        precision = np.diag(np.concatenate([operator.deviation, *deviations]) ** -2.0)
        resistances = slice(modes + 2 * count, modes + 3 * count)
        precision[resistances, resistances] = channels.precision_of_resistances(count)
        return cls(
            radius,
            0.6,
            0.25,
            np.zeros(operator.modes),
            operator.deviation,
            np.ones(count),
            np.zeros(count),
            np.zeros(count),
            np.zeros((2, count)),
            deviations,
            precision=precision,
        )


class Fit:
    """A point with its misfit.

    Attributes
    ----------
    unknowns, prediction; misfit (L, n) reading minus prediction; chi_squared of the readings; cost
        with the priors
    covariance (F, F) of the contacts' free parameters, all else marginal; None before `solve`
    steps, work : of the `solve` or `approach` that ended here, the number of steps and that of patches
        in all evaluations of the forward model; 0 before
    equations : the last ones of `solve`, None before
    promised : what one more contact would take off the cost to first order, as far as that was
        asked
    """

    def __init__(
        self,
        operator: SheetOperator,
        unknowns: Unknowns,
        rows: Rows,
        prior: Prior,
        prediction: Prediction | None = None,
    ):
        self.operator, self.unknowns, self.rows, self.prior = operator, unknowns, rows, prior
        self.prediction = prediction or predicted(operator, unknowns, rows.grounded, rows.times)
        self.misfit = rows.readings - self.prediction.readings
        self.chi_squared = float((rows.weights * self.misfit**2).sum())
        self.cost = self.chi_squared + self._of_priors()
        self.covariance = self.equations = None
        self.steps, self.work, self.promised = 0, 0, 0.0

    def weighed(self, rows: Rows) -> Fit:
        """The same point as one of `rows` that differ in their weights only."""
        other = copy(self)
        other.rows = rows
        other.chi_squared = float((rows.weights * self.misfit**2).sum())
        other.cost = self.cost - self.chi_squared + other.chi_squared
        return other

    def freed(self, free: np.ndarray) -> Fit:
        """The same point with other parameters of the contacts `free` (k, 6)."""
        other = copy(self)
        other.unknowns = replace(self.unknowns, free=free)
        other.prediction = self.prediction.freed(other.unknowns)
        other.covariance = None
        return other

    def of(self, unknowns: Unknowns, rows: Rows, prior: Prior) -> Fit:
        """The fit of `unknowns` and other rows: what is predicted is only worked out where it is not the
        same."""
        known = self.prediction
        same = self.unknowns.same_point(unknowns) and np.array_equal(
            self.rows.grounded, rows.grounded
        )
        return Fit(self.operator, unknowns, rows, prior, known.freed(unknowns) if same else None)

    @property
    def of_sensor(self) -> float:
        """What the prior of the sensor takes of the cost."""
        apart = self.prior.apart(self.unknowns)
        return float(apart @ self.prior.pull(apart))

    def _of_priors(self) -> float:
        u, prior = self.unknowns, self.prior
        cost = self.of_sensor
        contacts = u.contacts
        cost += (((contacts[:, RADIUS] - np.log(prior.radius)) / prior.spread) ** 2).sum()
        cost += ((contacts[:, STRETCH:] / prior.stretch) ** 2).sum()
        cost += ((u.rates / prior.rates) ** 2).sum()
        return float(cost)

    @property
    def doubt(self) -> float:
        """What a significant change of the cost is to be multiplied with: 1 where noise explains
        the misfit.

        What the model lacks makes all readings of an electrode err together; its excess counts once
        for each.
        """
        return self.doubt_after(0.0)

    def doubt_after(self, explained: float) -> float:
        """`doubt` if so much less of chi-squared were left over."""
        excess = self.chi_squared - explained - self.rows.count
        return 1.0 + max(excess, 0.0) / self.operator.count

    @property
    def slopes(self) -> Slopes:
        """Derivatives of the readings by the channels."""
        u, prediction = self.unknowns, self.prediction
        columns, rows = prediction.aside
        driven = (prediction.readings - u.offset) / u.gain
        in_columns = np.array([driven, np.ones_like(driven), *(u.gain * columns)])
        in_rows = u.gain * np.array([prediction.ratio / prediction.own[:, None], *rows])
        return Slopes(in_columns, in_rows, self.rows.grounded)


class SheetColumns:
    """Derivatives of the readings by the sheet's coefficients, at a fit.

    They change slowly with the contacts, and only how fast the solver converges depends on them.

    Attributes
    ----------
    columns (J, L, n); flat, weighted (J, L n) the same, and times the weights
    normal (J, J) their normal matrix
    """

    def __init__(self, fit: Fit):
        self.columns = fit.prediction.sheet_columns()
        weighted = self.columns * fit.rows.weights
        shape = len(weighted), fit.misfit.size
        self.flat, self.weighted = self.columns.reshape(shape), weighted.reshape(shape)
        self.normal = self.weighted @ self.flat.T
        self._rows, self._contacts = fit.rows, fit.unknowns.contacts

    def serves(self, fit: Fit) -> bool:
        """Whether they are good enough at another fit."""
        contacts = fit.unknowns.contacts
        return _same_rows(self._rows, fit.rows) and similar(
            contacts, self._contacts, fit.operator.pitch
        )


def similar(
    contacts: np.ndarray, others: np.ndarray, pitch: float, within: float = SIMILAR
) -> bool:
    """Whether contacts (k, 6) are nearly the same as others, one by one."""
    if len(contacts) != len(others):
        return False
    limits = within * np.array([pitch, pitch, 4, 8, 8, 8])
    return bool((np.abs(contacts - others) <= limits).all())


def _same_sensor(first: Prior, second: Prior) -> bool:
    """Whether two expectations weigh the sensor alike."""
    if (first.precision is None) != (second.precision is None):
        return False
    if first.precision is not None:
        return np.array_equal(first.precision, second.precision)
    both = zip(
        (first.sheet_deviation, *first.deviations), (second.sheet_deviation, *second.deviations)
    )
    return all(np.array_equal(*each) for each in both)


def _same_rows(first: Rows, second: Rows) -> bool:
    return first is second or (
        np.array_equal(first.grounded, second.grounded)
        and np.array_equal(first.weights, second.weights)
    )


class Contacts:
    """Normal equations of the contacts alone at a fit, the sensor as it is there; `step(damping)`
    solves them.

    Attributes
    ----------
    free : number of the contacts' free parameters; flat (F, L n) derivatives by them, times the
        weights; normal (P, P), right (P,) of all parameters; beside : what all that is not a
        parameter here takes off the cost
    promised, whole : of the last step: how much the cost should fall by the linear model; whether
        the step is hardly damped and not limited
    """

    def __init__(self, fit: Fit):
        self.fit = fit
        contacts = fit.prediction.contact_columns()
        self.free = len(contacts)
        self.flat = (contacts * fit.rows.weights).reshape(self.free, fit.misfit.size)
        curvature, pull = contact_priors(fit)
        self.normal = self.flat @ contacts.reshape(self.flat.shape).T + np.diag(curvature)
        self.right = self.flat @ fit.misfit.ravel() + pull
        self.beside = 0.0

    def step(self, damping: float) -> Unknowns:
        """Where the damped step leads."""
        scale = 1 / np.sqrt(self.normal.diagonal())
        scaled = self.normal * scale[:, None] * scale
        scaled[np.diag_indices(self.free)] += damping
        step = scale * cho_solve(cho_factor(scaled), scale * self.right)
        self.promised = float(step @ (2 * self.right - self.normal @ step)) + self.beside
        longest = np.abs(self._by_contact(step) / _limits(self.fit)).max(initial=0.0)
        self.whole = damping <= _FIRST_DAMPING and longest <= 1
        return self._moved(step / max(longest, 1.0))

    @property
    def promise(self) -> float:
        """What an undamped step takes off the cost, to first order."""
        scale = 1 / np.sqrt(self.normal.diagonal())
        right = scale * self.right
        step = np.linalg.lstsq(self.normal * scale[:, None] * scale, right, rcond=1e-12)[0]
        return float(right @ step) + self.beside

    def _by_contact(self, step):
        free = self.fit.unknowns.free
        out = np.zeros(free.shape)
        out[free] = step[: np.count_nonzero(free)]
        return out

    def _moved(self, step):
        u, operator = self.fit.unknowns, self.fit.operator
        contacts = u.contacts + self._by_contact(step)
        half = np.array(operator.layout.outline.size) / 2
        contacts[:, X : Y + 1] = np.clip(contacts[:, X : Y + 1], -half, half)
        largest = np.log(max(operator.layout.outline.size))
        contacts[:, RADIUS] = np.clip(contacts[:, RADIUS], np.log(_smallest(operator)), largest)
        contacts[:, STRETCH:] = np.clip(contacts[:, STRETCH:], -1.5, 1.5)
        least = np.log(_LEAST * operator.admittance.diagonal().max())
        most = np.log(_MOST / np.maximum(self.fit.prediction.means, 1e-9))
        contacts[:, CONDUCTANCE] = np.clip(contacts[:, CONDUCTANCE], least, np.maximum(most, least))
        rates = u.rates.copy()
        rates[u.moving] += step[np.count_nonzero(u.free) : self.free].reshape(-1, len(RATED))
        return replace(u, contacts=contacts, rates=rates)


class Equations:
    """All that the normal equations of contacts, sheet and channels have at a fit whatever the
    readings are.

    Attributes
    ----------
    contacts (F, L n) derivatives by the contacts' free parameters, times the weights
    sheet : derivatives by the coefficients of the sheet
    channels : the part of the channels, eliminated
    normal (F + J, F + J) normal matrix of contacts and sheet with the priors
    """

    def __init__(self, contacts: Contacts, sheet: SheetColumns | None = None):
        fit = contacts.fit
        prior, rows = fit.prior, fit.rows
        self.sheet = sheet if sheet is not None and sheet.serves(fit) else SheetColumns(fit)
        self.contacts = contacts.flat
        self._fit = fit
        mixed = self.contacts @ self.sheet.flat.T
        block = self.sheet.normal + _sheet_block(prior, fit.operator.modes)
        normal = np.block([[contacts.normal, mixed], [mixed.T, block]])
        shape = -1, *fit.misfit.shape
        both = self.contacts.reshape(shape), self.sheet.weighted.reshape(shape)
        self.channels = ChannelFit(
            both, rows.weights, fit.slopes, prior.deviations, prior.precision
        )
        self.normal = normal - self.channels.normal
        # what rounding takes off a difference of matrices
        self.normal[np.diag_indices(len(normal))] += _ROUNDING * normal.diagonal()

    def response(self, misfits: np.ndarray) -> np.ndarray:
        """(F, m) how the contacts' parameters answer to `misfits` (m, L, n), all else marginal."""
        if not len(misfits):
            return np.empty((len(self.contacts), 0))
        flat = misfits.reshape(len(misfits), -1).T
        right = np.concatenate([self.contacts @ flat, self.sheet.weighted @ flat])
        right -= np.array([self.channels.pulled(each, 0.0)[1] for each in misfits]).T
        scale = 1 / np.sqrt(self.normal.diagonal())
        scaled = self.normal * scale[:, None] * scale
        found = scale[:, None] * np.linalg.solve(scaled, scale[:, None] * right)
        return found[: len(self.contacts)]

    def score(self, fit: Fit, free: np.ndarray) -> float:
        """What the contacts' parameters `free` (k, 6), held so far, would take off the cost of a `fit`
        near, to first order and all else following (score test, Rao 1948)."""
        freed = fit.freed(free)
        curvature, pull = contact_priors(freed)
        count = np.count_nonzero(free)
        columns = freed.prediction.contact_columns()[:count]
        weighted = (columns * fit.rows.weights).reshape(count, fit.misfit.size)
        mixed, back = self.channels.beside(weighted.reshape(columns.shape))
        flat = columns.reshape(weighted.shape)
        others = np.hstack([flat @ self.contacts.T, flat @ self.sheet.weighted.T])
        others -= mixed @ self.channels.back
        normal = weighted @ flat.T - mixed @ back
        normal[np.diag_indices(count)] += curvature[:count]
        along = Linear(fit, self)
        right = weighted @ fit.misfit.ravel() + pull[:count] - mixed @ along.alone
        scale = 1 / np.sqrt(self.normal.diagonal())
        factor = cho_factor(self.normal * scale[:, None] * scale)
        follow = scale[:, None] * cho_solve(factor, scale[:, None] * others.T)
        normal -= others @ follow
        right -= follow.T @ along.right
        return float(right @ np.linalg.lstsq(normal, right, rcond=1e-12)[0])

    def serves(self, fit: Fit) -> bool:
        """Whether they are good enough at another fit, of other readings: how fast the solver
        converges depends on them, and the covariance."""
        known = self._fit
        return (
            np.array_equal(known.unknowns.free, fit.unknowns.free)
            and not (known.unknowns.moving.any() or fit.unknowns.moving.any())
            and _same_rows(known.rows, fit.rows)
            and _same_sensor(known.prior, fit.prior)
            and similar(known.unknowns.contacts, fit.unknowns.contacts, fit.operator.pitch, _STILL)
        )


class Linear(Contacts):
    """Normal equations of contacts and sheet at a fit, channels eliminated.

    equations : all of them but the right side, from a fit nearby or anew
    alone : steps of the channels if nothing else moves, see `ChannelFit.pulled`
    """

    def __init__(self, fit: Fit, known: Equations | None = None):
        self.fit = fit
        curvature, pull = contact_priors(fit)
        self.free = len(curvature)
        if known is None or not known.serves(fit):
            super().__init__(fit)
            known = Equations(self, None if known is None else known.sheet)
        self.equations, self.normal = known, known.normal
        sensor = -fit.prior.pull(fit.prior.apart(fit.unknowns))
        modes, misfit = fit.operator.modes, fit.misfit.ravel()
        both = known.contacts @ misfit + pull, known.sheet.weighted @ misfit + sensor[:modes]
        self.alone, taken, self.beside = known.channels.pulled(fit.misfit, sensor[modes:])
        self.right = np.concatenate(both) - taken

    def covariance(self) -> np.ndarray:
        """(F, F) of the contacts' free parameters."""
        scale = 1 / np.sqrt(self.normal.diagonal())
        inverse = np.linalg.inv(self.normal * scale[:, None] * scale)
        return (inverse * scale[:, None] * scale)[: self.free, : self.free]

    def _moved(self, step):
        u = self.fit.unknowns
        gain, offset, resistance, *aside = self.equations.channels.step(self.alone, step)
        return replace(
            super()._moved(step),
            sheet=u.sheet + step[self.free :],
            gain=u.gain + gain,
            offset=u.offset + offset,
            resistance=u.resistance + resistance,
            aside=u.aside + aside,
        )


def contact_priors(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """(F,) each: what the priors of the contacts' free parameters and rates add to the diagonal of
    the normal matrix and to its right side."""
    u, prior = fit.unknowns, fit.prior
    curvature = np.zeros(u.contacts.shape)
    pull = np.zeros(u.contacts.shape)
    curvature[:, X : Y + 1] = max(fit.operator.layout.outline.size) ** -2.0  # somewhere
    curvature[:, CONDUCTANCE] = 1e-2  # a tenfold change is nothing unusual
    curvature[:, RADIUS] = prior.spread**-2
    pull[:, RADIUS] = (np.log(prior.radius) - u.contacts[:, RADIUS]) / prior.spread**2
    curvature[:, STRETCH:] = prior.stretch**-2
    pull[:, STRETCH:] = -u.contacts[:, STRETCH:] / prior.stretch**2
    rates = np.broadcast_to(np.array(prior.rates) ** -2.0, u.rates[u.moving].shape)
    return (
        np.concatenate([curvature[u.free], rates.ravel()]),
        np.concatenate([pull[u.free], (-u.rates[u.moving] * rates).ravel()]),
    )


def _sheet_block(prior: Prior, modes: int) -> np.ndarray:
    """(J, J) of the sheet's coefficients in the inverse covariance."""
    if prior.precision is None:
        return np.diag(prior.sheet_deviation**-2.0)
    return prior.precision[:modes, :modes]


def approach(fit: Fit, most: float = np.inf) -> Fit:
    """Nearer to the best fit, by steps of the contacts alone, of which each costs a third of a whole
    one; `steps` is their number. It ends after `most` work, see `Fit`.

    Far from where they belong, contacts and sheet together may end where a sheet that is bent to
    the readings holds contacts in a wrong place. What the sensor leaves over is doubted in the same
    way as everywhere (`Fit.doubt`), so that it does not bend the contacts either.
    """
    rows, damping, steps, work = fit.rows, _FIRST_DAMPING, 0, 0
    while steps < STEPS and work < most:
        doubted = fit.weighed(replace(rows, weights=rows.weights / fit.doubt))
        better, damping, more = _descend(Contacts(doubted), damping)
        steps, work = steps + 1, work + more
        if better is None:
            break
        fit = better.weighed(rows)
        if doubted.cost - better.cost < _NEARER:
            break
    fit.steps, fit.work = steps, work
    return fit


def solve(
    operator: SheetOperator,
    start: Unknowns,
    rows: Rows,
    prior: Prior,
    steps: int = STEPS,
    known: Equations | None = None,
    goal: float = np.inf,
    at: Fit | None = None,
    most: float = np.inf,
) -> Fit:
    """The best fit that at most `steps` steps from `start` lead to, with its covariance.

    It ends where nothing tells that a cost as low as `goal` will be reached, and after `most` work,
    see `Fit`. `at` : the fit of `start`, where it is known; `known` : equations that an earlier fit
    ended with.
    """
    fit, damping, work = at or Fit(operator, start, rows, prior), _FIRST_DAMPING, 0
    for step in range(steps):
        linear = Linear(fit, known)
        known = linear.equations
        better, damping, more = _descend(linear, damping)
        work += more
        gained = 0.0 if better is None else fit.cost - better.cost
        if better is not None:
            fit = better
        settled = _CONVERGED * fit.doubt
        # after a short whole step the next takes off less than what the linear model was wrong by
        exact = linear.whole and abs(gained - linear.promised) < settled and known.sheet.serves(fit)
        if gained < settled or exact or work >= most:
            break
        if step and fit.cost - _HOPE * gained > goal:
            break
    fit.steps, fit.work = step + 1, work
    fit.covariance, fit.equations = linear.covariance(), known
    return fit


def _descend(linear: Contacts, damping: float) -> tuple[Fit | None, float, int]:
    """The next fit that is better, None if there is none, the damping to begin with there, and the
    work that it took."""
    fit, work = linear.fit, 0
    for tries in range(_TRIES):
        reached = linear.step(damping)
        if linear.promised < _CONVERGED * fit.doubt:
            break
        if tries >= _FEW_TRIES and linear.promised < _LITTLE * (fit.chi_squared - fit.rows.count):
            break
        tried = Fit(fit.operator, reached, fit.rows, fit.prior)
        work += tried.prediction.size
        if tried.cost < fit.cost:
            return tried, damping / 10, work
        damping = max(damping, 1e-4) * 10
    return None, damping, work


def _smallest(operator) -> float:
    """Radius of the smallest contact, m: a fiftieth of the spacing, where nothing tells it from a
    point."""
    return operator.pitch / 50


def _limits(fit) -> np.ndarray:
    """How far contacts may move in one step, in the units of their parameters."""
    reach = REACH * fit.operator.pitch
    return np.array([reach, reach, REACH_STRENGTH, 0.5, 0.3, 0.3])

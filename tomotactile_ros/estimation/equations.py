"""Normal equations at a fit: of contacts alone, and of contacts, sheet and channels.

Channels are eliminated first (`channels`); derivatives by the sheet are kept while contacts stay.
Linearised least squares with priors (Tarantola 2005, chapter 3); the damping acts on contacts
alone, the rest is nearly linear.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tomotactile_ros.estimation.channels import ChannelFit
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import RATED, Prediction, Unknowns
from tomotactile_ros.estimation.observation import same_rows
from tomotactile_ros.estimation.prior import Prior, same_sensor
from tomotactile_ros.estimation.touch import CONDUCTANCE, LONGEST, RADIUS, STRETCH, X, Y

REACH, REACH_STRENGTH = 0.3, 1.5  # spacings and of ln c: one linearisation holds for it
_LEAST = 1e-9  # conductance of a contact in parts of an electrode's: far below what noise hides
# conductance of a contact, in parts of one over its mean D: a bare conductor, beyond which no reading changes
_MOST = 1.2
# radius of the smallest contact, typical radii: 2.3 deviations of what is expected (`Prior.spread`)
_SMALL = 0.25
FIRST_DAMPING = 1e-3
_ROUNDING = 1e-11  # of the diagonal of the normal matrix
# spacings that contacts move before derivatives by the sheet are taken anew, and as much in form
SIMILAR = 0.04
# the same for what was asked of them: whether they are needed, and which are one
SAME = 0.1
_ALIKE = 0.1  # of the largest admittance that a shape adds: the same for shapes
_STILL = 0.01  # the same for derivatives by the contacts
# of `Prediction.answering`: with more between them, equations of one fit tell wrong deviations of another
_BENT = 0.02


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
        self._rows, self._unknowns = fit.rows, fit.unknowns
        self._added = None if fit.unknowns.bond is None else fit.prediction.added

    def serves(self, fit: Fit) -> bool:
        """Whether they are good enough at another fit."""
        known, here = self._unknowns, fit.unknowns
        if known.bond is not None and here.bond is not None:
            # neighbours may exchange what they conduct
            added = fit.prediction.added
            near = bool(np.abs(added - self._added).max() < _ALIKE * np.abs(added).max())
        else:
            near = similar(here.contacts, known.contacts, fit.operator.pitch)
        return near and same_rows(self._rows, fit.rows)


def similar(
    contacts: np.ndarray, others: np.ndarray, pitch: float, within: float = SIMILAR
) -> bool:
    """Whether contacts (k, 6) are nearly the same as others, one by one."""
    if len(contacts) != len(others):
        return False
    limits = within * np.array([pitch, pitch, 4, 8, 8, 8])
    return bool((np.abs(contacts - others) <= limits).all())


class Contacts:
    """Normal equations of the contacts alone at a fit, the sensor as it is there; `step(damping)`
    solves them.

    Attributes
    ----------
    free : number of the contacts' free parameters; flat (F, L n) derivatives by them, times the
        weights; normal (P, P), right (P,) of all parameters; beside : what all that is not a
        parameter here takes off the cost
    stiffness : of each parameter of a contact, the part that is left of its diagonal element of the
        normal matrix where the sheet gives way; damping is in parts of it
    promised, whole : of the last step: how much the cost should fall by the linear model; whether
        the step is hardly damped and not limited
    """

    def __init__(self, fit: Fit):
        self.fit = fit
        contacts = fit.prediction.contact_columns()
        self.free = len(contacts)
        self.flat = (contacts * fit.rows.weights).reshape(self.free, fit.misfit.size)
        curvature, pull = contact_priors(fit)
        self.normal = self.flat @ contacts.reshape(self.flat.shape).T + curvature
        Contacts._aim(self, pull)
        self.beside = 0.0
        self.stiffness: np.ndarray | float = 1.0

    def about(self, fit: Fit) -> Contacts:
        """The same derivatives with the right side of a fit nearby: a chord for a tangent."""
        other = copy(self)
        other.fit = fit
        other._aim(contact_priors(fit)[1])
        return other

    def _aim(self, pull: np.ndarray) -> None:
        """The right side, of what the fit leaves over and `pull` (F,) of the contacts' priors."""
        self.right = self.flat @ self.fit.misfit.ravel() + pull

    def step(self, damping: float) -> Unknowns:
        """Where the damped step leads."""
        scale = 1 / np.sqrt(self.normal.diagonal())
        scaled = self.normal * scale[:, None] * scale
        scaled[np.diag_indices(self.free)] += damping * self.stiffness
        step = scale * cho_solve(cho_factor(scaled), scale * self.right)
        self.promised = float(step @ (2 * self.right - self.normal @ step)) + self.beside
        longest = np.abs(self._by_contact(step) / _limits(self.fit)).max(initial=0.0)
        self.whole = damping <= FIRST_DAMPING and longest <= 1
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
        contacts[:, RADIUS] = np.clip(contacts[:, RADIUS], np.log(_smallest(self.fit)), largest)
        long = np.hypot(*contacts[:, STRETCH:].T)
        contacts[:, STRETCH:] *= np.minimum(LONGEST / np.maximum(long, LONGEST), 1.0)[:, None]
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

    @cached_property
    def stiffness(self) -> np.ndarray:
        """(F,) see `Contacts`."""
        scale = 1 / np.sqrt(self.normal.diagonal())
        scaled, count = self.normal * scale[:, None] * scale, len(self.contacts)
        mixed = scaled[count:, :count]
        return 1 - np.einsum("jf,jf->f", mixed, np.linalg.solve(scaled[count:, count:], mixed))

    @property
    def prediction(self) -> Prediction:
        """At the fit that they are of."""
        return self._fit.prediction

    @cached_property
    def by_ways(self) -> np.ndarray:
        """(F, k) `response` to a change of the logarithm of D of each contact."""
        return self.response(self.prediction.way_columns())

    @cached_property
    def inverse(self) -> np.ndarray:
        """(F + J, F + J) of the normal matrix: covariance of contacts and sheet, channels marginal."""
        scale = 1 / np.sqrt(self.normal.diagonal())
        return np.linalg.inv(self.normal * scale[:, None] * scale) * scale[:, None] * scale

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
        normal += curvature[:count, :count]
        along = Linear(fit, self)
        right = weighted @ fit.misfit.ravel() + pull[:count] - mixed @ along.alone
        scale = 1 / np.sqrt(self.normal.diagonal())
        factor = cho_factor(self.normal * scale[:, None] * scale)
        follow = scale[:, None] * cho_solve(factor, scale[:, None] * others.T)
        normal -= others @ follow
        right -= follow.T @ along.right
        return float(right @ np.linalg.lstsq(normal, right, rcond=1e-12)[0])

    def unevenness(self, fit: Fit) -> float:
        """How much more uneven the sheet of a `fit` near is than was expected: the root of what its
        coefficients cost for each of them that readings tell (evidence procedure; MacKay 1992), at
        least 1."""
        prior, modes = fit.prior, fit.operator.modes
        expected = _sheet_block(prior, modes)
        apart = fit.unknowns.sheet - prior.sheet
        told = max(modes - float((self.inverse[-modes:, -modes:] * expected).sum()), 1.0)
        return max(float(np.sqrt(apart @ expected @ apart / told)), 1.0)

    def serves(self, fit: Fit) -> bool:
        """Whether they are good enough at another fit, of other readings: how fast the solver
        converges depends on them, and the covariance."""
        known = self._fit
        return (
            np.array_equal(known.unknowns.free, fit.unknowns.free)
            and not (known.unknowns.moving.any() or fit.unknowns.moving.any())
            and same_rows(known.rows, fit.rows)
            and same_sensor(known.prior, fit.prior)
            and similar(known.unknowns.contacts, fit.unknowns.contacts, fit.operator.pitch, _STILL)
            and not self.bends(fit)
        )

    def bends(self, fit: Fit) -> bool:
        """Whether a contact of another fit is so much nearer to, or farther from, a bare conductor that
        its readings answer otherwise."""
        if not len(fit.unknowns.contacts):
            return False
        known, here = self._fit.prediction.answering, fit.prediction.answering
        return bool((np.abs(known - here) > _BENT).any())


class Linear(Contacts):
    """Normal equations of contacts and sheet at a fit, channels eliminated; `anew` : without those known
    but for derivatives by the sheet.

    equations : all of them but the right side, from a fit nearby or anew
    alone : steps of the channels if nothing else moves, see `ChannelFit.pulled`
    """

    def __init__(self, fit: Fit, known: Equations | None = None, anew: bool = False):
        self.fit = fit
        pull = contact_priors(fit)[1]
        self.free = len(pull)
        if known is None or anew or not known.serves(fit):
            super().__init__(fit)
            known = Equations(self, None if known is None else known.sheet)
        self.equations, self.normal, self.stiffness = known, known.normal, known.stiffness
        self._aim(pull)

    def _aim(self, pull: np.ndarray) -> None:
        fit, known = self.fit, self.equations
        sensor = -fit.prior.pull(fit.prior.apart(fit.unknowns))
        modes, misfit = fit.operator.modes, fit.misfit.ravel()
        both = known.contacts @ misfit + pull, known.sheet.weighted @ misfit + sensor[:modes]
        self.alone, taken, self.beside = known.channels.pulled(fit.misfit, sensor[modes:])
        self.right = np.concatenate(both) - taken

    def covariance(self) -> np.ndarray:
        """(F, F) of the contacts' free parameters."""
        return self.equations.inverse[: self.free, : self.free]

    def _moved(self, step):
        return self.followed(super()._moved(step), step)

    def followed(self, unknowns: Unknowns, step: np.ndarray) -> Unknowns:
        """`unknowns` with the sensor as it is after a `step` (F + J,) of contacts and sheet."""
        u = self.fit.unknowns
        gain, offset, resistance, *aside = self.equations.channels.step(self.alone, step)
        return replace(
            unknowns,
            sheet=u.sheet + step[self.free :],
            gain=u.gain + gain,
            offset=u.offset + offset,
            resistance=u.resistance + resistance,
            aside=u.aside + aside,
        )


def contact_priors(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """What the priors of the contacts' free parameters and rates add to the normal matrix, (F, F), and
    to its right side, (F,)."""
    u, prior = fit.unknowns, fit.prior
    if u.bond is not None:  # a shape: its cells' conductances alone are free
        strengths = np.exp(u.contacts[:, CONDUCTANCE])
        return u.bond * np.outer(strengths, strengths), -strengths * (u.bond @ strengths)
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
        np.diag(np.concatenate([curvature[u.free], rates.ravel()])),
        np.concatenate([pull[u.free], (-u.rates[u.moving] * rates).ravel()]),
    )


def _sheet_block(prior: Prior, modes: int) -> np.ndarray:
    """(J, J) of the sheet's coefficients in the inverse covariance."""
    if prior.precision is None:
        return np.diag(prior.sheet_deviation**-2.0)
    return prior.precision[:modes, :modes]


def _smallest(fit) -> float:
    """Radius of the smallest contact, m: a fiftieth of the spacing, where nothing tells it from a
    point; or well below what is typical."""
    return min(fit.operator.pitch / 50, _SMALL * fit.prior.radius)


def _limits(fit) -> np.ndarray:
    """How far contacts may move in one step, in the units of their parameters."""
    reach = REACH * fit.operator.pitch
    return np.array([reach, reach, REACH_STRENGTH, 0.5, 0.3, 0.3])

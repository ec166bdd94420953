"""How well a contact can be known at all: what the one estimator expects to be wrong, before any
frame.

At a contact the estimator's own linearisation (`estimation.solver.Linear`) gives the covariance of
place, conductance and radius with the sheet's modes and the channels marginal: the inverse of

    J' W J + P^-1,     W = 1 / noise^2,  P the covariance of the priors

(Fisher information with priors; Van Trees 1968, the Bayesian Cramer-Rao bound at one point). No
frame is simulated. The figures at a contact, the sheet even and the channels perfect but not known
to be:

* place: root of the trace of the covariance of x and y, m. A contact on an electrode can be
  anywhere on it without a trace; by the share of it that lies there, its place has the variance of
  an even distribution over the electrode as a prior, r^2 / 4 in x and in y.
* force: standard deviation of ln(force), by the contact law, relative
* d': two contacts at a distance, told from one. With the difference of the frames of both and of
  the one contact that resembles them most, its place, conductance and radius free as well as the sheet
  and the channels, d' is the root of the rise of the misfit in units of the noise: to second order
  in the distance the frames of a pair and of one wide contact are the same, so that this is what is
  left of the squared difference after all other unknowns have taken what they can (Green and Swets
  1966).

`Posterior.score` makes one length of them, by which layouts are ranked and searched for.

What the bound leaves out: ghosts and misses, what the model errs, shapes that are no discs. It
ranks layouts; it is no promise (docs/layouts.md compares it with what was measured).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.equations import Linear, contact_priors
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.touch import (
    CONDUCTANCE,
    RADIUS,
    Touches,
    X,
    Y,
    conductance,
    patches_for,
)
from tomotactile_ros.evaluation.metrics import worst
from tomotactile_ros.evaluation.places import CONTACT_RADIUS, PLACES, lattice
from tomotactile_ros.evaluation.places import pairs as pairs_about
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.support import checks

NOISE = 1e-3  # V rms of a reading: 12 to 16 bits behind an analogue switch, as in the benchmarks
DRIVE = 3.3  # V
PRESSURE = 2e4  # Pa: 1.6 N on such a disc
LAW = ContactLaw(1e-4, 1.0)  # that of the shipped scenes: 2 S/m^2 at this pressure
PAIRS_APART = 0.04  # m, two fingers
NOTICED = 50.0  # d' of the distance that is stated; a scale, not measured: no ranking depends on it
SEPARATION = "d' is the difference between two contacts and one, in parts of the noise"
MEMORY = 8e6  # bytes for each electrode while it is found out: 1.5 GB for 256, 3.0 for 400
_DISC = np.array([True, True, True, True, False, False])  # free: x, y, ln c, ln a

# of what is expected of the outline: layouts are compared on sheets that have theirs
_AS_DRAWN = 1e-3


@dataclass(frozen=True)
class Conditions:
    """What is pressed and how well it is read.

    noise : of a reading, V rms
    radius, law : of the contacts, m; `PRESSURE` presses them
    channels : what is known of gains, offsets and resistances; None: all are known
    apart : m, distance of the two contacts of a pair
    """

    noise: float = NOISE
    radius: float = CONTACT_RADIUS
    law: ContactLaw = LAW
    channels: ChannelPrior | None = None
    apart: float = PAIRS_APART

    def __post_init__(self):
        checks.positive(self.noise, "noise", "voltage in V")
        checks.length(self.radius, "contact radius")
        checks.length(self.apart, "apart")


@dataclass(frozen=True, eq=False)
class Posterior:
    """What is expected at contacts all over the sheet.

    places (P, 2), m; covariance (P, 2, 2) of x and y, m²; force (P,) relative
    pairs (Q, 2) middles, m; separation (Q,) d' of two contacts, `conditions.apart` from each other
    """

    conditions: Conditions
    places: np.ndarray
    covariance: np.ndarray
    force: np.ndarray
    pairs: np.ndarray
    separation: np.ndarray

    @cached_property
    def place(self) -> np.ndarray:
        """(P,) standard deviation of the place, m."""
        return np.sqrt(np.trace(self.covariance, axis1=1, axis2=2))

    @property
    def closest(self) -> float:
        """Distance, m, from which on pairs should be told apart; NaN where no pair fits.

        To second order in the distance the frames of a pair and of one wide contact are the same:
        d' goes with the square of the distance. The geometric mean of the pairs.
        """
        if not len(self.separation):
            return float("nan")
        seen = np.exp(np.log(np.maximum(self.separation, 1e-9)).mean())
        return self.conditions.apart * float(np.sqrt(NOTICED / seen))

    @property
    def lengths(self) -> np.ndarray:
        """(3,) m: mean place error, that of the worst tenth, distance of pairs told apart; (2,)
        where no pair fits."""
        found = np.array([self.place.mean(), worst(self.place), self.closest])
        return found[np.isfinite(found)]

    @property
    def score(self) -> float:
        """Geometric mean of `lengths`, m: a per cent of one is worth a per cent of any other."""
        return float(np.exp(np.log(self.lengths).mean()))

    @cached_property
    def metrics(self) -> dict:
        """Mean and worst tenth of place, m, and force, relative; of d', empty where no pair
        fits."""
        return {
            "place": {"mean": float(self.place.mean()), "worst_tenth": worst(self.place)},
            "force": {"mean": float(self.force.mean()), "worst_tenth": worst(self.force)},
            "separation": {
                "mean": float(self.separation.mean()),
                "worst_tenth": -worst(-self.separation),
            }
            if len(self.separation)
            else {},
        }


class Expectation:
    """What rows of a layout will tell, contact by contact.

    Parameters
    ----------
    layout : Layout; its scan says which rows there are
    conditions : Conditions
    """

    def __init__(self, layout: Layout, conditions: Conditions | None = None):
        self.layout, self.conditions = layout, conditions or Conditions()
        self.operator = operator_for(layout)
        how = self.conditions
        channels = how.channels or ChannelPrior(1e-6, 1e-9, 1e-3, 1e-8, 1e-9)  # as good as known
        prior = Prior.unknown(self.operator, channels, how.radius, DRIVE)
        deviation, precision = prior.sheet_deviation.copy(), np.array(prior.precision)
        cut = np.arange(self.operator.modes)[self.operator.of_cut]
        deviation[cut] *= _AS_DRAWN
        precision[cut, cut] /= _AS_DRAWN**2
        self.prior = replace(prior, sheet_deviation=deviation, precision=precision)

    def linear(self, *centres: np.ndarray, grounded=None) -> Linear:
        """Normal equations at discs with their middles at `centres` (2,), m, each."""
        return self._linear(self.pressed(centres), grounded)

    def covariance(self, centre: np.ndarray, grounded=None) -> tuple[np.ndarray, float]:
        """(2, 2) of the place of a disc at `centre`, m², and the standard deviation of its force,
        relative."""
        linear = self.linear(centre, grounded=grounded)
        normal = linear.normal.copy()
        normal[[X, Y], [X, Y]] += self.on_electrode(linear)
        covariance = _inverse(normal)[: linear.free, : linear.free]
        slope = linear.fit.prediction.force_slope(0, self.conditions.law.exponent)[_DISC]
        return covariance[X : Y + 1, X : Y + 1], float(np.sqrt(slope @ covariance @ slope))

    def separation(self, middle: np.ndarray, way: np.ndarray) -> float:
        """d' of two discs at `middle` +- `way` / 2 (m), each of half the pressure of one."""
        half = np.asarray(way, float) / 2
        together = self.pressed([middle + half, middle - half])
        frame = self._prediction(together).readings
        wide = np.log(np.hypot(self.conditions.radius, np.linalg.norm(half)))
        one = np.array([*middle, 0.0, wide, 0.0, 0.0])
        strengths = together.contacts[:, CONDUCTANCE]
        given = sum(conductance(c, mean)[0] for c, mean in zip(strengths, together.mean))
        linear = self._linear(_conducting(self._felt(one[None]), given), readings=frame)
        step = np.linalg.solve(linear.normal, linear.right)
        taken = step @ linear.right + linear.beside
        return float(np.sqrt(max(linear.fit.cost - taken, 0.0)))

    def on_electrode(self, linear: Linear) -> float:
        """What is known of x and of y, 1/m², of a contact that lies on an electrode in part."""
        touches = linear.fit.prediction.touches
        assert touches is not None  # there is a contact
        share = touches.direct[0].sum() / touches.covered[0]
        return float(share * 4 / self.layout.radius**2)

    def pressed(self, centres) -> Touches:
        """Discs under the pressure of the conditions at `centres` (k, 2), m."""
        how = self.conditions
        forms = [[*centre, 0.0, np.log(how.radius), 0.0, 0.0] for centre in centres]
        touches = self._felt(np.array(forms))
        each = float(how.law.conductance(PRESSURE)) * np.pi * how.radius**2
        return _conducting(touches, each * touches.covered)

    def unknowns(self, forms: np.ndarray) -> Unknowns:
        """Discs `forms` (k, 6) on an even sheet, with perfect channels."""
        free = np.tile(_DISC, (len(forms), 1))
        return Unknowns.at_rest(self.operator).with_contacts(forms, self._patches(forms), free)

    def _patches(self, forms) -> tuple[int, ...]:
        return tuple(patches_for(np.exp(form[RADIUS]), self.operator.pitch) for form in forms)

    def _felt(self, forms) -> Touches:
        """Contacts `forms` (k, 6) on the even sheet; takes longer than all that follows from it, which
        is why it is done once for each contact."""
        sheet = np.zeros(self.operator.modes)
        return Touches(self.operator, forms, self._patches(forms), sheet)

    def _prediction(self, touches, grounded=None) -> Prediction:
        grounded = self.layout.grounded if grounded is None else np.asarray(grounded)
        return Prediction(self.operator, self.unknowns(touches.contacts), grounded, touches)

    def _linear(self, touches, grounded=None, readings=None) -> Linear:
        """Linearised at contacts that have been read as `readings` (L, n), or exactly."""
        unknowns = self.unknowns(touches.contacts)
        prediction = self._prediction(touches, grounded)
        grounded = prediction.rows
        readings = prediction.readings if readings is None else readings
        weight = (DRIVE / self.conditions.noise) ** 2
        weights = np.full(readings.shape, weight)
        weights[np.arange(len(grounded)), grounded] = 0.0
        prior = replace(self.prior, radius=float(np.exp(touches.contacts[0, RADIUS])))
        rows = Rows(readings, weights, grounded)
        return Linear(Fit(self.operator, unknowns, rows, prior, prediction))


def _conducting(touches: Touches, conductance) -> Touches:
    """The same contacts, which conduct `conductance`, S, each."""
    contacts = touches.contacts.copy()
    contacts[:, CONDUCTANCE] = -np.log(1 / conductance + touches.mean)
    return touches.stronger(contacts)


class RowInformation:
    """What each single row says of contacts at `centres` (P, 2), m: any scan is the sum of its
    rows.

    Channels count as known: they are common to rows, and would have to be eliminated for each scan.
    """

    def __init__(self, expectation: Expectation, centres: np.ndarray):
        rows, priors, slopes = [], [], []
        every = np.arange(expectation.layout.electrodes)
        for centre in centres:
            linear = expectation.linear(centre, grounded=every)
            prediction, weights = linear.fit.prediction, linear.fit.rows.weights
            columns = np.concatenate([prediction.contact_columns(), linear.equations.sheet_columns])
            columns = columns.transpose(1, 0, 2)  # (E, k, n)
            rows.append((columns * weights[:, None]) @ columns.transpose(0, 2, 1))
            sheet = linear.fit.prior.sheet_deviation**-2.0
            prior = np.diag(np.concatenate([contact_priors(linear.fit)[0].diagonal(), sheet]))
            prior[[X, Y], [X, Y]] += expectation.on_electrode(linear)
            priors.append(prior)
            exponent = expectation.conditions.law.exponent
            slopes.append(prediction.force_slope(0, exponent)[_DISC])
        self._rows, self._priors, self._slopes = map(np.array, (rows, priors, slopes))

    def figures(self, grounded: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """(P,) standard deviations of place, m, and force, relative, by rows of these
        electrodes."""
        inverse = _inverse(self._priors + self._rows[:, list(grounded)].sum(axis=1))
        free = np.count_nonzero(_DISC)
        covariance = inverse[:, :free, :free]
        force = np.einsum("pi,pij,pj->p", self._slopes, covariance, self._slopes)
        return _place(inverse), np.sqrt(force)

    def mean_place(self, weights: np.ndarray) -> tuple[float, np.ndarray]:
        """Mean of `figures` of place, m, and its slopes (E,), where row l is taken `weights[l]`
        times, any number from 0 on.

        It is convex in the weights: 1 / trace((A^-1)_xy) is concave in a positive definite A, and
        one over the root of something concave is convex.
        """
        inverse = _inverse(self._priors + np.tensordot(self._rows, weights, axes=(1, 0)))
        place, columns = _place(inverse), inverse[:, :, X : Y + 1]
        taken = (self._rows @ columns[:, None]) * columns[:, None]  # (P, E, k, 2)
        return float(place.mean()), -(taken.sum(axis=(2, 3)) / place[:, None]).mean(axis=0) / 2


def _inverse(normal: np.ndarray) -> np.ndarray:
    """(..., k, k) of normal matrices, scaled for unknowns of different units."""
    scale = 1 / np.sqrt(np.diagonal(normal, axis1=-2, axis2=-1))
    units = scale[..., :, None] * scale[..., None, :]
    return np.linalg.inv(normal * units) * units


def _place(covariance):
    """(P,) m, of covariances (P, k, k)."""
    return np.sqrt(covariance[:, X, X] + covariance[:, Y, Y])


def expected(
    layout: Layout,
    conditions: Conditions | None = None,
    places: int = PLACES,
    pairs: int | None = None,
) -> Posterior:
    """Figures of contacts on a lattice of `places` along the longer side, off the electrodes'
    lattice.

    pairs : about so many pairs at most; None: one for every second place

    Raises InputError for conditions that cannot be.
    """
    checks.integer(places, "places", 2, 100)
    expectation = Expectation(layout, conditions)
    how = expectation.conditions
    centres = lattice(layout, places, how.radius)
    covariance, force = zip(*map(expectation.covariance, centres))
    step = 2 if pairs is None else max(2, len(centres) // pairs)
    middles, ways = pairs_about(layout, centres[::step], how.apart, how.radius)
    separation = list(map(expectation.separation, middles, ways))
    return Posterior(
        how, centres, np.array(covariance), np.array(force), middles, np.array(separation)
    )

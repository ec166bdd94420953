"""What is reported of a fit: contacts with their standard deviations and probabilities."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import shapely
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import RATED
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.touch import RADIUS, X, Y
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.contact import ContactLaw

# standard deviations of ln c, or of what that leads to in a bare conductor: below, it is not known
# well that a contact conducts
_CERTAIN = 3.0
_LIKELY = 1.0  # the same where no contact is certain: its deviations say how little is known
# spacings: what the model of electrodes and contacts errs in places, standard deviation; as many times as
# much as the sheet is more uneven than was expected, as the model is of first order in that
PLACE_FLOOR = 1.5e-3
# the same of a bare conductor, radii of an electrode, whose rim crosses that of one or comes as near: four charges
# stand for it there (0.8 mm rms for electrodes of 2.5 mm, by a mesh bent along both rims)
RIM_FLOOR = 0.3
# the same of wide contacts, radii, for each spacing that the radius is long: their patches are wide, too
WIDE_FLOOR = 5e-3
# the same beside a tear, steps of the lattice of potentials, and of forces there, relative (`beside_tear`): 8 mm from
# one that is known, 2.8 steps of 8 x 8 on 200 mm, places are 0.6 mm off rms and forces 20 to 50 %
TEAR_FLOOR = 5.0
FORCE_FLOOR = 0.02  # the same of forces, relative
# the same of the mean D of a contact, in which closed form, finite elements and the pressure under a
# real contact differ by so much
IMPEDANCE_FLOOR = 0.02
# the same of a force, times g R_s / 2 pi: current crowds within a / sqrt(g R_s / pi) of a contact's rim and
# of electrodes under it, and only there readings tell how hard it presses
CROWDING = 0.015
# of the mean D of a contact: with less resistance of its own it is a bare conductor as far as readings
# tell, a smaller one that conducts better looks the same; and that D in parts of R_s / 2 pi at least
BARE, _LEAST_WAY = 0.2, 0.4
# the same of the middle of one that several discs or cells stand for, in parts of how wide these are (root of their
# second moment): readings tell its outline, and nothing of how its force is spread within
SPREAD = 0.25
BELOW = 2.0  # deviations of a force, which one that is known from below alone is more than that
ANYWHERE = (
    "the readings are too small to say where they come from: something that hardly presses, or offsets "
    "of the channels, which a tare removes"
)
MOST_RELATIVE = 10.0  # standard deviation of a force in parts of it: more says no more


@dataclass(frozen=True)
class Contact:
    """One contact: place x, y (m), force (N), pressure (Pa), area (m²), radius (m), with
    uncertainty.

    conductance : g as a whole, S
    covariance : (4,) of x and y, row by row, m²; radius_std : m
    force_std : N; inf of a bare conductor, whose force is only known from below
    probability : that it is there; velocity : (2,) of x and y, m/s, 0 where it rests
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
    velocity: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Estimate:
    """What rows say.

    contacts : strongest first; parts : the discs that they consist of
    state : `valid`, or `withheld` with the reason why
    left_out : {electrode: what is wrong with its channel}
    misfit : chi-squared per reading, about 1 where noise explains what the model does not
    first : number of the first row that was used; earlier ones belong to another state of the sheet
    noise : of a reading, V rms, as the rows show it, what was expected at the least; 0 where they do
        not tell
    unlike : withheld because no contacts on a sheet like that of the layout explain the rows
    complete : whether the search ended by itself, or with as little left over as right contacts leave
    other : what is nearly as likely as `contacts`, and differs from them by more than their deviations; None: nothing is
    """

    contacts: list[Contact]
    parts: list[Contact] = field(default_factory=list)
    state: str = "valid"
    reason: str = ""
    left_out: dict[int, str] = field(default_factory=dict)
    misfit: float = 0.0
    first: int = 0
    noise: float = 0.0
    unlike: bool = False
    complete: bool = True
    other: list[Contact] | None = None


def contacts_of(
    fit: Fit,
    group: np.ndarray,
    law: ContactLaw,
    needed: Callable[[int], float],
    elsewhere: Callable[[int], np.ndarray],
    discs: int | None = None,
    ways: np.ndarray | None = None,
) -> tuple[list[Contact], np.ndarray]:
    """The discs of a fit that are certain, strongest first, and of `group` (k,), the contact that each
    disc belongs to, what is theirs.

    needed : what the cost grows by without a contact, in parts of the doubt. It is asked where deviations do
        not make one certain: how well one conducts that covers an electrode no reading tells, yet all tell
        that it is there
    elsewhere : (2, 2) m², second moment of the other places where a disc may as well be
    discs : only of so many of the first contacts
    ways : (m, L n) what readings change by with D of these and of others; None: of each contact by itself
    """
    if not len(fit.unknowns.contacts[:discs]):
        return [], np.empty(0, int)
    group = group[:discs]
    # what is wrong with D of each contact bends all that is fitted
    bent = fit.equations.by_ways if ways is None else fit.equations.response(ways)
    bent = IMPEDANCE_FLOOR * bent
    covariance = fit.covariance * fit.doubt + bent @ bent.T
    certainties = _certainties(fit, covariance, group)
    for each in np.unique(group[certainties < _CERTAIN**2]):
        certainties[group == each] = np.maximum(certainties[group == each], needed(int(each)))
    which = np.flatnonzero(certainties >= _LIKELY**2)
    floor = place_floor(fit, fit.equations.unevenness(fit))
    found = [
        _contact(fit, int(i), covariance, bent, certainties[i], law, floor, elsewhere(int(i)))
        for i in which
    ]
    sure = certainties[which] > _CERTAIN**2
    likely = [i for i, certain in enumerate(sure) if certain or not sure.any()]
    order = sorted(likely, key=lambda i: -found[i].force)
    return [found[i] for i in order], group[which[order]]


def place_floor(fit: Fit, uneven: float) -> float:
    """Standard deviation of places in x and in y, m, of what no reading tells: what the model errs, and
    the shift, turn and scale that electrodes have in common that lie aside as they were found, and what these make of
    second order: the way aside squared over the radius, of which the four about a contact leave half."""
    aside = float(np.mean((fit.unknowns.aside**2).sum(axis=0)))
    in_common = math.sqrt(aside / fit.operator.count)
    second = aside / (2 * fit.operator.layout.radius)
    return math.hypot(PLACE_FLOOR * fit.operator.pitch * uneven, in_common, second)


def beside_tear(operator: SheetOperator, place: tuple[float, float]) -> float:
    """How near a tear a place is, 0 to 1: the cube of a step of the lattice that potentials, which jump there, are
    interpolated on (Keys 1981) over the distance."""
    if not operator.tears:
        return 0.0
    tears = shapely.linestrings(np.reshape(operator.tears, (-1, 2, 2)))
    step = float(operator.potentials.lattice.step.max())
    return (step / max(float(shapely.distance(tears, shapely.Point(place)).min()), step)) ** 3


def rim_floor(operator: SheetOperator, place: tuple[float, float], radius: float) -> float:
    """Standard deviation of the place of a bare conductor in x and in y, m, of what the model errs where its
    rim meets that of an electrode."""
    meets = meets_rims(operator.layout, place, radius)[operator.used]
    return RIM_FLOOR * operator.layout.radius * bool(meets.any())


def meets_rims(layout: Layout, place: tuple[float, float], radius: float) -> np.ndarray:
    """(E,) electrodes whose rim a disc's of `radius`, m, at `place` meets."""
    apart = np.hypot(*(layout.positions - place).T)
    return np.abs(apart - radius) < (1 + RIM_FLOOR) * layout.radius


def _contact(
    fit: Fit,
    i: int,
    covariance: np.ndarray,
    bent: np.ndarray,
    certainty: float,
    law: ContactLaw,
    floor: float,
    aside: np.ndarray,
) -> Contact:
    """Disc i of a fit.

    covariance (F, F) of the contacts' parameters; bent (F, k) how these answer to a standard
    deviation of D of each contact; floor : of the deviation of its place, m; aside : (3, 3), what else is not
    known of its place and of ln c
    """
    u, operator, prediction = fit.unknowns, fit.operator, fit.prediction
    free = u.free[i]
    first = np.count_nonzero(u.free[:i])
    at = slice(first, first + np.count_nonzero(free))
    own = covariance[at, at]
    index = {int(parameter): k for k, parameter in enumerate(np.flatnonzero(free))}
    covered = prediction.touches.covered[i]
    area = np.pi * float(np.exp(2 * u.contacts[i, RADIUS])) * covered
    radius = float(np.sqrt(area / np.pi))
    sheet = operator.resistance
    known, bare = told(prediction.conductances[i], prediction.means[i], sheet)
    there = fit.equations.prediction  # near, and its derivatives are known
    slope = there.force_slope(i, law.exponent)[free]
    noise = slope @ fit.covariance[at, at] @ slope * fit.doubt
    ways = slope @ bent[at]
    ways[i] -= IMPEDANCE_FLOOR * there.force_by_impedance(i, law.exponent)
    ahead = fit.rows.last
    x, y = prediction.touches.centre(i) + ahead * u.rates[i, :2]
    torn = beside_tear(operator, (x, y))
    unknown = ways @ ways + crowded(known, sheet) ** 2 + (TEAR_FLOOR * torn) ** 2 + aside[2, 2]
    relative = float(np.sqrt(noise + FORCE_FLOOR**2 + unknown))
    # readings tell 1/c and D together: of 1/c an error is the same however large c is
    found = prediction.conductances[i]
    most = found / max(1 - BELOW * relative, 1e-9)
    if bare or told(most, prediction.means[i], sheet)[1]:  # it may be one
        known, bare = min(known, found / (1 + BELOW * relative)), True
    g = known * covered
    pressure = float(law.pressure(g / area))
    relative = np.inf if bare else min(relative, MOST_RELATIVE)
    place = own[np.ix_([index[X], index[Y]], [index[X], index[Y]])]
    wide = WIDE_FLOOR * radius**2 / operator.pitch
    floor = math.hypot(floor, rim_floor(operator, (x, y), radius)) if bare else floor
    floor = math.hypot(floor, TEAR_FLOOR * torn * float(operator.potentials.lattice.step.max()))
    place = place + np.eye(2) * (floor**2 + wide**2) + aside[:2, :2]
    place = place + ahead**2 * np.diag(_velocity_variance(fit, i)) * fit.doubt
    return Contact(
        float(x),
        float(y),
        pressure * area,
        pressure,
        area,
        radius,
        g,
        four(place),
        abs(pressure * area) * relative,
        radius * float(np.sqrt(own[index[RADIUS], index[RADIUS]])),
        float(1 - np.exp(-certainty / 2)),
        tuple(u.rates[i, :2].tolist()),
    )


def four(matrix: np.ndarray) -> tuple[float, float, float, float]:
    """The numbers of a covariance (2, 2), row by row."""
    xx, xy, yx, yy = matrix.ravel().tolist()
    return xx, xy, yx, yy


def unmatched(contacts: list[Contact], others: list[Contact]) -> np.ndarray:
    """(k,) which contacts are none of the others: those that are not nearest to one, lie further from it than
    `_CERTAIN` of their deviations, or press as much harder."""
    out = np.ones(len(contacts), bool)
    places = [
        np.array([(each.x, each.y) for each in some]).reshape(-1, 2) for some in (contacts, others)
    ]
    for one, two in zip(*linear_sum_assignment(cdist(*places))):
        first, second = contacts[one], others[two]
        covariance = np.reshape(np.add(first.covariance, second.covariance), (2, 2))
        apart = places[0][one] - places[1][two]
        aside = apart @ np.linalg.pinv(covariance) @ apart > _CERTAIN**2
        spread = math.hypot(first.force_std, second.force_std)
        out[one] = aside or abs(first.force - second.force) > _CERTAIN * spread
    return out


def may_be_anywhere(covariance: np.ndarray, layout: Layout) -> bool:
    """Whether one standard deviation of a contact's place, with `covariance` (2, 2), m², is more than
    half of the sheet."""
    return bool(np.trace(covariance) > (max(layout.outline.size) / 2) ** 2)


def told(conductance: float, mean: float, resistance: float) -> tuple[float, bool]:
    """Of a contact of `conductance`, S, with the `mean` D, ohm, on a sheet of `resistance`, ohm/sq:
    what readings tell of its conductance at the most, and whether it is a bare conductor, which
    conducts more."""
    most = 1 / (BARE * max(mean, _LEAST_WAY * resistance / (2 * np.pi)))
    return min(float(conductance), most), bool(conductance > most)


def spread_within(places: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(2, 2) m², what is not known of the middle of a bare conductor of parts at `places` (m, 2), m, each with its
    `share` (m,) of it."""
    aside = places - share @ places
    return SPREAD**2 * (share[:, None] * aside).T @ aside


def are_bare(fit: Fit) -> np.ndarray:
    """(k,) which contacts of a fit are bare conductors, by `told`."""
    each = zip(fit.prediction.conductances, fit.prediction.means)
    return np.array([told(g, mean, fit.operator.resistance)[1] for g, mean in each], bool)


def crowded(conductance: float, resistance: float) -> float:
    """What is not known of the force of a contact of `conductance`, S, because its current crowds on a
    sheet of `resistance`, ohm/sq: relative standard deviation."""
    return CROWDING * conductance * resistance / (2 * np.pi)


def _certainties(fit: Fit, covariance: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(k,) of the contact that each disc of a fit is part of: what it and the way to it conduct over
    its deviation, squared.

    covariance (F, F) of the fit; group (k,) number of the contact of each disc. Discs of one contact
    may be uncertain one by one.
    """
    free, prediction = fit.unknowns.free[: len(group)], fit.prediction
    strengths = 1 / (1 / prediction.conductances + prediction.means)[: len(group)]
    slopes = np.zeros((len(group), free.size))
    for i, strength in enumerate(strengths):
        slopes[group[i], i * free.shape[1] :][: free.shape[1]] += (
            strength * fit.equations.prediction.strength_slope(i)
        )
    slopes = slopes[:, free.ravel()]
    count = slopes.shape[1]
    totals = np.bincount(group, strengths, len(group))
    variances = np.einsum("gf,fh,gh->g", slopes, covariance[:count, :count], slopes)
    return (totals**2 / np.maximum(variances, 1e-12 * totals**2 + 1e-300))[group]


def _velocity_variance(fit: Fit, which: int) -> np.ndarray:
    """(2,) of the velocity of contact `which`, (m/s)²."""
    moving = fit.unknowns.moving
    if not moving[which]:
        return np.zeros(2)
    first = np.count_nonzero(fit.unknowns.free) + len(RATED) * np.count_nonzero(moving[:which])
    return fit.covariance.diagonal()[first : first + 2]


def joined(parts: list[Contact], group: np.ndarray) -> list[Contact]:
    """Contacts, strongest first, from discs and the numbers `group` (k,) of the contacts that they
    belong to (`joining.groups`)."""
    found = [
        _joined([parts[i] for i in np.flatnonzero(group == each)]) for each in np.unique(group)
    ]
    return sorted(found, key=lambda each: -each.force)


def _joined(parts: list[Contact]) -> Contact:
    if len(parts) == 1:
        return parts[0]
    force, areas = np.array([(each.force, each.area) for each in parts]).T
    area = float(areas.sum())
    share, within = force / max(force.sum(), 1e-300), np.zeros((2, 2))
    if not np.isfinite([each.force_std for each in parts]).all():
        share = areas / area  # of bare conductors readings do not tell who presses more
        within = spread_within(np.array([(each.x, each.y) for each in parts]), share)
    covariance = sum(s**2 * np.array(each.covariance) for s, each in zip(share, parts))
    covariance = covariance + within.ravel()
    radius = float(np.sqrt(area / np.pi))
    return Contact(
        float(sum(s * each.x for s, each in zip(share, parts))),
        float(sum(s * each.y for s, each in zip(share, parts))),
        float(force.sum()),
        float(force.sum() / area),
        area,
        radius,
        sum(each.conductance for each in parts),
        four(np.asarray(covariance)),
        float(np.sqrt(sum(each.force_std**2 for each in parts))),
        float(np.sqrt(sum(each.radius_std**2 for each in parts))),
        max(each.probability for each in parts),
    )

"""Contacts of any shape: one conductance for each of many square cells.

A palm, a plate or a ring is no disc. Its conductance is a field over the sheet, none of it below 0 and
smooth within what presses: cells of a lattice have each a conductance c >= 0, a Gaussian prior whose
covariance falls as exp(-d/l) with their distance (Tarantola 2005, chapter 5), and nothing else. Their
places are fixed, so that H and D are computed once, and the readings are nearly linear in c:
Gauss-Newton, each step a non-negative least-squares problem (Lawson and Hanson 1974), finds them from
a linear image within ten steps. Sheet and channels are then fitted as well, as they are for discs
(`equations`).

What is one contact follows from the posterior: two peaks are two contacts where the readings say that
less than half of the lower one presses on every way between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.equations import Contacts, Equations, Linear, contact_priors
from tomotactile_ros.estimation.first_look import FirstLook
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.one_state import Channels
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.touch import CONDUCTANCE, PARAMETERS, RADIUS
from tomotactile_ros.layouts.grid import Grid

# chi-squared a reading, the sensor's part included: what cells leave on an even sheet is 1 to 6
BELIEVED = 12.0
# cells a spacing: the most with which no more than `_MANY` are fitted; with 3, rings of 8 mm and
# lines of 5 mm left 1.7 to 15 chi^2, with 4 they leave 1.1 to 2.6
_PER_PITCH = 4, 3, 2
_MANY = 160  # cells: cost: a step goes with their cube
_MOST = 1000  # cells of a sheet
_ACROSS = 2  # patches to the width of a cell
_ALIKE = 0.5  # spacings: l, within which conductances are alike
# times the mean c: deviation of a cell; with 2, plates of 189 N came out 28 to 60 % too weak, as
# the prior pulls to 0 where little is explained yet
_LEVEL = 10.0
_SHOWN = 0.02  # of the strongest cell of a linear image: what may be touched
_BESIDE = 0.5  # spacings around that, which may be, too
_LEAST = 1e-6  # of the strongest: as good as nothing
_MORE = 1.2  # conductance of a cell in parts of one over its mean D, at the most
_STEPS, _WHOLE = 15, 6  # of the cells alone, and of sheet and channels as well
_HALVINGS = 6  # of a step that does not lower the cost
_LACKING = 1.1  # the same of what conducted by itself, from which on all cells are asked again
# chi^2 from which on sheet and channels are fitted: on even sheets cells alone leave 1.0 to 1.2,
# and with 1.25 discs on a bent sheet were likelier than one ring of five
_POOR = 1.05
_SETTLED = 1.0  # of the cost: a step that gains less is the last
_ROUNDING = 1e-10  # of the diagonal of the normal matrix of a step
_SADDLE = 0.5  # of the lower of two peaks: what presses at least between parts of one contact
# deviations: what costs more is not there, the sensor held: parts that a search begins with
_SURE = 3.0
# deviations: the same with the sensor free: what is reported as one contact. With 3, fingers beside
# a palm were joined with it in 2 of 6 hands
_REGION = 2.0
_ABOVE = 1e-3  # of the strongest: cells that conduct more are not at their bound


class Shapes:
    """Shapes on a sheet."""

    def __init__(self, operator: SheetOperator):
        self._pitch = operator.pitch
        self._lattices = [Lattice(operator, each) for each in _PER_PITCH]
        coarse = self._lattices[-1]
        radii = np.full(len(coarse.cells), coarse.side / np.sqrt(np.pi))
        self._share, _ = operator.points(coarse.cells, radii)

    def fitted(self, look: FirstLook, like: Fit, channels: Channels) -> Fit | None:
        """The best fit of cells to the rows of `like`, of no contacts, with the sensor as expected but
        for what rows say of `channels`; None where a first `look` shows nothing."""
        image = look.image(self._share)
        if not image.any():
            return None
        shown = self._lattices[-1].cells[image > _SHOWN * image.max()]
        for lattice in self._lattices:
            near = cdist(lattice.cells, shown).min(axis=1) < _BESIDE * self._pitch
            if np.count_nonzero(near) <= _MANY:
                break
        sensor = replace(like.unknowns, gain=channels.gain, offset=channels.offset)
        start = lattice.unknowns(near, float(image.sum()), sensor)
        fit = _descended(Fit(like.operator, start, like.rows, like.prior), _STEPS, Contacts)
        if explains(fit):
            return fit
        even = Fit(like.operator, fit.unknowns, like.rows, like.prior.held(["sheet"]))
        fit = _descended(even, _WHOLE, _Linearised())
        return Fit(like.operator, fit.unknowns, like.rows, like.prior, fit.prediction)


def explains(fit: Fit) -> bool:
    """Whether cells may be what presses: little is left over of the readings and of what is known of the
    sensor."""
    return fit.chi_squared + fit.of_sensor < BELIEVED * fit.rows.count


class Lattice:
    """Cells that a sheet is cut into, about `per_pitch` to a spacing.

    cells (K, 2) centres, m; side, m
    """

    def __init__(self, operator: SheetOperator, per_pitch: float):
        self._pitch, outline = operator.pitch, operator.layout.outline
        width, height = outline.size
        side = max(operator.pitch / per_pitch, float(np.sqrt(width * height / _MOST)))
        grid = Grid.for_outline(outline, max(round(max(outline.size) / side), 2))
        self.cells, self.side = grid.pixels, float(np.sqrt(grid.cell_area))

    def unknowns(self, which: np.ndarray, total: float, like: Unknowns) -> Unknowns:
        """Cells `which` (K,), all alike, that conduct `total`, S, together; the sensor of `like`."""
        cells = self.cells[which]
        count, mean = len(cells), total / np.count_nonzero(which)
        contacts = np.zeros((count, PARAMETERS))
        contacts[:, :2] = cells
        contacts[:, RADIUS] = np.log(self.side / np.sqrt(np.pi))
        contacts[:, CONDUCTANCE] = np.log(mean)
        free = np.zeros(contacts.shape, bool)
        free[:, CONDUCTANCE] = True
        alike = np.exp(-cdist(cells, cells) / (_ALIKE * self._pitch))
        bond = np.linalg.inv(alike) / (_LEVEL * mean) ** 2
        return replace(like.with_contacts(contacts, (-_ACROSS,) * count, free), bond=bond)


def whole(fit: Fit, threshold: float, known: Equations | None = None) -> Fit:
    """The best fit of the cells of `fit` that conduct, with its covariance; of sheet and channels as well
    where the cells alone leave more over than noise does. Without parts that cost, doubted, no more than
    `threshold` if they are not there (Wald 1943), but for the strongest. `known` : of a shape like it."""
    linearised = _Linearised(known)
    conducting = _of_those_that_conduct(fit)
    found = _with_sensor(conducting, linearised)
    if conducting is not fit and found.chi_squared > _LACKING * found.rows.count:
        # some of those that had nothing to explain while the sensor was held may conduct
        found = min(found, _with_sensor(fit, linearised), key=lambda each: each.cost)
    fit = found
    linear = linearised(fit)
    fit.covariance, fit.equations, fit.steps = linear.covariance(), linear.equations, 1
    certain = _certain(fit, threshold * fit.doubt)
    return fit if certain.all() else whole(_only(fit, certain), threshold, fit.equations)


def _with_sensor(fit: Fit, linearised: _Linearised) -> Fit:
    """The best fit of the cells of `fit`, of sheet and channels as well if the cells alone leave more over
    than noise does, without those that do not conduct."""
    if fit.chi_squared < _POOR * fit.rows.count:
        return fit
    return _of_those_that_conduct(_descended(fit, _WHOLE, linearised))


class _Linearised:
    """`Linear` of one fit after the other, with what serves again of the equations `known` so far."""

    def __init__(self, known: Equations | None = None):
        self.known = known

    def __call__(self, fit: Fit) -> Linear:
        linear = Linear(fit, self.known)
        self.known = linear.equations
        return linear


def _certain(fit: Fit, threshold: float) -> np.ndarray:
    """(k,) which cells of a fit are parts of something that cannot be left out."""
    group = groups(fit)
    strengths = np.exp(fit.unknowns.contacts[:, CONDUCTANCE])
    strongest = np.bincount(group, strengths).argmax()
    certain = np.ones(len(group), bool)
    for each in np.unique(group):
        which = group == each
        certain[which] = each == strongest or certainty(fit.covariance, which) > threshold
    return certain


def certainty(covariance: np.ndarray, which: np.ndarray) -> float:
    """What cells `which` conduct together over its deviation, squared; `covariance` (k, k) of the
    logarithms."""
    return float(np.linalg.inv(covariance[which][:, which]).sum())


def at_rest(fit: Fit, threshold: float, known: Equations | None) -> Fit:
    """`whole` of the cells of `fit` as they are by now, by the equations `known` of an earlier fit of them where these
    serve."""
    if known is None or not known.serves(fit.core):
        return whole(_descended(fit, _STEPS, Contacts), threshold, known)
    linearised = _Linearised(known)
    found = _descended(fit, _WHOLE, linearised)
    if not known.serves(found.core) or found.chi_squared > _LACKING * found.rows.count:
        return whole(found, threshold, linearised.known)
    found.covariance, found.equations, found.steps = Linear(found, known).covariance(), known, 1
    return found


def _of_those_that_conduct(fit: Fit) -> Fit:
    """The same without cells that are at their bound."""
    return _only(fit, _conduct(np.exp(fit.unknowns.contacts[:, CONDUCTANCE])))


def _only(fit: Fit, kept: np.ndarray) -> Fit:
    """The same with the cells `kept` (k,) only."""
    u, count = fit.unknowns, int(np.count_nonzero(kept))
    if kept.all() or u.bond is None:
        return fit
    bond = np.linalg.inv(np.linalg.inv(u.bond)[np.ix_(kept, kept)])
    less = u.with_contacts(u.contacts[kept], u.across[:count], u.free[kept])
    return Fit(fit.operator, replace(less, bond=bond), fit.rows, fit.prior)


def _conduct(strengths: np.ndarray) -> np.ndarray:
    """(k,) which of `strengths` are not at their bound, 0."""
    return strengths > _ABOVE * strengths.max()


def occam(fit: Fit, doubt: float) -> float:
    """What the cells of a fit cost for what they might all have been: twice the logarithm of how much
    narrower readings, doubted, make them (Laplace's approximation of the evidence; MacKay 2003,
    chapter 28). Half of what each might have been is below 0; of those that conduct, nothing is."""
    strengths = np.exp(fit.unknowns.contacts[:, CONDUCTANCE])
    prior = contact_priors(fit)[0]
    told = (Contacts(fit).normal - prior) / doubt + prior
    scale = 1 / np.sqrt(told.diagonal())
    units = np.outer(scale, scale)
    narrower = np.linalg.slogdet(told * units)[1] - np.linalg.slogdet(prior * units)[1]
    return float(narrower - 2 * np.log(2) * np.count_nonzero(_conduct(strengths)))


def _descended(fit: Fit, steps: int, linearised: Callable[[Fit], Contacts]) -> Fit:
    """The best fit from one of cells on, by steps of what `linearised` (a fit) has.

    Of the cells alone what the sensor leaves over is doubted, as in `solver.approach`.
    """
    rows, work = fit.rows, fit.prediction.size
    alone = linearised is Contacts
    for _ in range(steps):
        at = fit.weighed(replace(rows, weights=rows.weights / fit.doubt)) if alone else fit
        settled = _SETTLED * (1.0 if alone else fit.doubt)
        better, promised = _better(at, linearised(at), settled)
        if better is None:
            break
        work += better.prediction.size
        gained = at.cost - better.cost
        fit = better.weighed(rows)
        if max(gained, abs(gained - promised)) < settled:
            break
    fit.work = work
    return fit


def _better(fit: Fit, linear: Contacts, settled: float) -> tuple[Fit | None, float]:
    """The fit after a step of `linear`, as much of it as lowers the cost, and by how much the linear model says; None
    where that is less than `settled`, or nothing does."""
    before = np.exp(fit.unknowns.contacts[:, CONDUCTANCE])
    step, others = _step(linear, before)
    along = np.concatenate([step / before, others])
    promised = float(along @ (2 * linear.right - linear.normal @ along)) + linear.beside
    if promised < settled:
        return None, promised
    for _ in range(_HALVINGS):
        after = before + step
        most = _MORE / np.maximum(fit.prediction.means, 1e-9)
        after = np.clip(after, _LEAST * max(after.max(), before.max()), np.maximum(most, before))
        if isinstance(linear, Linear):
            contacts = fit.unknowns.contacts.copy()
            contacts[:, CONDUCTANCE] = np.log(after)
            moved = replace(fit.unknowns, contacts=contacts)
            moved = linear.followed(moved, np.concatenate([step / before, others]))
            tried = fit.in_place(moved)
        else:
            tried = fit.with_strengths(after)
        if tried.cost < fit.cost:
            return tried, promised
        step, others = step / 2, others / 2
    return None, promised


def _step(linear: Contacts, strengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Changes of the cells' conductances `strengths` (k,), S, none of which ends below 0, and of the
    sheet's coefficients, (J,), that minimise the linearised cost."""
    count = len(strengths)
    units = np.ones(len(linear.normal))
    units[:count] = 1 / strengths
    normal = linear.normal * np.outer(units, units)
    right = linear.right * units
    own, mixed, rest = normal[:count, :count], normal[:count, count:], normal[count:, count:]
    along = right[:count]
    if len(rest):
        factor = cho_factor(rest)
        own = own - mixed @ cho_solve(factor, mixed.T)
        along = along - mixed @ cho_solve(factor, right[count:])
    own = own + _ROUNDING * np.diag(own.diagonal())
    step = compiled.non_negative(own, own @ strengths + along) - strengths
    if not len(rest):
        return step, np.empty(0)
    return step, cho_solve(factor, right[count:] - mixed.T @ step)


def groups(fit: Fit, doubt: float | None = None, following: bool = False) -> np.ndarray:
    """(k,) number of the contact that each cell of a fit belongs to; `following`: the sensor follows, which
    is what can be told of them, else it is as it is there, for parts to begin a search with.

    Cells are taken in the order of their conductances; a cell beside two contacts keeps them apart
    where the readings contradict that it conducts half of what the lower peak does; `doubt` : in them,
    None: that of the fit.
    """
    u, doubt = fit.unknowns, fit.doubt if doubt is None else doubt
    strengths = np.exp(u.contacts[:, CONDUCTANCE])
    costs = _costs_of_more(fit, strengths, following)
    side = np.exp(u.contacts[:, RADIUS]) * np.sqrt(np.pi)
    beside = cdist(u.contacts[:, :2], u.contacts[:, :2]) < 1.5 * side
    group = np.full(len(strengths), -1)
    peaks: list[int] = []
    for cell in np.argsort(-strengths):
        near = np.unique(group[beside[cell] & (group >= 0)])
        if not len(near):
            group[cell] = len(peaks)
            peaks.append(int(cell))
            continue
        main = near[np.argmax(strengths[[peaks[each] for each in near]])]
        group[cell] = main
        for other in near[near != main]:
            wanted = _SADDLE * strengths[peaks[other]]
            if costs(cell, wanted) < (_REGION if following else _SURE) ** 2 * doubt:
                group[group == other] = main
    return np.unique(group, return_inverse=True)[1]


def _costs_of_more(
    fit: Fit, strengths: np.ndarray, following: bool
) -> Callable[[int, float], float]:
    """How much the cost grows, to second order, when a cell is given a conductance, the others that are
    not at their bound following, and if `following` the sensor: a function of cell and conductance, S."""
    linear = Linear(fit, fit.equations) if following else Contacts(fit)
    cells = slice(0, len(strengths))
    normal, right = linear.normal[cells, cells], linear.right[cells]
    if following:
        sensor = slice(linear.free, None)
        mixed = linear.normal[sensor, cells]
        follow = np.linalg.solve(linear.normal[sensor, sensor], mixed).T
        normal, right = normal - follow @ mixed, right - follow @ linear.right[sensor]
    normal, right = normal / np.outer(strengths, strengths), right / strengths
    there = _conduct(strengths)
    own = normal[np.ix_(there, there)]
    scale = 1 / np.sqrt(own.diagonal())
    inverse = np.linalg.inv(own * scale[:, None] * scale) * scale[:, None] * scale
    stiffness = normal.diagonal().copy()
    mixed = normal[np.ix_(~there, there)]
    stiffness[~there] -= np.einsum("ij,jk,ik->i", mixed, inverse, mixed)
    stiffness[there] = 1 / inverse.diagonal()
    pull = np.where(there, 0.0, np.maximum(-right, 0.0))

    def cost(cell: int, wanted: float) -> float:
        more = max(wanted - strengths[cell], 0.0)
        return 2 * pull[cell] * more + max(stiffness[cell], 0.0) * more**2

    return cost

"""Contacts of any shape: one conductance for each of many square cells.

A palm, a plate or a ring is no disc. Its conductance is a field over the sheet, none of it below 0 and
smooth within what presses: cells of a lattice have each a conductance c >= 0, a Gaussian prior whose
covariance falls as exp(-d/l) with their distance (Tarantola 2005, chapter 5), and nothing else. Their
places are fixed, so that H and D are computed once, and the readings are nearly linear in c:
Gauss-Newton, each step a non-negative least-squares problem (Lawson and Hanson 1974), finds them from
a linear image within ten steps. Sheet and channels are then fitted as well, as they are for discs
(`equations`).

What is one contact follows from the posterior: two peaks are two contacts where the readings say that
less than half of the lower one presses on every way between them. Discs may stand for small parts of it
(`Search`): fingertips beside a palm. They are the first contacts of a fit, cells the last ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.arrangement import chosen
from tomotactile_ros.estimation.equations import Contacts, Equations, Linear, contact_priors
from tomotactile_ros.estimation.first_look import FirstLook
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.one_state import Channels
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.solver import solve
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
_SETTLED = 3.0  # of the cost: a step that gains less is the last
_ROUNDING = 1e-10  # of the diagonal of the normal matrix of a step
# the same from where earlier rows ended: what cells exchange with their neighbours hardly shows and is not linear; undamped
# half of the steps at rest led to a higher cost
_LASTS = 0.05
_SADDLE = 0.5  # of the lower of two peaks: what presses at least between parts of one contact
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
    if fit.unknowns.bond is None:
        return solve(fit.operator, fit.unknowns, fit.rows, fit.prior, known=known, at=fit)
    linearised = _Linearised(known)
    conducting = _of_those_that_conduct(fit)
    found = _with_sensor(conducting, linearised)
    if conducting is not fit and found.chi_squared > _LACKING * found.rows.count:
        # some of those that had nothing to explain while the sensor was held may conduct
        found = min(found, _with_sensor(fit, linearised), key=lambda each: each.cost)
    fit = found
    linear = Linear(fit, linearised.known, anew=True)
    fit.covariance, fit.equations, fit.steps = linear.covariance(), linear.equations, 1
    if fit.lasting is not fit:
        fit.lasting.equations = linearised.known
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
    group, at = groups(fit, threshold), columns(fit)
    strengths = np.exp(fit.unknowns.contacts[:, CONDUCTANCE])
    strongest = np.bincount(group, strengths).argmax()
    certain = np.ones(len(group), bool)
    for each in np.unique(group[fit.unknowns.alone :]):
        which = group == each
        certain[which] = each == strongest or certainty(fit.covariance, at[which]) > threshold
    return certain


def certainty(covariance: np.ndarray, which: np.ndarray) -> float:
    """What contacts conduct together over its deviation, squared; `covariance` (F, F) of parameters, of
    which `which` are the logarithms."""
    return float(np.linalg.inv(covariance[which][:, which]).sum())


def at_rest(fit: Fit, known: Equations | None, usual: float) -> Fit | None:
    """The best fit of the shape that `fit` has, all of whose cells last, what they conduct in these rows or not; None
    where it leaves more over than the `usual` chi-squared a reading of fits before. `known` : equations of one of these."""
    linearised = _Linearised(known)
    most = _LACKING * usual * fit.rows.count
    found = _descended(fit, 1, linearised, _LASTS)
    if found.chi_squared > most:
        found = _descended(found, _WHOLE, linearised, _LASTS)
    if found.chi_squared > most:
        return None
    found.equations = linearised.known
    out = _of_those_that_conduct(found)
    # other equations may be those of cells that conducted nothing
    linear = Linear(out, linearised.known, anew=True)
    out.covariance, out.equations, out.steps = linear.covariance(), linear.equations, 1
    return out


def from_cells(fit: Fit, known: Equations | None = None) -> Fit:
    """Near the best fit of contacts and cells to the sensor as it is, or to one that follows, by what serves of the
    equations `known`."""
    if known is None:
        return _descended(fit, _STEPS, Contacts)
    return _descended(fit, _WHOLE, _Linearised(known))


def _of_those_that_conduct(fit: Fit) -> Fit:
    """The same without cells that are at their bound, which last."""
    kept = np.ones(len(fit.unknowns.contacts), bool)
    kept[fit.unknowns.alone :] = _conduct(_of_cells(fit))
    out = _only(fit, kept)
    out.lasting = fit
    return out


def _of_cells(fit: Fit) -> np.ndarray:
    """(m,) S, what the cells of a fit conduct."""
    return np.exp(fit.unknowns.contacts[fit.unknowns.alone :, CONDUCTANCE])


def columns(fit: Fit) -> np.ndarray:
    """(k,) which of the free parameters of a fit are what each of its contacts conducts."""
    return np.cumsum(fit.unknowns.free.ravel())[CONDUCTANCE::PARAMETERS] - 1


def _only(fit: Fit, kept: np.ndarray) -> Fit:
    """The same with the contacts `kept` (k,) only."""
    return fit if kept.all() else Fit(fit.operator, chosen(fit.unknowns, kept), fit.rows, fit.prior)


def _conduct(strengths: np.ndarray) -> np.ndarray:
    """(k,) which of `strengths` are not at their bound, 0."""
    return strengths > _ABOVE * strengths.max()


def occam(fit: Fit, doubt: float) -> float:
    """What the cells of a fit cost for what they might all have been: twice the logarithm of how much
    narrower readings, doubted, make them (Laplace's approximation of the evidence; MacKay 2003,
    chapter 28). How much they may conduct at all is what they do (evidence procedure; MacKay 1992). Half of
    what each might have been is below 0; of those that conduct, nothing is."""
    cells, strengths = columns(fit)[fit.unknowns.alone :], _of_cells(fit)
    if not len(cells):
        return 0.0
    prior = contact_priors(fit)[0]
    told = ((Contacts(fit).normal - prior) / doubt + prior)[np.ix_(cells, cells)]
    prior = prior[np.ix_(cells, cells)]
    scale = 1 / np.sqrt(told.diagonal())
    told, prior = told * np.outer(scale, scale), prior * np.outer(scale, scale)
    known = len(cells) - np.trace(np.linalg.solve(told, prior))
    spent = float(strengths @ fit.unknowns.bond @ strengths)
    less = max(known / spent, 1.0)
    told = told + (less - 1) * prior
    narrower = np.linalg.slogdet(told)[1] - np.linalg.slogdet(less * prior)[1]
    narrower += (less - 1) * spent
    return float(narrower - 2 * np.log(2) * np.count_nonzero(_conduct(strengths)))


def _descended(
    fit: Fit, steps: int, linearised: Callable[[Fit], Contacts], damping: float = _ROUNDING
) -> Fit:
    """The best fit from one of cells on, by steps of what `linearised` (a fit) has, with that `damping` of cells, of the
    diagonal of the normal matrix.

    Of the cells alone what the sensor leaves over is doubted, as in `solver.approach`.
    """
    rows, work = fit.rows, fit.prediction.size
    alone = linearised is Contacts
    for _ in range(steps):
        at = fit.weighed(replace(rows, weights=rows.weights / fit.doubt)) if alone else fit
        settled = _SETTLED * (1.0 if alone else fit.doubt)
        better, promised = _better(at, linearised(at), settled, damping)
        if better is None:
            break
        work += better.prediction.size
        gained = at.cost - better.cost
        fit = better.weighed(rows)
        if max(gained, abs(gained - promised)) < settled:
            break
    fit.work = work
    return fit


def _better(fit: Fit, linear: Contacts, settled: float, damping: float) -> tuple[Fit | None, float]:
    """The fit after a step of `linear`, as much of it as lowers the cost, and by how much the linear model says; None
    where that is less than `settled`, or nothing does."""
    alone, cells = fit.unknowns.alone, columns(fit)[fit.unknowns.alone :]
    before = _of_cells(fit)
    along = _step(linear, cells, before, damping)
    promised = float(along @ (2 * linear.right - linear.normal @ along)) + linear.beside
    if promised < settled:
        return None, promised
    most = np.maximum(_MORE / np.maximum(fit.prediction.means[alone:], 1e-9), before)
    for _ in range(_HALVINGS):
        moved, longer = linear.after(along)
        after = before * (1 + along[cells] / longer)
        after = np.clip(after, _LEAST * max(after.max(), before.max()), most)
        moved.contacts[alone:, CONDUCTANCE] = np.log(after)
        tried = fit.at(moved)
        if tried.cost < fit.cost:
            return tried, promised
        along = along / 2
    return None, promised


def _step(linear: Contacts, cells: np.ndarray, strengths: np.ndarray, damping: float) -> np.ndarray:
    """(P,) changes of all parameters that minimise the linearised cost, damped (Marquardt 1963), none of which takes the
    conductances `strengths` (m,), S, of `cells` below 0; these in parts of what they are."""
    units = np.ones(len(linear.normal))
    units[cells] = 1 / strengths
    normal = linear.normal * np.outer(units, units)
    right = linear.right * units
    rest = np.delete(np.arange(len(right)), cells)
    own, mixed = normal[np.ix_(cells, cells)], normal[np.ix_(cells, rest)]
    along = right[cells]
    if len(rest):
        factor = cho_factor(normal[np.ix_(rest, rest)])
        own = own - mixed @ cho_solve(factor, mixed.T)
        along = along - mixed @ cho_solve(factor, right[rest])
    own = own + damping * np.diag(own.diagonal())
    step = compiled.non_negative(own, own @ strengths + along) - strengths
    out = np.empty(len(right))
    out[cells] = step / strengths
    if len(rest):
        out[rest] = cho_solve(factor, right[rest] - mixed.T @ step)
    return out


def groups(fit: Fit, most: float, following: bool = False) -> np.ndarray:
    """(k,) number of the contact that each contact or cell of a fit belongs to; `following`: the sensor follows, which
    is what can be told of them, else it is as it is there, for parts to begin a search with.

    Cells are taken in the order of their conductances; a cell beside two contacts keeps them apart
    where it costs `most` or more that it conducts half of what the lower peak does. Those of `lasting` that
    conduct nothing are asked as well.
    """
    own, fit = fit, fit.lasting
    alone = fit.unknowns.alone
    cells, strengths = fit.unknowns.contacts[alone:], _of_cells(fit)
    costs = _costs_of_more(fit, strengths, following)
    side = np.exp(cells[:, RADIUS]) * np.sqrt(np.pi)
    beside = cdist(cells[:, :2], cells[:, :2]) < 1.5 * side
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
            if costs(cell, wanted) < most:
                group[group == other] = main
    group = np.append(np.arange(alone), alone + group)
    if own is not fit:
        every, here = (each.unknowns.contacts[:, :2] for each in (fit, own))
        group = group[cdist(here, every).argmin(axis=1)]
    return np.unique(group, return_inverse=True)[1]


def _costs_of_more(
    fit: Fit, strengths: np.ndarray, following: bool
) -> Callable[[int, float], float]:
    """How much the cost grows, to second order, when a cell is given a conductance, the others that are
    not at their bound following, and if `following` the sensor: a function of cell and conductance, S."""
    linear = Linear(fit, fit.equations, anew=False) if following else Contacts(fit)
    cells = columns(fit)[fit.unknowns.alone :]
    normal, right = linear.normal[np.ix_(cells, cells)], linear.right[cells]
    if following:
        others = np.delete(np.arange(len(linear.right)), cells)
        mixed = linear.normal[np.ix_(others, cells)]
        follow = np.linalg.solve(linear.normal[np.ix_(others, others)], mixed).T
        normal, right = normal - follow @ mixed, right - follow @ linear.right[others]
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

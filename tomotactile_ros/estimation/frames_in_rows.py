"""What a complete frame tells whoever follows rows: sizes, wide contacts, what was missed or is not
there.

Rows have told of the sensor and of small contacts what the frame tells, which is the same readings:
they keep it, unless a contact is significantly elsewhere, and not as it moves; then the frame is
right, which fits all rows at once. It tells sizes, contacts that rows missed, and which of theirs are
none. Wide contacts and shapes of several discs are not followed: rows take them for a part of the
sheet until the next frame.

The estimate of a frame may take longer than a row: it is compared with what rows said when the
frame's last row was read, and what it changes is changed in what they say by now.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.arrangement import chosen
from tomotactile_ros.estimation.estimator import SLIDING, State
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.follow import Follower
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.joining import TOUCHING
from tomotactile_ros.estimation.prior import RATES
from tomotactile_ros.estimation.reported import Contact, Estimate
from tomotactile_ros.estimation.row_model import Known, RowModel
from tomotactile_ros.estimation.row_state import STATE, Belief, RowState
from tomotactile_ros.estimation.settling import Settling
from tomotactile_ros.estimation.touch import CONDUCTANCE, RADIUS, STRETCH, X, Y
from tomotactile_ros.estimation.tracks import REACH, has_moved

# times the time between frames for which what moves is taken to go on: a frame is told up to half
# a frame late
_GOES_ON = 2.0
_CARRIED = (
    0.05  # spacings that wide contacts go until rows are linear about them where they are by then
)
_WIDE = 0.4  # spacings: discs with larger radii are more than one patch to electrodes
_STRETCHED = 0.3  # half the logarithm of the ratio of axes beyond which a shape is no disc
# deviations, root mean square over the electrodes, by which a frame has their places otherwise: the sensor is
# then what the frame says
_ELSEWHERE = 1.0
# deviations of what was expected, root of the sum of squares over the sheet's coefficients, up to which rows go on with
# the sheet that they are linear about: where one is uneven by 20 %, a tenth, whose square is within what a row is inexact
_LINEAR = 0.5
POOR = 1.5  # chi-squared a reading: frames of one state that were looked at have 1.0 to 1.1
_CONTRADICTS = 1e-3  # probability of a difference as large between rows and the frame of the same
_AT_MOST = 3.0  # standard deviations that a speed is off, at most
_FLOOR = 1e-7  # m²: differences below 0.3 mm are none


@dataclass(frozen=True)
class Fitted:
    """What rows take from a `Fit`; little enough to be handed to another process.

    used : electrodes; unknowns, covariance, chi_squared : of the fit; count : of its readings
    lasts : s from the time of the unknowns to that of the last row
    uneven : `Equations.unevenness` of the sheet
    """

    used: tuple[int, ...]
    unknowns: Unknowns
    covariance: np.ndarray
    chi_squared: float
    count: int
    lasts: float
    uneven: float = 1.0

    @classmethod
    def of(cls, fit: Fit) -> Fitted:
        """Of a fit that was solved."""
        return cls(
            tuple(int(each) for each in fit.operator.used),
            fit.unknowns,
            fit.covariance,
            fit.chi_squared,
            max(fit.rows.count, 1),
            fit.rows.last,
            fit.equations.unevenness(fit),
        )


@dataclass(frozen=True)
class FrameSeen:
    """What a frame said.

    estimate, fit : of it; the fit is None where the estimate is not valid
    begun, ended : s, times of its first and last row
    settling : what readings keep of the row before, as far as frames have shown it
    """

    estimate: Estimate
    fit: Fitted | None
    begun: float = 0.0
    ended: float = 0.0
    settling: Settling | None = None

    @classmethod
    def of(cls, estimate: Estimate, state: State) -> FrameSeen:
        """What was just estimated with `state`, at times that are not known yet."""
        fit = None
        if estimate.state == "valid" and state.fit is not None and state.fit.equations is not None:
            fit = Fitted.of(state.fit)
        return cls(estimate, fit, settling=state.settling)

    def at(self, begun: float, period: float, rows: int) -> FrameSeen:
        """The same of a frame of so many rows, `period` s from one to the next."""
        return replace(self, begun=begun, ended=begun + period * (rows - 1))


def corrected(
    follower: Follower,
    state: RowState,
    seen: FrameSeen,
    fit: Fitted,
    then: Mapping[int, np.ndarray],
    ended: bool = False,
) -> None:
    """Takes a valid frame and its fit into `state`.

    then : {number: (3, 2) place, m, and its covariance, m²} of contacts as rows had it when the frame
        ended (`placed`)
    ended : whether rows saw something end within the frame or the one before: it may show it still
    """
    operator, belief = follower.operator, state.belief
    spread = {number: each[1:] for number, each in then.items()}
    then = {number: each[0] for number, each in then.items()}
    found, state.uneven = fit.unknowns.after(fit.lasts), fit.uneven
    since = max(state.time - seen.ended, 0.0)
    reach, confused = REACH * operator.pitch, bool(np.isinf(state.confused))
    slide = {} if confused else sliding(belief)
    blurred = _blurred(found, then, slide, reach, seen.ended - seen.begun)
    if ended and not confused:  # what was there before may be seen still, as something wide
        there = [*then.values(), *(np.array([each.x, each.y]) for *_, each in state.wide)]
        blurred |= _wide(found, operator.pitch) & _apart(found, there, reach)
    if not confused:  # rows saw the end of what the frame shows as something wide
        gone = [place for number, place in then.items() if number not in belief.numbers]
        blurred |= _wide(found, operator.pitch) & ~_apart(found, gone, reach)
    # rows one by one tell more of what changes than some of them together do, or all not well explained
    partial = not confused and (seen.estimate.first > 0 or fit.chi_squared > POOR * fit.count)
    if partial:
        blurred |= _wide(found, operator.pitch) & ~_apart(found, [*then.values()], reach)
    is_wide = _wide(found, operator.pitch) & ~blurred
    step = seen.ended - state.wide_time
    state.wide = _numbered(state, seen.estimate, found, is_wide, operator.pitch, step)
    state.wide_time, state.wide_step, state.wide_carried = seen.ended, step, 0.0
    misfit, left = max(1.0, fit.chi_squared / fit.count), dict(then)
    if confused:
        belief = belief.unlearned(state.model.known.shift_deviation)
        state.distrusted = np.zeros_like(state.distrusted)  # the frame has left out which are wrong
    for i in np.flatnonzero(~is_wide & ~blurred):
        contact, (size, own) = found.contacts[i], _covariance(fit, int(i), misfit)
        mean = np.array([contact[X], contact[Y], *found.rates[i, :2], contact[CONDUCTANCE]])
        sizes = np.array([contact[RADIUS], size])
        own[[2, 3], [2, 3]] = np.square(RATES[0])
        number = _nearest(left, mean[:2], reach)
        if confused and number is not None and number not in belief.numbers:
            left.pop(number)  # that it has gone since is not believed either
            number = None
        if number is None:
            mean[:2] += since * found.rates[i, :2]
            later = dict(zip(belief.numbers, belief.contacts[:, :2]))
            fresh = {n: place for n, place in later.items() if n not in then}
            known_by_now = _nearest(fresh, mean[:2], reach) is not None
            if confused or not (known_by_now or ended or partial):
                state.last += 1
                shown = operator.count  # rows: those of the frame
                belief = belief.with_contact(mean, own, sizes, state.last, state.time, shown)
            continue
        before = left.pop(number)
        if number in belief.numbers:  # otherwise it has gone since
            which = belief.numbers.index(number)
            if confused:  # nor is the way believed that it has gone by rows since then
                mean[:2] += since * found.rates[i, :2]
                before = belief.mean[STATE * which : STATE * which + 2]
            mean[:2] -= before
            seconds = state.time - seen.begun
            known_then = None if confused else spread[number]
            belief = _agreed(belief, which, mean, own, sizes, known_then, seconds)
    taken_over = {number for number, *_ in state.wide}
    unclear = dict(enumerate(found.contacts[blurred, :2]))  # may be one of those that rows have
    for j in reversed(range(belief.count)):
        number = belief.numbers[j]
        missed = number in left and (confused or belief.begun[j] <= seen.begun)
        missed = missed and _nearest(unclear, left[number], reach) is None
        in_wide = number in taken_over or _lies_in(belief.contacts[j], found.contacts[is_wide])
        if in_wide or (missed and number not in slide):
            belief = belief.without(j)
    linear = state.model.known
    known = linear.moved(belief.shift, None)
    aside = found.aside - known.aside
    elsewhere = np.sqrt(np.mean((aside / known.deviations[3:]) ** 2)) > _ELSEWHERE
    anew = bool(is_wide.any()) or confused or elsewhere
    if anew:  # rows took it for something else, and the sensor for the rest
        wide = chosen(found, is_wide) if is_wide.any() else None
        state.wide_ways = found.rates[is_wide, :2]
        known = replace(known, sheet=found.sheet, gain=found.gain, aside=found.aside, wide=wide)
        belief = belief.unlearned(known.shift_deviation)
    if anew or linear.wide is not None or _strays(known.sheet - linear.sheet, known):
        linearised(follower, state, known, belief)
    else:
        state.belief, state.unexplained = belief, 0
    state.confused, state.touched_at_once = 0.0, False
    state.read = max(state.read, 1)  # a first row that is touched needs no other frame


def placed(past: Mapping[int, np.ndarray], lasts: float) -> dict[int, np.ndarray]:
    """{number: (3, 2) place, m, and its covariance, m²} of contacts `lasts` s after rows had them as in
    `RowsState.past`: rows that were lost since then do not tell how they went on (`belief.hpp`)."""
    onward = np.hstack([np.eye(2), lasts * np.eye(2)])
    unseen = compiled.ENDURING**2 / compiled.WITHIN * lasts**3 / 3 * np.eye(2)
    return {
        number: np.vstack([onward @ each[0], onward @ each[1:] @ onward.T + unseen])
        for number, each in past.items()
    }


def _strays(way: np.ndarray, known: Known) -> bool:
    """Whether a sheet whose coefficients are `way` (J,) off is too far for what is linear about it."""
    free = known.sheet_deviation > 0
    off = way[free] / known.sheet_deviation[free]
    return bool(off @ off > _LINEAR**2)


def sliding(belief: Belief) -> dict[int, float]:
    """{number: speed, m/s} of contacts that are known to move."""
    out = {}
    for j, number in enumerate(belief.numbers):
        at = slice(STATE * j + 2, STATE * j + 4)
        speed = float(np.hypot(*belief.mean[at]))
        if speed > SLIDING + _AT_MOST * np.sqrt(np.trace(belief.covariance[at, at])):
            out[number] = speed
    return out


def _blurred(
    found: Unknowns,
    then: Mapping[int, np.ndarray],
    sliding: Mapping[int, float],
    reach: float,
    lasts: float,
) -> np.ndarray:
    """(k,) bool, contacts of a frame of `lasts` s that are the way of one that slides."""
    out = np.zeros(len(found.contacts), bool)
    for number, speed in sliding.items():
        if number in then:
            apart = np.hypot(*(found.contacts[:, :2] - then[number]).T)
            out |= apart < reach + speed * lasts / 2
    return out


def _nearest(places: Mapping[int, np.ndarray], place: np.ndarray, reach: float) -> int | None:
    """Number of the nearest of `places` within `reach`, m."""
    apart = {number: float(np.hypot(*(each - place))) for number, each in places.items()}
    best = min(apart, key=apart.__getitem__, default=None)
    return None if best is None or apart[best] > reach else best


def _apart(found: Unknowns, places: Iterable[np.ndarray], reach: float) -> np.ndarray:
    """(k,) bool, contacts of a frame that are at none of `places`."""
    out = np.ones(len(found.contacts), bool)
    for place in places:
        away = np.hypot(*(found.contacts[:, :2] - place).T)
        out &= away > reach + np.exp(found.contacts[:, RADIUS])
    return out


def _lies_in(contact: np.ndarray, wide: np.ndarray) -> bool:
    """Whether the centre of a contact of rows is within one of the contacts `wide` (k, 6): rows
    take a part of those for small ones."""
    apart = np.hypot(*(wide[:, :2] - contact[:2]).T)
    return bool((apart < np.exp(wide[:, RADIUS])).any())


def _agreed(
    belief: Belief,
    which: int,
    mean: np.ndarray,
    covariance: np.ndarray,
    sizes: np.ndarray,
    then: np.ndarray | None,
    seconds: float,
) -> Belief:
    """The contact `which` of rows with the size that the frame found, and with its place where they
    contradict, as far as it may not have moved: a frame knows less of that than rows. `mean` (5,) has the
    change of the place in the place of the place.

    then (2, 2) : covariance, m², of the place by rows when the frame ended, which may have been known far
        less well than it is by now; None where rows are not believed
    seconds : since the frame began
    """
    at = slice(STATE * which, STATE * which + STATE)
    change = mean[:2]
    sized = belief.sizes.copy()
    sized[which] = sizes
    belief = belief.replaced(sizes=sized)
    if then is not None:
        own = belief.covariance[at, at]
        speed = np.hypot(*belief.mean[at][2:4]) + _AT_MOST * np.sqrt(own[2, 2] + own[3, 3])
        unlike = change @ np.linalg.solve(then + covariance[:2, :2] + _FLOOR * np.eye(2), change)
        if np.hypot(*change) < speed * seconds or unlike < chdtri(2, _CONTRADICTS):
            return belief
    moved, spread = belief.mean.copy(), belief.covariance.copy()
    moved[at], spread[at], spread[:, at] = [*(moved[at][:2] + change), *mean[2:]], 0.0, 0.0
    spread[at, at] = covariance
    return belief.replaced(mean=moved, covariance=spread)


def linearised(follower: Follower, state: RowState, known: Known, belief: Belief) -> None:
    """Goes on with the contacts of `belief`, linear about what is `known` of the sensor by now."""
    operator, wide = follower.operator, known.wide
    background = fields = None
    if wide is not None:
        touched = Prediction(operator, wide, np.arange(operator.count))
        background = np.linalg.inv(touched.impedance) - operator.admittance_of(wide.sheet)
        fields = touched.fields
    state.go_on(RowModel(operator, known, background, fields))
    mean = belief.mean.copy()
    mean[STATE * belief.count :] = 0.0
    state.belief, state.unexplained = belief.replaced(mean=mean), 0


def _wide(seen: Unknowns, pitch: float) -> np.ndarray:
    """(k,) bool, contacts that are more than a small disc alone, or cells of a shape."""
    contacts = seen.contacts
    radii = np.exp(contacts[:, RADIUS])
    out = (radii > _WIDE * pitch) | (np.hypot(*contacts[:, STRETCH:].T) > _STRETCHED)
    apart = np.hypot(*(contacts[:, None, :2] - contacts[:, :2]).transpose(2, 0, 1))
    touching = (apart < TOUCHING * np.add.outer(radii, radii)) & ~np.eye(len(radii), dtype=bool)
    out[seen.alone :] = True
    return out | touching.any(axis=1)


def _covariance(fit: Fitted, which: int, misfit: float) -> tuple[float, np.ndarray]:
    """Variance of ln a, and (5, 5) covariance of x, y, nothing of the velocity, ln c of a contact
    of a fit."""
    free = fit.unknowns.free
    first = int(np.count_nonzero(free[:which]))
    index = {int(each): first + k for k, each in enumerate(np.flatnonzero(free[which]))}
    own = np.zeros((STATE, STATE))
    at = np.ix_([0, 1, 4], [0, 1, 4])
    where = [index[X], index[Y], index[CONDUCTANCE]]
    own[at] = fit.covariance[np.ix_(where, where)] * misfit
    size = fit.covariance[index[RADIUS], index[RADIUS]] * misfit if RADIUS in index else 0.0
    return float(size), own


def _numbered(
    state: RowState,
    estimate: Estimate,
    seen: Unknowns,
    is_wide: np.ndarray,
    pitch: float,
    step: float,
) -> list:
    """Contacts of the frame that have wide parts, with their numbers, and velocities by where they
    were in the frame `step` s before; see `RowState.wide`.

    Rows may have followed one as a small contact: it keeps the number.
    """
    if not is_wide.any():
        return []
    small = zip(state.belief.numbers, state.belief.begun, state.belief.contacts)
    before = [(number, began, c.x, c.y, c) for number, began, c in state.wide]
    before += [(number, began, c[X], c[Y], None) for number, began, c in small]
    found = []
    centres = seen.contacts[is_wide, :2]
    radii = np.exp(seen.contacts[is_wide, RADIUS])
    for contact in estimate.contacts:
        here = np.array([contact.x, contact.y])
        if not (np.hypot(*(centres - here).T) < np.maximum(radii, contact.radius)).any():
            continue
        reach = REACH * pitch + contact.radius
        same = [w for w in before if np.hypot(w[2] - contact.x, w[3] - contact.y) < reach]
        if same:
            before.remove(same[0])
            number, began, *_, earlier = same[0]
            contact = _moving(contact, earlier, step)
        else:
            state.last += 1
            number, began = state.last, state.time
        found.append((number, began, contact))
    return found


def _moving(contact: Contact, earlier: Contact | None, step: float) -> Contact:
    """The same with its velocity, if it was elsewhere `step` s `earlier`."""
    if earlier is None or any(contact.velocity) or not 0 < step < np.inf:
        return contact
    way = np.array([contact.x - earlier.x, contact.y - earlier.y])
    spread = np.add(contact.covariance, earlier.covariance).reshape(2, 2)
    if not has_moved(way, spread):
        return contact
    x, y = (way / step).tolist()
    return replace(contact, velocity=(x, y))


def carried_on(follower: Follower, state: RowState, time: float) -> None:
    """Brings wide contacts that move to `time`, s, in what rows are compared with."""
    known = state.model.known
    if known.wide is None or not state.wide_ways.any():
        return
    lasts = _since(state, time) - state.wide_carried
    reach = _CARRIED * follower.operator.pitch
    if lasts * float(np.hypot(*state.wide_ways.T).max()) < reach:
        return
    contacts = known.wide.contacts.copy()
    contacts[:, :2] += lasts * state.wide_ways
    state.wide_carried += lasts
    wide = replace(known.wide, contacts=contacts)
    belief, last = state.belief, state.unexplained
    linearised(follower, state, known.moved(belief.shift, wide), belief)
    state.unexplained = last


def wide_now(state: RowState) -> list:
    """`RowState.wide` at the time of the last row: what moves goes on as from one frame to the next."""
    found = []
    for number, begun, contact in state.wide:
        lasts = _since(state, state.time)
        if any(contact.velocity) and lasts > 0:
            vx, vy = contact.velocity
            part = lasts / state.wide_step  # of the way from the frame before
            more = (1 + part) ** 2 + part**2
            covariance = tuple(more * each for each in contact.covariance)
            place = {"x": contact.x + lasts * vx, "y": contact.y + lasts * vy}
            contact = replace(contact, **place, covariance=covariance)
        found.append((number, begun, contact))
    return found


def _since(state: RowState, time: float) -> float:
    """s from the last frame that showed wide contacts to `time`, as far as they are taken to go on."""
    return min(max(time - state.wide_time, 0.0), _GOES_ON * state.wide_step)

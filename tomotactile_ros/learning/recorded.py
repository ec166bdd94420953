"""A sensor from recorded frames, of touches of unknown place and force and of the untouched sheet.

Untouched frames give offsets; reciprocity gives gains, without any model; then one frame after the
other is fitted and learned from, and in the end all of them together about what has come out
(Gauss-Newton on all frames with the contacts of each eliminated). Frames that are alike are taken
once: most of a recording is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.one_state import reciprocity
from tomotactile_ros.estimation.operator import SheetOperator, operator_for
from tomotactile_ros.estimation.reciprocity import Gains, fit_gains
from tomotactile_ros.estimation.screening import STUCK, clipped, dead_channels, stuck_channels
from tomotactile_ros.estimation.settling import Settling, rows_before, unsettled
from tomotactile_ros.estimation.tears import EXPLAIN, couplings, find_tears, refined
from tomotactile_ros.frame import Frame, stacked
from tomotactile_ros.layouts.layout import Layout, check_layout, check_on_sheet
from tomotactile_ros.learning.kept_out import LEAST, KeptOut, forgotten
from tomotactile_ros.learning.learner import (
    DOUBTFUL,
    EXPLAINED,
    Exchanged,
    Learner,
    left_over,
)
from tomotactile_ros.learning.ledger import Ledger
from tomotactile_ros.learning.readings import (
    are_offsets,
    is_untouched,
    offsets,
    rows_of,
    square,
)
from tomotactile_ros.learning.state import WIDE, SensorState
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

MOST = 60  # touches
_NEW = 1.5  # times what noise makes of the difference of two frames: another touch
_ROUNDS = 6  # of all frames together
_SETTLED = 0.05  # standard deviations that a round moves the sensor: then it is the last
_ODD = 3.0  # times the typical misfit: contacts are looked for anew
_GAINS = 24  # frames that reciprocity is tried on at once
_HELD = 1e-2  # of the deviations of outline and radius, while the sheet is taken as drawn
_CUT = ("outline and radius",)  # of `kept_out.GROUPS`, what is held
_PROBED = 3  # touches: where most leave more than `EXPLAINED`, tears are looked for
_LOOKED_AT = 6  # frames that nothing explains, in which swapped wires are looked for
# chi-squared per equation of reciprocity, beyond which something moves while rows are read: 1 at rest, 3
# where channels keep 0.5 % of the row before, 4.5 and more with two fingers at 20 and 30 mm/s
_MOVING = 4.0

Watch = Callable[[Iterable, str], Iterable]


@dataclass(frozen=True, eq=False)
class Learned:
    """A sensor, and how it was learned.

    untouched, alike, unexplained : frames without a touch, like another one, and those that no
        contacts explain
    unread : frames without readings
    constant : frames that read the same whatever is grounded, but far more than offsets
    moved : frames in which something moved while rows were read
    exchanged : two electrodes whose wires are exchanged, None where nothing says so; with them nothing
        but gains and offsets is learned
    kept_out : how well touches are predicted from others, None of fewer than five
    ended : electrodes whose offset lies below what the converter shows
    faults : {electrode: what is wrong with its channel}
    asymmetry : chi-squared per equation of reciprocity, before and with the gains found; None
        without touches
    clipped : share of the readings of touches that are at an end of the converter's range
    settling : what readings keep of the row before, None where they keep nothing
    courses : state after each touch, where asked for
    """

    state: SensorState
    operator: SheetOperator
    untouched: int = 0
    alike: int = 0
    unexplained: int = 0
    unread: int = 0
    constant: int = 0
    moved: int = 0
    exchanged: Exchanged | None = None
    kept_out: KeptOut | None = None
    ended: tuple[int, ...] = ()
    faults: dict[int, str] = field(default_factory=dict)
    asymmetry: float | None = None
    clipped: float = 0.0
    settling: Settling | None = None
    courses: list[SensorState] = field(default_factory=list)


def learn(
    layout: Layout,
    frames: Iterable[Frame] | ArrayLike,
    grounded: ArrayLike | None = None,
    drive: float | None = None,
    *,
    noise: float,
    radius: float = 0.005,
    model: str = "auto",
    most: int = MOST,
    state: SensorState | None = None,
    course: bool = False,
    before: np.ndarray | None = None,
    watch: Watch = lambda items, doing: items,
) -> Learned:
    """What frames tell of the sensor.

    Parameters
    ----------
    frames : `Frame`s, also those of a file, or their voltages alone: (N, L, E) V, and then
    grounded : (L,) electrode of each row; drive : V
    noise : of a reading, V rms
    radius : typical of a contact, m; model : of the sheet; most : touches that are learned from
    state : what is known already
    course : keep the state after each touch
    before : (N, L, E) V, potentials in the row before each; None: rows are in the order of time, and
        the last one was before the first
    """
    check_layout(layout)
    check_on_sheet(layout, checks.length(radius, "radius"), "radius")
    checks.positive(noise, "noise", "voltage in V")
    voltages, order, volts = stacked(frames, grounded, drive)
    given = len(voltages)
    kept = np.flatnonzero(_read(voltages, order))
    voltages = voltages[kept]
    if not len(voltages):
        raise InputError("no frame has readings")
    idle = np.array([is_untouched(frame, order, noise) for frame in voltages])
    constant = idle & ~_are_offsets(voltages, order, state)
    voltages, idle, kept = voltages[~constant], idle[~constant], kept[~constant]
    if not len(voltages):
        raise InputError(
            f"all {given} frames read the same whichever electrode is grounded, and far more than "
            "offsets; readings of a few mV are wanted where nothing touches: is anything grounded, and "
            "is the range of the converter wide enough?"
        )
    ends = clipped(voltages, volts)
    faults = _faults(voltages, order, idle, noise)
    used = np.array([e for e in range(layout.electrodes) if e not in faults])
    if len(used) < 2:
        raise InputError("fewer than two electrodes can be read")
    operator = operator_for(layout, model, used)
    learner = Learner(operator, radius, volts, state)
    state = learner.state
    ended: tuple[int, ...] = ()
    if idle.any():
        found = offsets(voltages[idle], order, noise, state["offset"], state.std("offset"))
        learner.untouched(found, int(idle.sum()))
        ended = tuple(np.flatnonzero(found.ended).tolist())
    chosen = _different(voltages, ends, ~idle, noise, most)
    done = Learned(
        learner.state,
        operator,
        int(idle.sum()),
        int((~idle).sum() - len(chosen)),
        unread=given - len(constant),
        constant=int(constant.sum()),
        ended=ended,
        faults=faults,
    )
    if not len(chosen):
        return done
    start = learner.state
    if before is None:
        earlier = np.array([rows_before(frame, order) for frame in voltages[chosen]])
    else:
        earlier = before[kept][chosen]
    settling = kept_of_rows_before(learner, voltages[chosen], earlier, ends[chosen], order, noise)
    if settling is not None:
        voltages[chosen] = settling.less(voltages[chosen], earlier)
        done = replace(done, settling=settling)
    squares = np.array([square(voltages[i], order, ends[i]) for i in chosen])
    steady, asymmetry = _steady(learner, squares, noise)
    chosen, squares, moved = chosen[steady], squares[steady], int((~steady).sum())
    if not len(chosen):
        return replace(done, moved=moved, asymmetry=asymmetry)
    _gains(learner, squares, noise)
    rows = [rows_of(operator, voltages[i], order, volts, noise, ends[i]) for i in chosen]
    if torn(learner, rows[:_PROBED], squares):
        start = replace(start, tears=learner.state.tears)
    known = learner.state
    fits, courses, as_drawn = _first(learner, rows, watch, course)
    kept_out = None
    exchanged = _exchanged(learner, known, fits)
    if exchanged is not None:
        fits, courses = [], []
    if any(_is_good(fit) for fit in fits):
        held = as_drawn and learner.ledger.touches < LEAST
        fits, kept_out = _together(learner, start, fits, watch, held)
    good = sum(_is_good(fit) for fit in fits)
    return replace(
        done,
        state=learner.state,
        unexplained=len(rows) - good,
        moved=moved,
        exchanged=exchanged,
        kept_out=kept_out,
        asymmetry=asymmetry,
        clipped=float(ends[chosen].mean()),
        courses=courses,
    )


def _read(frames, grounded):
    """(F,) bool, frames that have a reading, that of the grounded electrode apart."""
    valid = np.isfinite(frames)
    valid[:, np.arange(len(grounded)), grounded] = False
    return valid.any(axis=(1, 2))


def _are_offsets(frames, grounded, state):
    """(F,) bool, which of the frames read what offsets may be."""
    count = frames.shape[-1]
    mean, expected = np.zeros(count), np.full(count, WIDE.offset)
    if state is not None:
        mean, expected = state["offset"], state.expected[state.slice("offset")]
    return np.array([are_offsets(frame, grounded, mean, expected) for frame in frames])


def _faults(frames, grounded, idle, noise):
    """Channels that cannot be learned from."""
    valid = np.isfinite(frames)
    valid[:, np.arange(len(grounded)), grounded] = True
    dead = dead_channels(valid.reshape(-1, valid.shape[-1]))
    found = {int(e): "no readings" for e in np.flatnonzero(dead)}
    touched = frames[~idle]
    if len(touched):
        read = np.isfinite(touched)
        read[:, np.arange(len(grounded)), grounded] = False
        flat, read = touched.reshape(-1, touched.shape[-1]), read.reshape(-1, touched.shape[-1])
        for e in np.flatnonzero(stuck_channels(flat, read, noise)):
            found.setdefault(int(e), STUCK)
    return found


def _different(frames, ends, touched, noise, most):
    """Frames that differ from each other by more than noise, the most different first."""
    which = np.flatnonzero(touched)
    if not len(which):
        return which
    flat = np.where(np.isfinite(frames) & ~ends, frames, 0.0)[which].reshape(len(which), -1)
    size = np.sqrt(flat.shape[1])
    energy = np.linalg.norm(flat, axis=1)
    order = [int(np.argsort(energy)[len(energy) // 2])]
    nearest = np.linalg.norm(flat - flat[order[0]], axis=1)
    while len(order) < min(most, len(which)):
        furthest = int(nearest.argmax())
        if nearest[furthest] < _NEW * np.sqrt(2) * noise * size:
            break
        order.append(furthest)
        nearest = np.minimum(nearest, np.linalg.norm(flat - flat[furthest], axis=1))
    return which[order]


def _steady(learner, squares, noise):
    """(n,) bool, which of the frames `squares` (n, E, E), V, are of one state of the sheet, as reciprocity says; its
    chi-squared per equation in the typical one of these, None where too few pairs were read."""
    found = []
    for first in range(0, len(squares), _GAINS):
        misfit = _misfits(learner, squares[first : first + _GAINS], noise)
        if misfit is None:
            return np.ones(len(squares), bool), None
        found.append(misfit)
    misfit = np.concatenate(found)
    steady = misfit < _MOVING
    return steady, float(np.median(misfit[steady] if steady.any() else misfit))


def _misfits(learner, squares, noise):
    """(n,) chi-squared per equation of reciprocity of each frame, None where too few pairs were read.

    Most touches begin and end within a frame, which contradicts reciprocity by itself. Of the others, one in
    which something moves spoils the gains that all are fitted with: the worst are left out, half of them at
    the most in each turn, until the others agree. Where these are fewer than half there is no telling which
    are right, and all are judged together.
    """
    known = np.array([_alone(learner, each[None], noise) for each in squares])
    kept, at_first = np.flatnonzero(known < _MOVING), None
    steady = len(kept)
    while len(kept) and 2 * len(kept) >= steady:
        try:
            gains = _by_reciprocity(learner, squares[kept], noise)
        except np.linalg.LinAlgError:  # by themselves readings of a sheet, together of none
            known[kept] = np.inf
            return known
        if gains is None:
            return None
        known[kept] = gains.misfit
        at_first = known.copy() if at_first is None else at_first
        worst = float(gains.misfit.max())
        if worst < _MOVING:
            return known
        order = np.argsort(gains.misfit)
        bad = np.count_nonzero(gains.misfit > max(_MOVING, worst / 2))
        kept = np.sort(kept[order[: len(kept) - min(bad, (len(kept) + 1) // 2)]])
    return known if at_first is None else at_first


def _alone(learner, one, noise):
    """Chi-squared per equation of reciprocity of a frame by itself, infinite where no gains have it."""
    try:
        gains = _by_reciprocity(learner, one, noise)
    except np.linalg.LinAlgError:
        return np.inf
    return 0.0 if gains is None else float(gains.misfit[0])


def kept_of_rows_before(
    learner: Learner, frames, before, ends, grounded, noise: float, known: Settling | None = None
) -> Settling | None:
    """What the readings of touches, frames (F, L, E), V, keep of the row before, with the potentials
    `before` (F, L, E), V; `ends` (F, L, E) readings that are left out."""
    operator, prior = learner.operator, learner.prior()
    electrodes = frames.shape[2]
    for frame, earlier, unused in zip(frames[:_GAINS], before, ends):
        read = frame if known is None else known.less(frame, earlier)
        rows = rows_of(operator, read, grounded, learner.drive, noise, unused)
        earlier_of = np.full((electrodes, electrodes), np.nan)
        earlier_of[grounded] = earlier / learner.drive
        try:
            found = reciprocity(rows, prior)
            more = unsettled(found, earlier_of, operator.used, prior, known)
        except np.linalg.LinAlgError:  # no readings of a sheet
            continue
        known = more or known
    return known


def moves(learner: Learner, voltages: np.ndarray, grounded: np.ndarray, noise: float) -> bool:
    """Whether something moved while the rows of a frame (L, E), V, were read, whatever gains are;
    LinAlgError where they are no readings of a sheet."""
    used, state = learner.operator.used, learner.state
    wide = state.expected[state.slice("gain")][used]
    one = square(voltages, grounded, clipped(voltages, learner.drive))
    found = _by_reciprocity(learner, one[None], noise, wide)
    return found is not None and float(found.misfit[0]) > _MOVING


def _by_reciprocity(learner, squares, noise, wide=None) -> Gains | None:
    """Gains and offsets that frames `squares` (n, E, E), V, tell by themselves, None where too few pairs were
    read; LinAlgError where no gains explain them; `wide` deviations of gains instead of those that are
    known."""
    used, state = learner.operator.used, learner.state
    matrices = squares[:, used[:, None], used]
    both = np.isfinite(matrices) & np.isfinite(matrices.transpose(0, 2, 1))
    if both.sum() < 4 * both[:, np.eye(len(used), dtype=bool)].size:
        return None
    return fit_gains(
        matrices,
        learner.drive,
        noise,
        (state["gain"][used], state.std("gain")[used] if wide is None else wide),
        (state["offset"][used], state.std("offset")[used]),
    )


def _gains(learner, squares, noise) -> None:
    """Start from the gains that reciprocity gives."""
    used, state = learner.operator.used, learner.state
    try:
        found = _by_reciprocity(learner, squares[:_GAINS], noise)
    except np.linalg.LinAlgError:  # contacts decide about each frame then
        return
    if found is None:
        return
    where = np.concatenate([state.slice("gain").start + used, state.slice("offset").start + used])
    told = np.concatenate([found.gain, found.offset])
    learner.set(state.told(where, told, found.covariance))


def _first(learner, rows, watch, course):
    """`_one_by_one` on the sheet as drawn, or, where that does not explain them, cut and printed as they show
    it: few touches take unevenness for another outline, from where all together lead elsewhere. And whether it is
    as drawn."""
    known = learner.state
    learner.set(known.spread("cut", _HELD))
    fits, courses = _one_by_one(learner, rows, watch, course)
    if np.median([left_over(fit) for fit in fits]) < EXPLAINED:
        learner.set(learner.state.spread("cut", 1 / _HELD))  # nothing was learned of it yet
        return fits, courses, True
    learner.set(known)
    learner.about()
    learner.ledger = Ledger(learner.operator.pitch)
    return *_one_by_one(learner, rows, watch, course), False


def _one_by_one(learner, rows, watch, course):
    """Fits of all frames, each with what those before have shown; and the states, where asked
    for."""
    fits, courses = [], []
    for each in watch(rows, "learning from touches"):
        fit = learner.look(each)
        learner.learn(fit)
        fits.append(fit)
        if course:
            courses.append(learner.state)
    return fits, courses


def _exchanged(learner, known, fits) -> Exchanged | None:
    """Two electrodes whose exchange explains most of the frames that nothing else does, where these are
    most of `fits`; the learner is back at `known` then."""
    odd = [fit for fit in fits if not _is_good(fit)]
    if 2 * len(odd) <= len(fits):
        return None
    after = learner.state
    learner.set(known)
    learner.about()
    found = learner.exchanged_in(odd[:_LOOKED_AT])
    if found is None:
        learner.set(after)
        learner.about()
    else:
        learner.ledger = Ledger(learner.operator.pitch)
    return found


def torn(learner: Learner, rows: Sequence[Rows], squares: Sequence[np.ndarray]) -> bool:
    """Whether tears explain most of `rows`, which nothing else does, of touches `squares` (E, E), V, NaN: not
    read; the learner goes on with them then."""
    known, used = learner.state, learner.operator.used
    before = np.median([left_over(learner.look(each)) for each in rows])
    if before < EXPLAINED:
        return False
    read = np.array([each[np.ix_(used, used)] for each in squares]) / learner.drive
    channels = known["gain"][used], known["offset"][used] / learner.drive
    tears = find_tears(learner.operator, couplings(learner.operator, read, *channels))
    if tears:
        learner.set(replace(known, tears=(*known.tears, *tears)))
        with suppress(InputError):  # they leave the sheet in pieces
            learner.about()
            fits = [learner.look(each) for each in rows]
            if np.median([left_over(fit) for fit in fits]) - 1 < EXPLAIN * (before - 1):
                tears, _ = refined(fits, partial(learner.operator.cut_as, known["cut"]))
                learner.set(replace(known, tears=tears))
                learner.about()
                return True
        learner.set(known)
        learner.about()
    return False


def _together(learner, start, fits, watch, held):
    """All frames about the sensor that they have shown together, until it stays; and how well touches
    predict each other. With outline and radius `held` as they were at the `start`: too few touches show a radius
    that is a tenth off, with resistances that make up for it, where the model of the sheet is 1e-4 of the drive
    voltage off; and too few it is that could tell."""
    drawn = start
    if held:
        start = start.spread("cut", _HELD)
    single = learner.state, fits, learner.ledger
    for _ in watch(range(_ROUNDS), "all of them together"):
        learner.about()
        before, deviation = learner.state.mean.copy(), learner.state.deviation
        fits, enough = _settled(learner, fits)
        ledger, parts, touches = Ledger(learner.operator.pitch), [], []
        for fit in fits:
            contacts = fit.unknowns.contacts
            if len(contacts) and left_over(fit) < max(DOUBTFUL, enough):
                parts.append(learner.weighed(fit, ledger))
                ledger.add(contacts)
                touches.append(ledger.which(contacts))
        learner.again(start, parts, before)
        learner.ledger = ledger
        if (np.abs(learner.state.mean - before) < _SETTLED * deviation).all():
            break
    if sum(map(_is_good, fits)) < sum(map(_is_good, single[1])) / 2:  # they do not fit together
        state, fits, learner.ledger = single
        learner.set(state)
        return fits, None
    kept_out = learner.judged(start, parts, touches, before)
    if held:
        told = forgotten(learner.state, drawn, _CUT)
        learner.set(replace(told, left_out=_CUT))
    return fits, kept_out


def _settled(learner, fits):
    """Fits with the sensor held, looked for anew where others explain far more; and chi-squared a
    reading that tells these."""
    settled = [learner.settle(fit.unknowns, fit.rows) for fit in fits]
    enough = max(EXPLAINED, _ODD * float(np.median([left_over(fit) for fit in settled])))
    after = []
    for now in settled:
        if left_over(now) > enough:
            again = learner.settle(learner.look(now.rows, enough).unknowns, now.rows)
            now = again if again.chi_squared < now.chi_squared else now
        after.append(now)
    return after, enough


def _is_good(fit: Fit) -> bool:
    return len(fit.unknowns.contacts) > 0 and left_over(fit) < DOUBTFUL

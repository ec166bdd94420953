"""What was learned, in words and numbers: what is off by how much, and what could not be
determined."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tomotactile_ros.estimation import tears
from tomotactile_ros.estimation.channels import SENSOR
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.rim import SIDES
from tomotactile_ros.learning.kept_out import LEAST
from tomotactile_ros.learning.recorded import MOST, Learned
from tomotactile_ros.learning.state import PARTS, SensorState
from tomotactile_ros.support.checks import plain

_TOLD = 0.01  # of what was expected: less is nothing
FOUND = 0.5  # of what was expected: a deviation above it means that little was learned
_NAMED = 3  # electrodes that are named
# of an electrode's own impedance: finite elements and closed form differ by as much, and as much does
# a radius that is 2 % off make
_LASTING = 5e-3
_DIRECT = 0.5  # of the least deviation that touches alone can leave of a resistance
_OUT = 3.0  # deviations of a channel from the others, beside which it is named


def anisotropy(state: SensorState, operator: SheetOperator) -> tuple[float, float, float]:
    """Ratio of the conductance along to that across, the direction (degrees from x), and the
    ratio's deviation."""
    where = slice(operator.field.count, operator.of_cut.start)
    p, q = state.mean[where]
    size = float(np.hypot(p, q))
    way = np.array([p, q]) / size if size > 1e-9 else np.array([1.0, 0.0])
    deviation = float(np.sqrt(way @ state.covariance[where, where] @ way))
    ratio = float(np.exp(2 * size))
    return ratio, float(np.degrees(np.arctan2(q, p)) / 2 % 180), 2 * ratio * deviation


def relative_gain_deviation(state: SensorState) -> float:
    """Deviation of a gain against the mean of all, rms."""
    where = state.slice("gain")
    block = state.covariance[where, where]
    apart = np.eye(len(block)) - 1 / len(block)
    return float(np.sqrt(np.trace(apart @ block @ apart) / len(block)))


def unevenness(state: SensorState, operator: SheetOperator) -> float:
    """Standard deviation of the logarithm of the sheet's conductance as its modes show it; what was
    expected where nothing is known."""
    modes = slice(0, operator.field.count)
    return float(np.sqrt((state.mean[modes] ** 2 + state.deviation[modes] ** 2).mean()))


def field(state: SensorState, operator: SheetOperator) -> tuple[np.ndarray, np.ndarray]:
    """(C,) logarithm of the sheet's conductance in its cells, 0 in the mean, and its deviation.

    That of the modes, and what they do not show of a sheet that is as uneven as this one.
    """
    modes = operator.field.modes
    count = modes.shape[1]
    left = unevenness(state, operator) * operator.field.left
    return modes @ state.mean[:count], np.hypot(state.std_across(modes), left)


def resistance(state: SensorState) -> np.ndarray:
    """(E,) ohm, most likely resistances between electrode and ground, which are not negative.

    `state` has those that explain readings best, with what the model's electrodes err in them: finite
    elements take 30 to 140 ohm off those of 8 x 8 electrodes, and all on an ideal sensor are below 0.
    """
    return np.maximum(state["resistance"], 0.0)


def resistance_deviation(state: SensorState, operator: SheetOperator) -> np.ndarray:
    """(E,) ohm, deviation of the resistances to ground from what lies between electrode and ground.

    The covariance is that of the resistances that explain readings best with the model's electrodes.
    What these err is the same in all touches, and no touch tells it; nor what the sheet beside an
    electrode is off beyond its modes. Not so where the grounded electrode itself was read: then
    resistances are known better than touches alone can tell.
    """
    deviation, used = state.std("resistance").copy(), operator.used
    told = deviation[used] < _DIRECT * operator.inexact / np.sqrt(max(state.frames, 1))
    at = operator.field.cell_of(operator.layout.positions[used])
    model = (
        np.hypot(_LASTING, unevenness(state, operator) * operator.field.left[at])
        * operator.own_impedance
    )
    learned = state.known("resistance")[used] > 0
    deviation[used] = np.hypot(deviation[used], np.where(learned & ~told, model, 0.0))
    return np.minimum(deviation, state.expected[state.slice("resistance")])


def of_channels(
    state: SensorState, operator: SheetOperator, part: str
) -> tuple[np.ndarray, np.ndarray]:
    """(E,) numbers and (E,) standard deviations of a part of the channels (`gain`, `resistance`), for
    people."""
    if part == "resistance":
        return resistance(state), resistance_deviation(state, operator)
    return state[part], state.std(part)


def made(
    state: SensorState, operator: SheetOperator
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[float, float]]:
    """How far out each of `SIDES` lies and its deviation, (4,) m; radius of the electrodes and its, m."""
    out, spread = (each[operator.of_rim][: len(SIDES)] for each in (state.mean, state.deviation))
    radius = operator.layout.radius * float(np.exp(state["sheet"][-1]))
    return (out, spread), (radius, radius * float(state.std("sheet")[-1]))


def evidence(state: SensorState, operator: SheetOperator) -> dict[str, float]:
    """Of each kind of unknowns by how much the logarithm of the evidence is larger with it, see
    `SensorState.evidence`."""
    before = SensorState.unknown(operator)
    sheet, *kinds = PARTS
    return {
        name: state.evidence([kinds[k] for k in which] or [sheet], before)
        for name, which in SENSOR.items()
    }


def lines(learned: Learned) -> Iterator[str]:
    """The whole report."""
    state = learned.state
    yield _counted(state, learned.untouched)
    if learned.alike:
        yield f"  {count(learned.alike, 'frame')} like others, which add nothing"
    if learned.exchanged:
        first, second = learned.exchanged.pair
        yield (
            f"  the wires of electrodes {first} and {second} are swapped: touches fit only with them "
            "exchanged; put them right and record again"
        )
    if learned.unexplained:
        yield f"  {count(learned.unexplained, 'frame')} that no contacts explain: not learned from"
    if learned.unread:
        yield f"  {count(learned.unread, 'frame')} without readings"
    if learned.constant:
        yield (
            f"  {count(learned.constant, 'frame')} that read the same whichever electrode is grounded, and far "
            "more than offsets: not learned from; is anything grounded, is the converter's range wide enough?"
        )
    if learned.moved:
        yield (
            f"  {count(learned.moved, 'frame')} in which something moved while rows were read, or which are no "
            "readings of a sheet: not learned from; hold each touch still for a frame"
        )
    for electrode, fault in sorted(learned.faults.items()):
        yield f"  electrode {electrode}: {fault}; nothing of its channel can be learned"
    if learned.kept_out is not None:
        yield from _kept_out(learned.kept_out)
    if learned.settling is not None:
        part = learned.settling.part.mean()
        yield (
            f"settling: readings keep {100 * part:.1f} % of the row before, which is subtracted; a longer pause between "
            "switching and reading would be better"
        )
    if learned.asymmetry == np.inf:
        yield "reciprocity: no gains explain these readings"
    elif learned.asymmetry is not None:
        yield f"reciprocity: {learned.asymmetry:.2f} times what noise explains, with the gains found"
    good = np.setdiff1d(np.arange(state.electrodes), list(learned.faults))
    yield from _parts(state, learned.operator, good)
    yield from _undetermined(learned, good)
    if not state.touches:
        yield "nothing but offsets was learned: no frame shows a touch that rests"
    elif state.touches < LEAST:
        but = f" ({' and '.join(state.left_out)}: as in the layout)" if state.left_out else ""
        yield (
            f"{count(state.touches, 'touch', 'es')}: too few to tell whether what was learned predicts others"
            f"{but}; {LEAST} to {MOST} in different places are wanted"
        )


def _kept_out(found):
    yield (
        f"touches predicted from the others: readings are off by {found.found:.1f} times their noise (expected: "
        f"{found.predicted:.1f}); without what was learned, by {plain(found.layout, 2)} times"
    )
    if found.left_out:
        yield (
            f"  not kept, as other touches are predicted better without: {', '.join(found.left_out)}; what is "
            "wrong with this sensor is something else"
        )


def of_state(state: SensorState, operator: SheetOperator, good: np.ndarray) -> Iterator[str]:
    """What is known of a sensor, whose electrodes `good` were read."""
    yield _counted(state, state.idle)
    yield from _parts(state, operator, good)


def _counted(state, untouched):
    return (
        f"learned from {count(state.touches, 'distinct touch', 'es')} in {count(state.frames, 'frame')} "
        f"and {count(untouched, 'untouched frame')}"
    )


def _parts(state, operator, good):
    if _is_told(state, "gain", good):
        yield from _gains(state, good)
    if _is_told(state, "offset", good):
        yield from _offsets(state, good)
    if state.touches:
        yield from tears.lines(state.tears)
        yield from _resistances(state, operator, good)
        yield from _places(state, good)
        yield from _sheet(state, operator)
        yield _outline(state, operator)
        yield _radius(state, operator)


def _is_told(state, part, good):
    """Whether anything was learned about a part, beyond what was expected before."""
    return bool(state.known(part)[good].max(initial=0.0) > _TOLD)


def _gains(state, good):
    gain, spread = state["gain"][good], relative_gain_deviation(state)
    apart = gain / gain.mean() - 1
    yield (
        f"gains: {_percent(apart.std())} rms from their mean, each known to {_percent(spread)}"
        + _extremes(apart, good, _percent)
    )
    common = float(np.sqrt(_block(state, "gain")[np.ix_(good, good)].mean()))
    yield f"  all of them {_signed(gain.mean() - 1)} (known to {_percent(common)})"


def _offsets(state, good):
    offset = 1e3 * state["offset"][good]
    known = 1e3 * float(np.sqrt((state.std("offset")[good] ** 2).mean()))
    yield (
        f"offsets: {np.sqrt((offset**2).mean()):.2f} mV rms, each known to {known:.2f} mV"
        + _extremes(offset, good, lambda v: f"{v:.1f} mV")
    )


def _resistances(state, operator, good):
    values, deviation = (each[good] for each in of_channels(state, operator, "resistance"))
    most = int(np.abs(values).argmax())
    yield (
        f"resistance to ground: {values.mean():.0f} ohm in the mean, {values.min():.0f} to "
        f"{values.max():.0f}, known to {deviation.min():.0f} to {deviation.max():.0f} ohm, best inside, worst in "
        f"corners; most: electrode {good[most]} {values[most]:.0f} ohm"
    )


def _places(state, good):
    ways = 1e3 * np.array([state[part][good] for part in ("aside_x", "aside_y")])
    spread = np.array([state.std(part)[good] for part in ("aside_x", "aside_y")])
    known = 1e3 * float(np.sqrt((spread**2).mean()))
    far = np.hypot(*ways)
    yield (
        f"electrodes: {np.sqrt((ways**2).mean()):.2f} mm rms from their places in the layout, in x and in y, each known to "
        f"{known:.2f} mm; most: electrode {good[far.argmax()]} {far.max():.2f} mm"
    )


def _sheet(state, operator):
    values, deviation = field(state, operator)
    low, high = int(values.argmin()), int(values.argmax())
    places = 1e3 * operator.field.centres
    yield (
        f"sheet: uneven by {_percent(values.std())} rms, known to {_percent(np.sqrt((deviation**2).mean()))}; "
        f"conductance {_signed(np.expm1(values[low]))} at {_place(places[low])}, "
        f"{_signed(np.expm1(values[high]))} at {_place(places[high])}"
    )
    ratio, direction, spread = anisotropy(state, operator)
    if ratio - 1 > 2 * spread:
        yield (
            f"  {ratio:.3f} : 1 (+- {spread:.3f}) more conductive along {direction:.0f} degrees "
            "from x than across"
        )
    else:
        yield f"  no anisotropy above {1 + 2 * spread:.3f} : 1"


def _outline(state, operator):
    """How far out the sides of the sheet are, of what surrounds its outline."""
    out, spread = (1e3 * each for each in made(state, operator)[0])
    sides = ", ".join(f"{side} {by:+.1f}" for side, by in zip(SIDES, out))
    return (
        f"outline: sides are farther out than in the layout by {sides} mm, each known to "
        f"{np.sqrt((spread**2).mean()):.1f} mm"
    )


def _radius(state, operator):
    found, spread = made(state, operator)[1]
    return (
        f"electrodes' radius: {1e3 * found:.2f} mm in the mean, known to {1e3 * spread:.2f} mm; "
        f"{1e3 * operator.layout.radius:.2f} mm in the layout"
    )


def _undetermined(learned, good):
    """What stays as it was expected, and why."""
    state = learned.state
    yield "not determined:"
    yield (
        "  the common factor of all conductances (sheet resistance, contact law): touches of unknown force do not "
        "show it; one press of known force does (calibrate)"
    )
    if not state.touches:
        told = [part for part in ("gain", "offset") if _is_told(state, part, good)]
        but = f"all but {' and '.join(f'{part}s' for part in told)}" if told else "anything"
        yield f"  {but}: no frame holds a touch that contacts explain"
        if learned.ended:
            yield (
                f"  offset of {_electrodes(learned.ended, state.electrodes)}: only 0 V was read, the end of the "
                "converter's range"
                + ("; is it connected?" if len(learned.ended) == len(good) else "")
            )
        return
    reasons = {
        "gain": "too few touches",
        "offset": "no untouched frames, or the converter ends at 0 V",
        "resistance": "too few touches near them",
    }
    for part, reason in reasons.items():
        open_ones = good[state.known(part)[good] < FOUND]
        _, known = of_channels(state, learned.operator, part)
        if len(open_ones):
            yield (
                f"  {part} of {_electrodes(open_ones, state.electrodes)}: {reason}; stays at what is expected, "
                + f"+- {_value(part, known[open_ones].max())}"
            )
    _, uncertain = field(state, learned.operator)
    expected = (
        np.sqrt((learned.operator.field.modes**2).sum(axis=1)) * learned.operator.deviation[0]
    )
    unknown = float((uncertain > FOUND * expected).mean())
    if unknown > 0.01:
        yield f"  the sheet's evenness over {unknown:.0%} of its area: no touches near enough"
    if learned.clipped > 1e-3:
        yield f"  {learned.clipped:.1%} of the readings are at an end of the converter's range: left out"


def _block(state, part):
    where = state.slice(part)
    return state.covariance[where, where]


def _extremes(values, good, show):
    scale = 1.4826 * np.median(np.abs(values - np.median(values)))
    order = np.argsort(-np.abs(values))[:_NAMED]
    named = [i for i in order if abs(values[i]) > _OUT * scale] or order[:1]
    parts = [
        f"electrode {good[i]} {'+' if values[i] > 0 else '-'}{show(abs(values[i]))}" for i in named
    ]
    return f"; most: {', '.join(parts)}"


def _electrodes(numbers, count):
    if len(numbers) == count:
        return "all electrodes"
    if len(numbers) > 8:
        return f"{len(numbers)} electrodes"
    return f"electrode{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def _value(part, value):
    return {
        "gain": f"{plain(100 * value, 2)} %",
        "offset": f"{plain(1e3 * value, 2)} mV",
        "resistance": f"{value:.0f} ohm",
    }[part]


def _percent(part):
    return f"{plain(100 * part, 2)} %"


def _signed(part):
    return f"{100 * part:+.2g} %"


def _place(place):
    return f"({place[0]:+.0f}, {place[1]:+.0f}) mm"


def count(number: int, word: str, many: str = "s") -> str:
    """As people say it: 1 touch, 2 touches."""
    return f"{number} {word}{'' if number == 1 else many}"

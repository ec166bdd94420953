"""Damage to a sensor that was learned when it was whole: what the health names, where, and after
how many touches; and how often it names anything on a sensor that is healthy and under load.

The sensor has gains off by 5 %, offsets of 5 mV and 50 to 450 ohm to ground; frames come from the
simulator's finite elements. Every touch rests for two frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from tomotactile_ros.bench.cases import find_layout
from tomotactile_ros.bench.learned import BOTH
from tomotactile_ros.bench.reference_cases import textbook_states
from tomotactile_ros.bench.sensor.readings import Wiring, readings, untouched
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.learning.live import LiveLearner
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import SheetField, Tear
from tomotactile_ros.simulation import Simulator

LEARNED, AFTER = 30, 20  # touches before and after the damage begins
EVERY = 3.0  # s from touch to touch
_LAYOUT = "equal-8x8"
_ELECTRODE, _OTHER = 27, 36
_OHM = 1000.0
_WALK = 0.02  # of the gain, a minute
_TEAR = 0.02  # m
_DRIER = 1.25  # times the resistance of the sheet
_IDLE = 20  # untouched frames at first
_SEED = 5
_LOADS = 120  # different touches of the long healthy run
_HARDER = 1.0, 3.0, 10.0  # times the pressure of a touch, in turn


@dataclass(frozen=True)
class Damage:
    """What breaks: ohm, sheet and drier hold for all touches after it began; gain (touch) is the
    factor of `_ELECTRODE` by then. `named` is how findings of it begin."""

    name: str
    named: tuple[str, ...]
    ohm: float = 0.0
    sheet: SheetField | None = None
    drier: float = 1.0
    gain: Callable[[int], float] = lambda touch: 1.0
    swapped: tuple[tuple[int, int], ...] = ()


def damages() -> list[Damage]:
    """All kinds of damage; a tear between two columns of electrodes, amid the sheet."""
    x, y = find_layout(_LAYOUT).positions[[_ELECTRODE, _ELECTRODE + 1]].mean(axis=0)
    tear = Tear(((x, y - _TEAR / 2), (x, y + _TEAR / 2)), 0.001)
    return [
        Damage("a tear of 20 mm between electrodes", ("tear",), sheet=SheetField(tears=(tear,))),
        Damage("a wire of 1 kohm", (f"wire {_ELECTRODE}",), ohm=_OHM),
        Damage(
            "a gain that walks by 2 % a minute",
            (f"gain {_ELECTRODE}",),
            gain=lambda touch: 1.0 + _WALK * EVERY * (touch + 1) / 60.0,
        ),
        Damage(
            "two wires swapped",
            (f"swapped {_ELECTRODE}",),
            swapped=((_ELECTRODE, _OTHER),),
        ),
        Damage("a sheet that dries by 25 %", ("whole",), drier=_DRIER),
        Damage("nothing", ()),
    ]


def measure(which: list[Damage] | None = None) -> Iterator[dict]:
    """A row of plain data for each damage: when it was named first, in touches, and all that is
    named at the end."""
    learner, whole = _LiveLearner(), _frames(LEARNED + AFTER, Damage("nothing", ()))
    for number in range(_IDLE):
        learner.offer(readings(untouched(len(whole[0])), Wiring(BOTH), (number, 9)), 0.0)
    for touch in range(LEARNED):
        learner.touch(whole[touch], Wiring(BOTH), touch)
    for damage in damages() if which is None else which:
        other, first = learner.copy(), None
        frames = _frames(LEARNED + AFTER, damage)
        for touch in range(AFTER):
            gain = BOTH.of(len(whole[0])).gain.copy()
            gain[_ELECTRODE] *= damage.gain(touch)
            wiring = Wiring(replace(BOTH, gain=tuple(gain)))
            other.touch(frames[LEARNED + touch], wiring, LEARNED + touch)
            names = [each.name for each in other.live.health.findings]
            if (
                first is None
                and damage.named
                and any(name.startswith(damage.named) for name in names)
            ):
                first = touch + 1
        yield {
            "damage": damage.name,
            "first": first,
            "found": [(each.text, each.sure) for each in other.live.health.findings],
        }


def healthy(frames: int) -> dict:
    """So many frames of a healthy sensor under load: findings that were there at any time, and the
    time that a frame takes while nothing new is learned."""
    pressed = [
        each
        for harder in _HARDER
        for each in _frames(_LOADS // len(_HARDER), Damage("nothing", ()), harder)
    ]
    learner, random, alarms = _LiveLearner(), np.random.default_rng(_SEED), set()
    count = touches = 0
    seconds = []
    while count < frames:
        chosen = pressed[random.integers(len(pressed))]
        for rests in range(int(random.integers(2, 60))):
            idle = rests == 0
            frame = readings(untouched(len(chosen)) if idle else chosen, Wiring(BOTH), (count, 7))
            seconds.append(learner.offer(frame, count / 15.6))
            count += 1
        touches += 1
        alarms |= {each.name for each in learner.live.health.findings}
    state = learner.live.state
    return {
        "frames": count,
        "touches": touches,
        "learned": state.frames,
        "unexplained": learner.live.unexplained,
        "alarms": sorted(alarms),
        "milliseconds": 1e3 * float(np.median(seconds)),
        "worst": 1e3 * float(np.quantile(seconds, 0.999)),
    }


class _LiveLearner:
    """`LiveLearner` that is fed with what the sensor reads."""

    def __init__(self, state=None):
        self._layout = find_layout(_LAYOUT)
        self.live = LiveLearner(self._layout, noise=NOISE, state=state)
        self._grounded = np.arange(self._layout.electrodes)

    def copy(self) -> _LiveLearner:
        """One that knows the same."""
        return _LiveLearner(self.live.state)

    def touch(self, pressed: np.ndarray, wiring: Wiring, number: int) -> None:
        """Two frames of one touch."""
        for part in range(2):
            self.offer(readings(pressed, wiring, (number, part)), number * EVERY + part * 0.064)

    def offer(self, frame: np.ndarray, time: float) -> float:
        """One frame; the processor's seconds until the node may go on."""
        start = process_time()
        kept = self.live.offer(frame, self._grounded, DRIVE, 1000.0 + time)
        seconds = process_time() - start
        if kept:
            self.live.work()
        return seconds


def _frames(count: int, damage: Damage, harder: float = 1.0) -> list[np.ndarray]:
    """(E, E) V of `count` touches before gains, offsets and noise."""
    layout = find_layout(_LAYOUT)
    numbers = BOTH.of(layout.electrodes)
    ohm = np.array(numbers.ground_resistance)
    ohm[_ELECTRODE] += damage.ohm
    contacts = [
        Contact(
            "disc", center=press.shape.center, radius=press.shape.semi_axes[0],
            pressure=press.pressure * harder, start=float(i), end=i + 0.5,
        )
        for i, state in enumerate(textbook_states(layout, np.random.default_rng(_SEED), count))
        for press in state.contacts[:1]
    ]  # fmt: skip
    dried = replace(layout, sheet_resistance=layout.sheet_resistance * damage.drier)
    defects = Defects(channels=replace(BOTH, gain=None, offset=None, ground_resistance=tuple(ohm)))
    if damage.sheet is not None:
        defects = replace(defects, sheet=damage.sheet)
    simulator = Simulator(
        dried, Scene(damage.name, DRIVE, contacts, LAW, defects=defects), row_period=0.0
    )
    found = [simulator.ideal_frame(i + 0.25) for i in range(count)]
    for pair in map(list, damage.swapped):
        for frame in found:
            frame[pair] = frame[pair[::-1]]
            frame[:, pair] = frame[:, pair[::-1]]
    return found

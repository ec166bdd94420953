"""The parts: what is wrong with the sensor, one thing at a time, and the frames that show it.

time      a touch that begins or ends while rows are scanned, alone and beside another one; touches that
          move, judged by where they are in the middle of the frame
channels  gains, offsets, resistances to ground, open wires, stuck channels, swapped wires
sheets    uneven, graded and anisotropic ones; and everything at once
layouts   without a full grid
crowd     3 to 6 contacts, the strongest with ten times the force of the weakest

All but moving touches come from the reference model (`states`); these from the simulator's finite
elements, row by row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from tomotactile_ros.bench.sensor import odd_layouts, states
from tomotactile_ros.bench.sensor.motion import moving
from tomotactile_ros.bench.sensor.readings import Wiring, potentials, readings, untouched
from tomotactile_ros.bench.sensor.trial import Trial, presses
from tomotactile_ros.channels import Channels, Rms, Uniform
from tomotactile_ros.evaluation.scoring import PART
from tomotactile_ros.simulation import ROW_PERIOD

SPEEDS = 0.2, 0.5, 1.0  # m/s
_MOVES = 12  # of each speed
_ONE, _OTHER = 18, 45  # electrodes that something is wrong with
_SEED = 1

WIRINGS = {
    "textbook": Wiring(),
    "gains 1 %": Wiring(Channels(gain=Rms(0.01, _SEED))),
    "gains 2 %": Wiring(Channels(gain=Rms(0.02, _SEED))),
    "gains 5 %": Wiring(Channels(gain=Rms(0.05, _SEED))),
    "offsets 5 mV": Wiring(Channels(offset=Rms(0.005, _SEED))),
    "150-450 ohm to ground": Wiring(Channels(ground_resistance=Uniform(300, 150, _SEED))),
    "two open wires": Wiring(Channels(open=(_ONE, _OTHER), stuck={_ONE: 0.0, _OTHER: 0.0})),
    "two stuck channels": Wiring(Channels(stuck={_ONE: 1.1, _OTHER: 2.2})),
    "two swapped wires": Wiring(swapped=((_ONE, _ONE + 1),)),
}
WORN = Wiring(
    Channels(
        gain=Rms(0.02, _SEED),
        offset=Rms(0.002, _SEED),
        ground_resistance=Uniform(150, 75, _SEED),
    )
)
SHEETS = "field 10 %", "field 20 %", "gradient 20 %", "anisotropy 1.5:1"
LAYOUTS = {
    "four electrodes amid 8 x 8 missing": "void",
    "ring of 16 on a circle": "ring",
    "40 random places": "random",
    "L-shape": "ell",
}


def time(step: int = 1) -> Iterator[Trial]:
    """Every `step`-th touch, as in the other parts."""
    alone = states.load("even").part(step)
    beside = states.load("beside")
    count = len(beside.seen) // 2
    first = states.States(beside.layout, beside.seen[:count], beside.truths[:count]).part(step)
    both = states.States(beside.layout, beside.seen[count:], beside.truths[count:]).part(step)
    for end in (False, True):
        name = "release" if end else "onset"
        yield _changing(name, None, alone, end)
        yield _changing(f"{name} beside another", first, both, end)
    for speed in SPEEDS:
        yield moving(f"{speed:g} m/s", odd_layouts.grid(), speed, _MOVES // step)


def channels(step: int = 1) -> Iterator[Trial]:
    touched = states.load("even").part(step)
    for name, wiring in WIRINGS.items():
        yield presses(name, touched, wiring)


def sheets(step: int = 1) -> Iterator[Trial]:
    for name in SHEETS:
        yield presses(name, states.load(name).part(step))
    worn = states.load("worn").part(step)
    yield presses("field 20 %, 1.3:1, gains 2 %, 75-225 ohm, 2 mV", worn, WORN)


def layouts(step: int = 1) -> Iterator[Trial]:
    for name, kind in LAYOUTS.items():
        yield presses(name, states.load(kind).part(step))
    connector = Wiring(Channels(open=odd_layouts.CONNECTOR), dead=odd_layouts.CONNECTOR)
    even = states.load("even").part(step)
    yield presses("dead connector of 8 neighbours", even, connector)


def crowd(step: int = 1) -> Iterator[Trial]:
    every = states.load("crowd")
    for count in sorted({len(truth) for truth in every.truths}):
        chosen = [i for i, truth in enumerate(every.truths) if len(truth) == count][::step]
        part = states.States(
            every.layout, [every.seen[i] for i in chosen], [every.truths[i] for i in chosen]
        )
        yield presses(f"{count} contacts", part)


PARTS: dict[str, Callable[[int], Iterator[Trial]]] = {
    "time": time,
    "channels": channels,
    "sheets": sheets,
    "layouts": layouts,
    "crowd": crowd,
}


def _changing(case: str, without: states.States | None, touched: states.States, end: bool) -> Trial:
    """A touch that begins, or with `end` ends, at some row of the frame that is judged.

    `without` : the same without the touch that changes, nothing at all if None; that touch is the
    last one of `touched`. A frame before and one after the change are only processed.
    """
    random = np.random.default_rng(_SEED)
    frames, truths = [], []
    electrodes = touched.layout.electrodes
    for i, (seen, truth) in enumerate(zip(touched.seen, touched.truths, strict=True)):
        off = untouched(electrodes) if without is None else potentials(without.seen[i])
        on = potentials(seen)
        before, after = (on, off) if end else (off, on)
        late = np.arange(electrodes) >= random.integers(1, electrodes)
        within = np.where(late[:, None], after, before)
        for number, each in enumerate((before, within, after)):
            frames.append(readings(each, seed=(i, number)))
        truths += [None, [*truth[:-1], truth[-1] | {PART: True}], None]
    return Trial(case, touched.layout, np.array(frames), truths, ROW_PERIOD)

"""The parts: what is wrong with the sensor, one thing at a time, and the frames that show it.

time      touches that begin, end or move while rows are scanned (`changes`)
channels  gains, offsets, resistances to ground, readings that have not settled, open wires, stuck
          channels, swapped wires
sheets    random fields, gradients, anisotropy; and several things at once
layouts   without a full grid, and electrodes that are not where the layout says
crowd     3 to 6 contacts, the strongest with ten times the force of the weakest
wide      discs, plates, lines, rings and hands of 15 to 140 mm, and the whole sheet
wide-channels
          those of less than 100 mm on channels that something is wrong with
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tomotactile_ros.bench import reference_slides
from tomotactile_ros.bench.cases import DEFAULT_LAYOUT
from tomotactile_ros.bench.sensor import changes
from tomotactile_ros.bench.sensor.readings import Wiring
from tomotactile_ros.bench.sensor.states import cases, states
from tomotactile_ros.bench.sensor.trial import Methods, Trial, presses, profiles
from tomotactile_ros.bench.sensor.trial import measure as judged
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform

CONNECTOR = tuple(range(24, 32))  # eight neighbours, the fourth row of 8 x 8
_COUNT = 24  # presses of a case
_TEXTBOOK, _SHEETS, _CROWD = "textbook-8x8", "sheets-8x8", "crowd-8x8"
_BESIDE, _WIDE = "beside-8x8", "wide-8x8"
# of part `wide-channels`: what is wrong, cases left out, and of the others every so many presses
_WRONG = "gains 2 %", "gains 5 %", "offsets 5 mV", "150 to 450 ohm to ground", "two stuck channels"
_LARGE, _FEWER = ("whole sheet", "plate of 1"), 3
_ONE, _OTHER = 18, 45  # electrodes that something is wrong with
_SEED = 1

WIRINGS = {
    "textbook": Wiring(),
    "gains 1 %": Wiring(Channels(gain=Rms(0.01, _SEED))),
    "gains 2 %": Wiring(Channels(gain=Rms(0.02, _SEED))),
    "gains 5 %": Wiring(Channels(gain=Rms(0.05, _SEED))),
    "offsets 5 mV": Wiring(Channels(offset=Rms(0.005, _SEED))),
    "150 to 450 ohm to ground": Wiring(Channels(ground_resistance=Uniform(300, 150, _SEED))),
    "0.5 % of the row before": Wiring(Channels(settling=0.005)),
    "two open wires": Wiring(Channels(open=(_ONE, _OTHER), stuck={_ONE: 0.0, _OTHER: 0.0})),
    "two stuck channels": Wiring(Channels(stuck={_ONE: 1.1, _OTHER: 2.2})),
    "two swapped wires": Wiring(swapped=((_ONE, _ONE + 1),)),
}
SHEETS = {
    "random field 10 %": "random 10%",
    "random field 20 %": "random 20%",
    "gradient 20 %": "gradient 20%",
    "anisotropy 1.5 : 1": "anisotropy 1.5",
}
WORN = Wiring(
    Channels(
        gain=Rms(0.02, _SEED),
        offset=Rms(0.002, _SEED),
        ground_resistance=Uniform(150, 75, _SEED),
    )
)
LAYOUTS = {
    "four electrodes amid 8 x 8 missing": "layout-void-60",
    "ring of 16 on a circle": "layout-rim-16",
    "40 random places": "layout-random-40",
    "L-shape": "layout-l-shape-48",
}


ASIDE = 3e-4, 1e-3  # m: glued with a template, and by eye


def time(step: int = 1) -> Iterator[Trial]:
    """Every `step`-th press, as in the other parts."""
    alone = states(_TEXTBOOK, most=_COUNT).every(step)
    one, two = (states(_BESIDE, case).every(step) for case in ("one", "two"))
    for name, end in (("onset", False), ("release", True)):
        yield changes.alone(name, alone, end)
        yield changes.beside(f"{name} beside another", one, two, end)
    slides = reference_slides.load(DEFAULT_LAYOUT)
    for speed in slides.speeds:
        yield changes.sliding(f"{speed:g} m/s", slides, speed, step)


def channels(step: int = 1) -> Iterator[Trial]:
    pressed = states(_TEXTBOOK, most=_COUNT).every(step)
    for name, wiring in WIRINGS.items():
        yield presses(name, pressed, wiring)


def sheets(step: int = 1) -> Iterator[Trial]:
    for name, case in SHEETS.items():
        yield presses(name, states(_SHEETS, case).every(step))
    worn = states(_SHEETS, "random 20%").every(step)
    yield presses("20 %, gains 2 %, 75 to 225 ohm, 2 mV", worn, WORN)


def layouts(step: int = 1) -> Iterator[Trial]:
    for name, family in LAYOUTS.items():
        yield presses(name, states(family).every(step))
    connector = Wiring(Channels(open=CONNECTOR), dead=CONNECTOR)
    pressed = states(_TEXTBOOK, most=_COUNT).every(step)
    yield presses("dead connector of 8 neighbours", pressed, connector)
    for aside in ASIDE:
        name = f"electrodes {1e3 * aside:g} mm beside the layout"
        yield replace(presses(name, pressed), layout=misplaced(pressed.layout, aside))


def misplaced(layout: Layout, aside: float) -> Layout:
    """The layout with electrodes `aside` m, rms in x and in y, from where it has them, but on the
    sheet."""
    half = np.array(layout.outline.size) / 2
    moved = layout.positions + aside * np.random.default_rng(_SEED).standard_normal(
        (len(layout.positions), 2)
    )
    name = f"{layout.name}, {1e3 * aside:g} mm aside"
    return replace(layout, name=name, positions=np.clip(moved, -half, half))


def crowd(step: int = 1) -> Iterator[Trial]:
    for count in (3, 4, 5, 6):
        yield presses(f"{count} contacts", states(_CROWD, f"{count} contacts").every(step))


def wide(step: int = 1) -> Iterator[Trial]:
    for case in cases(_WIDE):
        yield presses(case, states(_WIDE, case).every(step))


def wide_channels(step: int = 1) -> Iterator[Trial]:
    for name in _WRONG:
        for case in cases(_WIDE):
            if case.startswith(_LARGE):
                continue
            pressed = states(_WIDE, case).every(_FEWER * step)
            yield presses(f"{case}, {name}", pressed, WIRINGS[name])


PARTS: dict[str, Callable[[int], Iterator[Trial]]] = {
    "time": time,
    "channels": channels,
    "sheets": sheets,
    "layouts": layouts,
    "crowd": crowd,
    "wide": wide,
    "wide-channels": wide_channels,
}
# the parts that take longest, some seconds a frame: only where they are asked for by their names
ON_DEMAND = frozenset({"wide", "wide-channels"})


def measure(part: str, step: int = 1, methods: Sequence[Methods] = (profiles,)) -> list[dict]:
    """Rows of one of `PARTS` as plain data, of every `step`-th press; `methods` make reconstructions of
    a layout by their names, see `trial`."""

    def every(layout: Layout) -> dict:
        return {name: each for make in methods for name, each in make(layout).items()}

    return list(judged(PARTS[part](step), every))

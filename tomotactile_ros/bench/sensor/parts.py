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
from functools import partial
from itertools import product

import numpy as np

from tomotactile_ros.bench import reference_slides
from tomotactile_ros.bench.cases import DEFAULT_LAYOUT
from tomotactile_ros.bench.sensor import changes
from tomotactile_ros.bench.sensor.readings import IDEAL, Wiring
from tomotactile_ros.bench.sensor.states import cases, states
from tomotactile_ros.bench.sensor.trial import Methods, Trial, presses, profiles
from tomotactile_ros.bench.sensor.trial import measure as judged
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform

CONNECTOR = tuple(range(24, 32))  # eight neighbours, the fourth row of 8 x 8
ASIDE = 3e-4, 1e-3  # m: glued with a template, and by eye
_SEED = 1
_ONE, _OTHER = 18, 45  # electrodes that something is wrong with

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
WORN = Wiring(Channels(Rms(0.02, _SEED), Rms(0.002, _SEED), Uniform(150, 75, _SEED)))
_TEXTBOOK, _WIDE = ("textbook-8x8", None, 24), "wide-8x8"  # family, case, most
_SHEET = "sheets-8x8"
# presses by part: words, what `states` is asked for, wiring
PRESSES: dict[str, list[tuple]] = {
    "channels": [(words, _TEXTBOOK, wiring) for words, wiring in WIRINGS.items()],
    "sheets": [
        ("random field 10 %", (_SHEET, "random 10%"), IDEAL),
        ("random field 20 %", (_SHEET, "random 20%"), IDEAL),
        ("gradient 20 %", (_SHEET, "gradient 20%"), IDEAL),
        ("anisotropy 1.5 : 1", (_SHEET, "anisotropy 1.5"), IDEAL),
        ("20 %, gains 2 %, 75 to 225 ohm, 2 mV", (_SHEET, "random 20%"), WORN),
    ],
    "layouts": [
        ("four electrodes amid 8 x 8 missing", ("layout-void-60",), IDEAL),
        ("ring of 16 on a circle", ("layout-rim-16",), IDEAL),
        ("40 random places", ("layout-random-40",), IDEAL),
        ("L-shape", ("layout-l-shape-48",), IDEAL),
        (
            "dead connector of 8 neighbours",
            _TEXTBOOK,
            Wiring(Channels(open=CONNECTOR), dead=CONNECTOR),
        ),
    ],
    "crowd": [(f"{n} contacts", ("crowd-8x8", f"{n} contacts"), IDEAL) for n in (3, 4, 5, 6)],
}
# of part `wide-channels`: what is wrong, cases left out, and of the others every so many presses
_WRONG = "gains 2 %", "gains 5 %", "offsets 5 mV", "150 to 450 ohm to ground", "two stuck channels"
_LARGE, _FEWER = ("whole sheet", "plate of 1"), 3


def time(step: int = 1) -> Iterator[Trial]:
    """Every `step`-th press, as in the other parts."""
    alone = states(*_TEXTBOOK).every(step)
    one, two = (states("beside-8x8", case).every(step) for case in ("one", "two"))
    for name, end in (("onset", False), ("release", True)):
        yield changes.changing(name, alone, end)
        yield changes.changing(f"{name} beside another", two, end, one)
    slides = reference_slides.load(DEFAULT_LAYOUT)
    for speed in slides.speeds:
        yield changes.sliding(f"{speed:g} m/s", slides, speed, step)


def pressed(part: str, step: int = 1) -> Iterator[Trial]:
    """One of `PRESSES`; of `layouts` also electrodes that are not where the layout says."""
    for words, asked, wiring in PRESSES[part]:
        yield presses(words, states(*asked).every(step), wiring)
    for aside in ASIDE if part == "layouts" else ():
        made = presses(
            f"electrodes {1e3 * aside:g} mm beside the layout", states(*_TEXTBOOK).every(step)
        )
        yield replace(made, layout=misplaced(made.layout, aside))


def misplaced(layout: Layout, aside: float) -> Layout:
    """The layout with electrodes `aside` m, rms in x and in y, from where it has them, but on the
    sheet."""
    half = np.array(layout.outline.size) / 2
    way = aside * np.random.default_rng(_SEED).standard_normal(layout.positions.shape)
    name = f"{layout.name}, {1e3 * aside:g} mm aside"
    return replace(layout, name=name, positions=np.clip(layout.positions + way, -half, half))


def wide(step: int = 1) -> Iterator[Trial]:
    for case in cases(_WIDE):
        yield presses(case, states(_WIDE, case).every(step))


def wide_channels(step: int = 1) -> Iterator[Trial]:
    small = [case for case in cases(_WIDE) if not case.startswith(_LARGE)]
    for name, case in product(_WRONG, small):
        wiring = WIRINGS[name]
        yield presses(f"{case}, {name}", states(_WIDE, case).every(_FEWER * step), wiring)


PARTS: dict[str, Callable[[int], Iterator[Trial]]] = {
    "time": time,
    **{part: partial(pressed, part) for part in PRESSES},
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

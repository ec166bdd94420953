"""How well a sensor is learned from touches of unknown place, size and force, and what that is
worth.

Each case is one sensor. Some of its touches are learned from, others judge: places, forces and
ghosts with what was learned, and gains, resistances and sheet against the truth and against the
learned covariance. Frames come from the reference model (`reference_data`) or from the simulator;
the estimator is neither. Forces are those after three presses of known force: touches of unknown
force leave one common factor open.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tomotactile_ros.bench import reference_data, tables
from tomotactile_ros.bench.cases import find_layout
from tomotactile_ros.bench.reference_cases import ring, textbook_states, truth, worn_sheets
from tomotactile_ros.bench.sensor.readings import Wiring, potentials, readings, untouched
from tomotactile_ros.bench.sensor.trial import Trial, judge
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning import findings
from tomotactile_ros.learning.recorded import Learned, learn
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.calibration import fit_contact_law
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import resistance_of
from tomotactile_ros.simulation import Simulator

JUDGED = 16  # touches
_PRESSES = 3  # of known force
_SEED = 1
GAINS = Channels(gain=Rms(0.05, _SEED), offset=Rms(0.005, _SEED))
OHMS = Channels(ground_resistance=Uniform(250, 200, _SEED))
BOTH = replace(GAINS, ground_resistance=OHMS.ground_resistance)
PROFILE = "accurate"
SOURCES = "reference", "simulator"


@dataclass(frozen=True)
class Case:
    """One sensor: layout, number of `worn_sheets` (None: even), what is wrong with its channels,
    touches learned from."""

    name: str
    touches: int
    sheet: int | None = None
    channels: Channels = field(default_factory=Channels)
    layout: str = "8x8"


CASES = (
    Case("gains 5 %, offsets 5 mV", 4, channels=GAINS),
    Case("gains 5 %, offsets 5 mV", 12, channels=GAINS),
    Case("uneven 20 %", 30, 0),
    Case("anisotropic 1.5 : 1", 30, 1),
    Case("50 to 450 ohm to ground", 20, channels=OHMS),
    Case("all together", 30, 2, BOTH),
    Case("all together, ring of 16", 60, 2, BOTH, "rim-16"),
    Case("all together, 4 x 4", 60, 2, BOTH, "4x4"),
)


@dataclass(frozen=True, eq=False)
class Touches:
    """Touches of a sensor: frames (N, L, E), V, of the potentials that they cause, and their
    truth."""

    layout: Layout
    potentials: list[np.ndarray]
    truths: list[list[dict]]


def of_reference(case: Case) -> Touches:
    """Touches of the reference data, the judging ones last."""
    if case.sheet is None:
        data = reference_data.load(f"textbook-{case.layout}")
        chosen = [*range(case.touches), *range(len(data) - JUDGED, len(data))]
    else:
        data = reference_data.load(f"learning-{case.layout}")
        numbers = data.cases()[worn_sheets()[case.sheet].words]
        chosen = [*numbers[: case.touches], *numbers[-JUDGED:]]
    wiring = Wiring(case.channels)
    found = [potentials(data.state(int(i)), wiring) for i in chosen]
    return Touches(data.layout, found, [data.states[int(i)]["contacts"] for i in chosen])


def of_simulator(case: Case) -> Touches:
    """Touches like those of the reference data, from the simulator's finite elements."""
    layout = ring() if case.layout == "rim-16" else find_layout(f"equal-{case.layout}")
    reach = 0.6 if case.layout == "rim-16" else 1.0
    random = np.random.default_rng([_SEED, case.touches])
    states = textbook_states(layout, random, case.touches + JUDGED, reach=reach)
    presses = [state.contacts[0] for state in states]
    contacts = [
        Contact(
            "disc", center=press.shape.center, radius=press.shape.semi_axes[0], pressure=press.pressure,
            start=float(i), end=i + 0.5,
        )
        for i, press in enumerate(presses)
    ]  # fmt: skip
    sheet = None if case.sheet is None else worn_sheets()[case.sheet]
    defects = Defects(channels=Channels(ground_resistance=case.channels.ground_resistance))
    if sheet is not None:
        defects = replace(defects, sheet=sheet.field, sheet_variation=sheet.variation)
    simulator = Simulator(
        layout, Scene(case.name, DRIVE, contacts, LAW, defects=defects), row_period=0.0
    )
    found = [simulator.ideal_frame(i + 0.25) for i in range(len(contacts))]
    return Touches(layout, found, [[truth(press, layout.outline)] for press in presses])


def measure(
    cases: Iterable[Case], source: str = "reference", before: bool = False
) -> Iterator[tuple[dict, Learned]]:
    """A row of plain data for each case, and what was learned; `before`: also judged without."""
    make: Callable[[Case], Touches] = {"reference": of_reference, "simulator": of_simulator}[source]
    for case in cases:
        touches = make(case)
        wiring = Wiring(case.channels)
        frames = [
            readings(each, wiring, (i, part))
            for i, touched in enumerate(touches.potentials[: case.touches])
            for part, each in enumerate((untouched(touches.layout.electrodes), touched))
        ]
        start = time.process_time()
        grounded = np.arange(touches.layout.electrodes)
        learned = learn(touches.layout, np.array(frames), grounded, DRIVE, noise=NOISE, course=True)
        row = {
            "case": case.name,
            "source": source,
            "touches": case.touches,
            "learning, s": time.process_time() - start,
            **compared(learned.state, learned, case, touches.layout),
            "course": [compared(state, learned, case, touches.layout) for state in learned.courses],
            "after": _judged(touches, wiring, case, learned.state),
            "before": _judged(touches, wiring, case, None) if before else None,
        }
        yield row, learned


def _judged(touches: Touches, wiring: Wiring, case: Case, sensor: SensorState | None) -> dict:
    frames, truths = [], []
    for i, (each, true) in enumerate(
        zip(touches.potentials[-JUDGED:], touches.truths[-JUDGED:]), case.touches
    ):
        frames += [
            readings(untouched(touches.layout.electrodes), wiring, (i, 0)),
            readings(each, wiring, (i, 1)),
        ]
        truths += [None, true]
    law = LAW if sensor is None else _calibrated(touches, wiring, case, sensor)
    pipeline = _pipeline(touches.layout, law, sensor)
    start = time.process_time()
    found = judge(pipeline, Trial(case.name, touches.layout, np.array(frames), truths))
    seconds = (time.process_time() - start) / len(frames)
    return {**found, "seconds": seconds, "law": law.coefficient / LAW.coefficient}


def _pipeline(layout, law, sensor):
    return Pipeline(layout, Settings(PROFILE, noise=NOISE, contact_law=law), sensor=sensor)


def _calibrated(touches, wiring, case, sensor) -> ContactLaw:
    """The contact law from `_PRESSES` of the touches learned from, as if their forces were known:
    those farthest from electrodes. Touches of unknown force leave one factor open."""
    pipeline, grounded = (
        _pipeline(touches.layout, LAW, sensor),
        np.arange(touches.layout.electrodes),
    )
    places = np.array([[truth[0]["x"], truth[0]["y"]] for truth in touches.truths])
    distance = touches.layout.nearest(places[: case.touches])[0]
    pressed = []
    for i in np.argsort(-distance)[:_PRESSES]:
        frame = readings(touches.potentials[i], wiring, (int(i), 1))
        found = pipeline.strengths(frame, grounded, DRIVE)
        if found:
            pressed.append((touches.truths[i][0]["force"], found[0].conductance, found[0].area))
    return fit_contact_law(*zip(*pressed), exponent=LAW.exponent).law if pressed else LAW


def compared(state: SensorState, learned: Learned, case: Case, layout: Layout) -> dict:
    """Errors of what was learned, rms, each beside what its covariance says of it."""
    numbers = case.channels.of(layout.electrodes)
    gain = np.ones(layout.electrodes) if numbers.gain is None else numbers.gain
    offset = np.zeros(layout.electrodes) if numbers.offset is None else numbers.offset
    ohms = numbers.ground_resistance
    ohms = np.zeros(layout.electrodes) if ohms is None else ohms
    ratio = state["gain"] / gain
    values, deviation = findings.field(state, learned.operator)
    true, ratio_true = _sheet(case, layout, learned.operator.field.centres)
    return {
        "gain": {
            "error": float((ratio / ratio.mean()).std()),
            "bound": findings.relative_gain_deviation(state),
        },
        "offset": _compared(state["offset"] - offset, state.std("offset")),
        "resistance": _compared(
            findings.resistance(state) - ohms,
            findings.resistance_deviation(state, learned.operator),
        ),
        "sheet": _compared(values - values.mean() - true, deviation),
        "ratio": {"found": findings.anisotropy(state)[0], "true": ratio_true},
    }


def _sheet(case, layout, places):
    """(C,) logarithm of the true conductance at `places`, 0 in the mean, and the ratio of
    anisotropy."""
    if case.sheet is None:
        return np.zeros(len(places)), 1.0
    sheet = worn_sheets()[case.sheet]
    resistance = resistance_of(layout, sheet.field, sheet.variation)
    true = np.zeros(len(places)) if resistance is None else -np.log(resistance(places))
    ratio = 1.0 if sheet.field.anisotropy is None else sheet.field.anisotropy.ratio
    return true - true.mean(), ratio


def _compared(error, deviation):
    return {
        "error": float(np.sqrt((error**2).mean())),
        "bound": float(np.sqrt((deviation**2).mean())),
    }


_HEADER = (
    "sensor", "frames of", "touches", "place mm: median", "p95", "force %: median", "p95", "factor",
    "ghosts", "missed", "withheld", "gains %", "bound", "to ground ohm", "bound", "sheet %", "bound", "ratio", "s a frame",
)  # fmt: skip


def _cells(row: dict, which: str = "after") -> tuple[str, ...]:
    judged = row[which]
    place, force = judged["place"], judged["force"]
    known = which == "after"
    return (
        row["case"],
        row["source"],
        str(row["touches"]) if known else "none",
        *(_scaled(place[key], 1e3, 2) for key in ("median", "p95")),
        *(_scaled(force[key], 100, 1) for key in ("median", "p95")),
        f"{judged['law']:.3f}",
        str(judged["ghosts"]),
        f"{judged['missed']} of {judged['true']}",
        str(judged["withheld"]),
        *(_pair(row["gain"], 100, 4) if known else ("", "")),
        *(_pair(row["resistance"], 1, 1) if known else ("", "")),
        *(_pair(row["sheet"], 100, 2) if known else ("", "")),
        f"{row['ratio']['found']:.3f}" if known else "",
        f"{judged['seconds']:.2f}",
    )


def _pair(each, unit, digits):
    return f"{unit * each['error']:.{digits}f}", f"{unit * each['bound']:.{digits}f}"


def _scaled(value, factor, digits):
    return "-" if value is None else f"{factor * value:.{digits}f}"


def text(rows: list[dict], markdown: bool = False) -> Iterator[str]:
    """The table."""
    cells = []
    for row in rows:
        cells.append(_cells(row))
        if row["before"] is not None:
            cells.append(_cells(row, "before"))
    yield from tables.markdown(_HEADER, cells) if markdown else tables.text(_HEADER, cells, fixed=2)


def save_plot(path, rows: list[dict]) -> None:
    """A PNG: errors against the number of touches, and what the covariance says of them."""
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from tomotactile_ros.support.files import save_figure

    parts = (
        ("gain", 100, "error of gains / %"),
        ("resistance", 1, "error of resistances to ground / Ω"),
        ("sheet", 100, "error of the sheet's conductance / %"),
    )
    colours = colormaps["tab20"]
    figure = Figure(figsize=(13, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (part, unit, label) in zip(figure.subplots(1, 3), parts):
        for number, row in enumerate(rows):
            course = row["course"]
            count = np.arange(1, len(course) + 1)
            colour = colours(number % 20)
            for key, style in (("error", "-"), ("bound", ":")):
                values = [unit * each[part][key] for each in course]
                axes.plot(count, values, style, color=colour, linewidth=1.2)
            name = (
                f"{row['case']}, {row['touches']} ({row['source']})"
                if axes is figure.axes[0]
                else None
            )
            axes.plot([], [], color=colour, label=name)
        axes.set(xscale="log", yscale="log", xlabel="touches", title=label)
        axes.grid(alpha=0.3, which="both")
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    figure.suptitle(
        "Root mean square error after each touch (solid) and its stated deviation (dotted)"
    )
    save_figure(figure, path)

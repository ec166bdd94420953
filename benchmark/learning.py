"""How well a sensor is learned from touches of unknown place, size and force, and what that is worth.

    scripts/setup python3 benchmark/learning.py [--plot docs/images/learning.png]

Each case is one sensor. Some of its touches are learned from, each after an untouched frame, others judge:
places, forces and ghosts with what was learned, and gains, resistances and sheet against the truth and
against the learned covariance. Frames come from the reference model (`bench/reference_data.py`), with 1 mV
of noise and 12 bits; the estimator is another. Forces are those after three presses of known force: touches
of unknown force leave one common factor open.
"""

import time
from dataclasses import dataclass, field, replace

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from tomotactile_ros.bench import tables
from tomotactile_ros.bench.program import options
from tomotactile_ros.bench.reference_cases import WORN
from tomotactile_ros.bench.sensor.readings import Wiring, potentials, readings
from tomotactile_ros.bench.sensor.states import States, states
from tomotactile_ros.bench.sensor.trial import judge, presses
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, make_pipeline
from tomotactile_ros.learning import findings
from tomotactile_ros.learning.recorded import learn
from tomotactile_ros.reconstruction.calibration import fit_contact_law
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.sheet_field import resistance_of
from tomotactile_ros.support.files import save_figure

JUDGED, PRESSES = 16, 3  # touches that judge; of known force
GAINS = Channels(gain=Rms(0.05, 1), offset=Rms(0.005, 1))
OHMS = Channels(ground_resistance=Uniform(250, 200, 1))
BOTH = replace(GAINS, ground_resistance=OHMS.ground_resistance)


@dataclass(frozen=True)
class Case:
    """One sensor: touches learned from, number of `reference_cases.WORN` (None: even), what is wrong
    with its channels, layout."""

    name: str
    touches: int
    sheet: int | None = None
    channels: Channels = field(default_factory=Channels)
    layout: str = "8x8"

    def states(self) -> States:
        """Touches, those that judge last."""
        if self.sheet is None:
            every = states(f"textbook-{self.layout}")
        else:
            every = states(f"learning-{self.layout}", WORN[self.sheet].words)
        first, last = slice(self.touches), slice(-JUDGED, None)
        both = (each[first] + each[last] for each in (every.seen, every.truths, every.cases))
        return States(every.layout, *both)


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
KINDS = (  # of what is learned: unit of the figures, digits, title of the plot
    ("gain", 100, 4, "error of gains / %"),
    ("resistance", 1, 1, "error of resistances to ground / Ω"),
    ("sheet", 100, 2, "error of the sheet's conductance / %"),
)


def measured(case):
    """Cells of the table, and the errors after each touch (see `compared`)."""
    touched, wiring = case.states(), Wiring(case.channels)
    trial = presses(case.name, touched, wiring)
    layout, grounded, split = trial.layout, trial.layout.grounded, 2 * case.touches
    learned = learn(layout, trial.frames[:split], grounded, DRIVE, noise=NOISE, course=True)
    law = calibrated(make_pipeline(layout, sensor=learned.state), touched, wiring, case)
    pipeline = make_pipeline(layout, sensor=learned.state, contact_law=law)
    rest = replace(trial, frames=trial.frames[split:], truths=trial.truths[split:])
    start = time.process_time()
    found = judge(pipeline, rest)
    seconds = (time.process_time() - start) / len(rest.frames)
    errors = compared(learned.state, learned.operator, case, layout)
    cells = [case.name, str(case.touches), *tables.cells(tables.SCORES, found)]
    cells.append(f"{law.coefficient / LAW.coefficient:.3f}")
    for key, unit, digits, _ in KINDS:
        cells += [f"{unit * value:.{digits}f}" for value in errors[key]]
    cells.append(f"{seconds:.2f}")
    course = [compared(state, learned.operator, case, layout) for state in learned.courses]
    return cells, course


def calibrated(pipeline, touched, wiring, case):
    """The contact law from `PRESSES` of the touches learned from, as if their forces were known: those
    farthest from electrodes."""
    places = np.array([[truth[0]["x"], truth[0]["y"]] for truth in touched.truths])
    distance = touched.layout.nearest(places[: case.touches])[0]
    pressed = []
    for i in np.argsort(-distance)[:PRESSES]:
        frame = readings(potentials(touched.seen[i], wiring), wiring, (int(i), 1))
        found = pipeline.strengths(frame, touched.layout.grounded, DRIVE)
        if found:
            pressed.append((touched.truths[i][0]["force"], found[0].conductance, found[0].area))
    return fit_contact_law(*zip(*pressed), exponent=LAW.exponent).law if pressed else LAW


def compared(state, operator, case, layout):
    """Errors of each of `KINDS`, rms, beside what the covariance says of them."""
    numbers = case.channels.of(layout.electrodes)
    ratio = state["gain"] / (1.0 if numbers.gain is None else numbers.gain)
    ohms = 0.0 if numbers.ground_resistance is None else numbers.ground_resistance
    values, deviation = findings.field(state, operator)
    true = sheet(case, layout, operator.field.centres)
    return {
        "gain": ((ratio / ratio.mean()).std(), findings.relative_gain_deviation(state)),
        "resistance": (
            rms(findings.resistance(state) - ohms),
            rms(findings.resistance_deviation(state, operator)),
        ),
        "sheet": (rms(values - values.mean() - true), rms(deviation)),
    }


def sheet(case, layout, places):
    """(C,) logarithm of the true conductance at `places`, 0 in the mean."""
    worn = None if case.sheet is None else WORN[case.sheet]
    resistance = worn and resistance_of(layout, worn.field, worn.variation)
    true = -np.log(resistance(places)) if resistance else np.zeros(len(places))
    return true - true.mean()


def rms(values):
    return float(np.sqrt((values**2).mean()))


def save_plot(path, courses):
    """Errors against the number of touches, and what the covariance says of them."""
    figure = Figure(figsize=(13, 5.6), layout="constrained")
    for axes, (key, unit, _, title) in zip(figure.subplots(1, 3), KINDS, strict=True):
        for number, (name, course) in enumerate(courses.items()):
            colour = colormaps["tab20"](number % 20)
            values = unit * np.array([each[key] for each in course])
            label = name if axes is figure.axes[0] else None
            counts = np.arange(1, len(values) + 1)
            axes.plot(counts, values[:, 0], "-", color=colour, linewidth=1.2, label=label)
            axes.plot(counts, values[:, 1], ":", color=colour, linewidth=1.2)
        axes.set(xscale="log", yscale="log", xlabel="touches", title=title)
        axes.grid(alpha=0.3, which="both")
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    figure.suptitle("Root mean square error after each touch (solid) and its deviation (dotted)")
    save_figure(figure, path)


def main():
    args = options(__doc__, plot=(str, "picture (.png) of errors against touches"))
    learned = [
        name for words in ("gains %", "to ground ohm", "sheet %") for name in (words, "bound")
    ]
    table = tables.Table(
        "sensor", "touches", *tables.titles(tables.SCORES), "factor", *learned, "s a frame"
    )
    courses = {}
    for case in CASES:
        cells, courses[f"{case.name}, {case.touches}"] = measured(case)
        table.add(*cells)
    if args.plot:
        save_plot(args.plot, courses)


if __name__ == "__main__":
    main()

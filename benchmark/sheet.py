"""Speed of the sheet models: transfer objects, frames, and how their cost grows.

    OMP_NUM_THREADS=1 python3 benchmark/sheet.py [--plot out/sheet.png]

Transfer objects go to all nodes of a square lattice: 41 x 41 unless said otherwise. scikit-fem
(where it is installed) assembles and factorises the untouched sheet on the same lattice and solves
for all electrodes, which are nodes there. All is measured in turn: the median, the interquartile
range, and the shortest time, which is what a busy machine disturbs least.
"""

import argparse
from dataclasses import replace
from functools import partial

import numpy as np

from tomotactile_ros.bench import machine, tables, timing
from tomotactile_ros.bench.cases import find_layout
from tomotactile_ros.bench.growth import exponent
from tomotactile_ros.bench.libraries import lattice, scikit_fem_solver
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.scenes.touches import Touch, Touches
from tomotactile_ros.sheet.closed_form import ClosedFormSheet
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.simulation import Simulator

PLACES = (-0.071, 0.048), (0.069, -0.052), (0.012, 0.017)  # m
SPEEDS, WAY = (0.002, 0.01, 0.05, 0.2, 1.0), 0.12  # m/s; s
ELECTRODES, CELLS = (4, 6, 8, 12, 16), (20, 40, 80, 160)


def transfer(model, layout, cells):
    nodes = lattice(layout, cells)[0]
    side = max(layout.outline.size)
    sheet = FemSheet(layout, h=side / cells) if model == "fem" else ClosedFormSheet(layout)
    return sheet.transfer(nodes, side / cells / 4)


def compare_transfers(layout):
    calls = {
        model: lambda model=model: transfer(model, layout, 40) for model in ("fem", "closed_form")
    }
    solve = scikit_fem_solver(layout, 40)
    if solve is None:
        print("scikit-fem is not installed: python3 -m pip install scikit-fem")
    else:
        calls["scikit-fem, without transfer object"] = solve
    return _times(calls, turn=0.2)


def frames(layout):
    """Durations of frames: contacts at rest solved anew; with noise and conversion, resting and
    moving."""
    scene = load_scene("default")
    resting = replace(scene, contacts=tuple(_disc(place) for place in PLACES))
    simulators = {
        f"two contacts at {1e3 * speed:g} mm/s, each row at its time": Simulator(
            layout, replace(scene, contacts=_two(speed))
        )
        for speed in SPEEDS
    }
    simulators |= {
        "two moving contacts, all rows at once": Simulator(
            layout, replace(scene, contacts=_two(SPEEDS[0])), row_period=0.0
        ),
        "three contacts at rest": Simulator(layout, resting),
    }
    points = FemSheet(layout, h=0.0025).transfer(np.array(PLACES), 0.003)
    resistance = np.array([1e4, 2e4, 5e3])
    calls = {
        "three contacts as discs, all ground conditions": lambda: frame(points, resistance, 3.3)
    }
    for name, simulator in simulators.items():
        clock = iter(range(10**9))
        calls[name] = lambda simulator=simulator, clock=clock: _next(simulator, next(clock))
    calls["two live touches that slide 2 mm a frame"] = _live(layout, _slide)
    calls["two live touches, each frame anywhere"] = _live(layout, _jump)
    return _times(calls, turn=0.02)


def _live(layout, places):
    """Makes a frame of two live touches at `places` (number of the frame), new in every frame."""
    simulator = Simulator(layout, load_scene("live"))
    simulator.live = Touches(layout)
    clock = iter(range(10**9))

    def call():
        number = next(clock)
        time = 0.064 * number
        simulator.live.press([Touch(*place, 2.0, 0.006) for place in places(number)], time)
        return simulator.frame(time, number)

    return call


def _slide(number):
    """To and fro along two lines, another one each time."""
    way, line = number * 0.002 % 0.16 - 0.08, number // 80 % 12 * 0.006
    return (way, line), (-way, line - 0.08)


def _jump(number):
    return np.random.default_rng(number).uniform(-0.09, 0.09, (2, 2)).tolist()


def _times(calls, turn):
    return timing.in_turn({name: [call] for name, call in calls.items()}, seconds=10, turn=turn)


def _next(simulator: Simulator, number: int):
    return simulator.frame(0.064 * number % WAY, number)


def _two(speed):
    """Discs of 5 mm and 8 mm that stay on the sheet for `WAY` s at the highest of `SPEEDS`."""
    larger = Contact("disc", (-0.07, 0.05), 0.008, pressure=20000.0, velocity=(speed, -speed / 5))
    return larger, _disc((0.07, -0.05), (-speed, speed / 5))


def _disc(place, velocity=(0.0, 0.0)):
    return Contact("disc", center=place, radius=0.005, pressure=20000.0, velocity=velocity)


def grow():
    """Set-up (s) and memory (bytes) of transfer objects by electrodes and by lattice."""
    cases = [("electrodes", n, 40) for n in ELECTRODES] + [("nodes", 8, cells) for cells in CELLS]
    for model in ("fem", "closed_form"):
        for by, side, cells in cases:
            layout = find_layout(f"equal-{side}x{side}")
            make = partial(transfer, model, layout, cells)
            seconds = [timing.timed(make)[1] for _ in range(3)]
            peak = timing.memory(make)[1]["peak"]
            size = side**2 if by == "electrodes" else (cells + 1) ** 2
            yield model, by, size, float(np.median(seconds)), peak


def print_growth(rows):
    cells = [(*row[:2], str(row[2]), f"{row[3]:.3f}", tables.megabytes(row[4])) for row in rows]
    print("\n".join(tables.markdown(("model", "by", "n", "set-up s", "peak MB"), cells)))
    for model, by in dict.fromkeys(row[:2] for row in rows):
        chosen = np.array([row[2:] for row in rows if row[:2] == (model, by)])
        time, memory = (exponent(chosen[:, 0], chosen[:, i]) for i in (1, 2))
        print(f"{model}, n {by}: set-up n^{time:.2f}, memory n^{memory:.2f}")


def plot(path, rows):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    for i, by in enumerate(("electrodes", "nodes")):
        axes = figure.add_subplot(1, 2, i + 1)
        for model in ("fem", "closed_form"):
            size, seconds, peak = zip(*(row[2:] for row in rows if row[:2] == (model, by)))
            line = axes.loglog(size, seconds, "o-", label=f"{model}, set-up / s")[0]
            megabytes = np.divide(peak, 1e6)
            axes.loglog(size, megabytes, "o--", color=line.get_color(), label=f"{model}, peak / MB")
        axes.set_xticks(size, [str(each) for each in size])
        axes.minorticks_off()
        axes.set(xlabel=f"number of {by}")
        axes.grid(color="0.9")
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plot", help="file for the growth of cost (.png)")
    args = parser.parse_args()
    machine.use_one_thread()
    found = machine.describe()
    print(
        f"{found['processor']}, numpy {found['libraries']['numpy']}, {found['date']}, one thread\n"
    )
    layout = find_layout("equal-8x8")
    times = compare_transfers(layout) | frames(layout)
    rows = []
    for name, seconds in times.items():
        summary = timing.summary(seconds)
        figures = summary["median"], summary["spread"], timing.undisturbed(seconds)
        rows.append((name, *map(tables.milliseconds, figures)))
    head = "8 x 8 electrodes, 41 x 41 nodes", "ms", "spread ms", "shortest ms"
    print("\n".join(tables.markdown(head, rows)))
    large = find_layout("equal-16x16")
    for model in ("fem", "closed_form"):
        make = partial(transfer, model, large, 160)
        seconds, peak = timing.timed(make)[1], timing.memory(make)[1]["peak"]
        print(f"\n16 x 16 on 161 x 161, {model}: {seconds:.2f} s, {peak / 1e6:.0f} MB at most")
    print()
    growth = list(grow())
    print_growth(growth)
    if args.plot:
        plot(args.plot, growth)


if __name__ == "__main__":
    main()

"""How often rows show a touch that is none: on an untouched sheet, and under a resting load.

    scripts/setup python3 benchmark/idle_rows.py [--idle ROWS] [--load ROWS] [--gains ROWS]

The sheet of the simulator's finite elements is at rest, so each ground condition is computed once
and every row gets noise and rounding of its own (1 mV, 12 bits, 1 ms a row, 8 x 8 electrodes on
200 mm; rows alone, no frame tells them anything). The load is one disc of 5 mm radius and 1 N, at
another place each 20,000 rows. The second table has what the threshold takes for granted: without a
touch a gain exceeds the level of probability p somewhere in at most 2 K p of the rows, with K places
and two sums. Seeds are fixed.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from rows import DRIVE, JUMPING, LAW, LAYOUT, NOISE, RADIUS, ROWS, anywhere, disc
from scipy.stats import norm

from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.estimation.births import RATE
from tomotactile_ros.estimation.estimator import Estimator
from tomotactile_ros.estimation.follow import Follower
from tomotactile_ros.estimation.row_estimator import RowEstimator, RowsState
from tomotactile_ros.estimation.row_model import Known
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

LEVELS = (1e-3, 1e-4, 1e-5, 1e-6)  # probability of one sum at one place
RUN, SETTLED = 20_000, 2 * ROWS  # rows at one place, of these before any is judged
STEP = DRIVE / 2**12  # V
SURE = -np.log(0.05)  # events: none were seen where fewer are expected, in 95 of 100 cases


def rows_of(contacts: list[Contact], count: int, seed: int):
    """(readings (E,) V, grounded) of rows of a sheet at rest."""
    simulator = Simulator(LAYOUT, Scene("rest", DRIVE, contacts, LAW), row_period=ROW_PERIOD)
    simulator.grounded = np.array(JUMPING)
    whole, random = simulator.frame(0.0, 0), np.random.default_rng(seed)
    for first in range(0, count, ROWS):
        noise = random.normal(0.0, NOISE, whole.shape)
        read = np.clip(STEP * np.rint((whole + noise) / STEP), 0.0, DRIVE)
        yield from list(zip(read, JUMPING))[: count - first]


def followed(rows: RowEstimator, contacts: list[Contact], count: int, seed: int) -> np.ndarray:
    """(4,) rows judged, contacts that have begun in them, rows withheld, and without a contact."""
    state, before, tally = RowsState(waits=False), 0, np.zeros(4, int)
    for i, (readings, ground) in enumerate(rows_of(contacts, count, seed)):
        rows.follow(readings, ground, DRIVE, i * ROW_PERIOD, state)
        if i >= SETTLED:
            there = len(state.rows.belief.numbers)
            tally += [1, 0, state.touching is None, there < len(contacts)]
        else:
            before = state.highest
    return tally + [0, state.highest - before, 0, 0]


def exceeded(estimator: Estimator, count: int) -> list[list[str]]:
    """How often gains of untouched rows exceed levels, and what they may."""
    operator, prior = estimator.sensor_of(tuple(range(LAYOUT.electrodes)), DRIVE)
    follower = Follower(operator, estimator.radius, prior.spread)
    state = follower.begin(Known.before(prior, (NOISE / DRIVE) ** 2))
    births, model, sums, most = follower.births, state.model, state.sums, np.zeros(count)
    for i, (readings, ground) in enumerate(rows_of([], count, 7)):
        row = model.row(np.empty((0, 4)), ground, state.belief.shift)
        valid = np.isfinite(readings)
        misfit = np.where(valid, readings / DRIVE - row.readings, 0.0)
        root = np.diag(np.sqrt(np.where(valid, row.variance, 1e6)))
        gains, _, sums = births.look(model, row, ground, misfit, root, sums, model.known.gain)
        most[i] = gains.max()
    each = 2 * len(births.places) * count
    return [
        [f"{p:g}", f"{norm.isf(p) ** 2:.1f}", f"{min(each * p, count):.0f}", str(above)]
        for p in LEVELS
        for above in [int((most > norm.isf(p) ** 2).sum())]
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--idle", type=int, default=1_000_000, help="rows of an untouched sheet")
    parser.add_argument("--load", type=int, default=200_000, help="rows under a resting load")
    parser.add_argument("--gains", type=int, default=100_000, help="rows whose gains are looked at")
    args = parser.parse_args()
    estimator = Estimator(LAYOUT, noise=NOISE, law=LAW, radius=RADIUS)
    rows, random, table = RowEstimator(estimator, frames=False), np.random.default_rng(3), []
    for name, wanted, load in (("untouched", args.idle, 0), ("resting load", args.load, 1)):
        runs, tally = max(1, round(wanted / RUN)) if load else 1, np.zeros(4, int)
        for run in range(runs):
            contacts = [disc(anywhere(random))] * load
            tally += followed(rows, contacts, wanted // runs, run)
        judged, begun, withheld, missed = tally
        most = (begun + SURE) / judged * RATE * 3600
        table.append([name, *map(str, (judged, runs, begun, withheld, missed)), f"{most:.2g}"])
    head = ["rows of", "rows", "places", "false touches", "withheld", "without its contact"]
    print("\n".join(markdown([*head, "false touches an hour at most (95 %, if none)"], table)))
    head = ["probability of one", "level of the gain", "rows above at most", "rows above"]
    print("\n" + "\n".join(markdown(head, exceeded(estimator, args.gains))))


if __name__ == "__main__":
    main()

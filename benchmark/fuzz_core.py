"""Random arrays into everything that the compiled core takes: no crash, no hang, one clear line.

    scripts/sanitize                                  with address and undefined sanitizers, tests first
    scripts/setup python3 benchmark/fuzz_core.py [--rounds 2000] [--seed 0]

Each round spoils one argument of a call that is right: NaN, infinities, huge and tiny numbers, nothing, another
shape, another type. Either the call answers, or it raises ValueError, TypeError, IndexError or LinAlgError.
"""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import fields, replace

import numpy as np

from tomotactile_ros.bench.program import options
from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.follow import Follower
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.row_model import Known, RowModel
from tomotactile_ros.estimation.touch import Touches
from tomotactile_ros.layouts.layout import equal_grid

REFUSED = ValueError, TypeError, IndexError, np.linalg.LinAlgError
DRIVE, NOISE = 3.3, 1e-3


def spoilt(value, random: np.random.Generator):
    """`value`, an array, with something wrong."""
    array = np.array(value, copy=True)
    kind = random.integers(8)
    if kind < 4 and array.size and array.dtype.kind == "f":
        at = tuple(random.integers(size) for size in array.shape)
        array[at] = random.choice([np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 0.0, -1.0])
        return array
    if kind == 4:
        return np.full_like(array, random.choice([0, 1, 7]))
    if kind == 5:
        return array[..., : random.integers(array.shape[-1] + 1)] if array.ndim else array
    if kind == 6:
        return np.zeros(random.integers(0, 4, random.integers(0, 4)))
    return random.choice(np.array([array.astype(str), array.astype(complex), None], object))


def sensor():
    """A small sensor with two contacts, one of which moves: operator, unknowns, rows, prior."""
    operator = SheetOperator(equal_grid(3, 4, (0.15, 0.2), 0.004, 1e4))
    count = operator.count
    contacts = np.array([[0.02, 0.01, -9, -5, 0, 0], [-0.03, 0.05, -8, -4, 0.3, 0.1]], float)
    at_rest = Unknowns.at_rest(operator).with_contacts(contacts, (5, 6), np.ones((2, 6), bool))
    rates, moving = np.zeros((2, 3)), np.array([True, False])
    rates[0] = 0.2, -0.1, 1.0
    unknowns = replace(at_rest, rates=rates, moving=moving)
    weights = np.full((count, count), (DRIVE / NOISE) ** 2)
    np.fill_diagonal(weights, 0.0)
    grounded, times = np.arange(count), 1e-3 * (np.arange(count) - count / 2)
    readings = Prediction(operator, unknowns, grounded, times=times).readings
    prior = Prior.unknown(operator, ChannelPrior(), 0.006, DRIVE)
    return operator, unknowns, Rows(readings, weights, grounded, times), prior


def one(random, operator, unknowns, rows, prior) -> None:
    """A call with one argument spoilt."""
    where = random.integers(9)
    if where == 8:
        return of_charges(random, operator)
    if where > 5:
        return of_follow(random, operator, unknowns, prior)
    if where > 3:
        return of_rows(random, operator, unknowns, prior, where == 4)
    if where == 0:
        name = str(random.choice([f.name for f in fields(Unknowns)]))
        value = getattr(unknowns, name)
        value = spoilt(np.eye(2) if value is None else value, random)
        unknowns = replace(unknowns, **{name: value})
    elif where == 1:
        name = str(random.choice([f.name for f in fields(Rows)]))
        rows = replace(rows, **{name: spoilt(getattr(rows, name), random)})
    elif where == 2:
        name = str(random.choice(["sheet", "gain", "offset", "aside", "precision", "radius"]))
        prior = replace(prior, **{name: spoilt(getattr(prior, name), random)})
    else:
        coefficients = spoilt(unknowns.sheet, random)
        touches = Touches(operator, spoilt(unknowns.contacts, random), (5, 6), coefficients)
        touches.stronger(unknowns.contacts)
        touches.centre(int(random.integers(-3, 4)))
        return
    fit = compiled.Fit(operator.core, unknowns, rows.core, prior.core)
    linear = compiled.Linear.of_all(fit)
    linear.step(float(random.choice([0.0, 1e-3, np.nan, -1.0])))
    linear.equations.unevenness(fit)
    compiled.approach(fit, 2000.0)
    compiled.solve(fit, int(random.integers(-1, 3)), linear.equations, np.inf, 2000.0)


def of_charges(random, operator) -> None:
    """What electrodes make of places, with one array of either spoilt."""
    layout = operator.layout
    given = [layout.positions, np.array(layout.outline.size), layout.positions + 0.01]
    which = int(random.integers(3))
    given[which] = spoilt(given[which], random)
    charges = compiled.InducedCharges(given[0], layout.radius, 1e4, given[1])
    for of_places in (charges.between, charges.own, charges.potentials):
        of_places(given[2])


def of_rows(random, operator, unknowns, prior, of_sensor: bool) -> None:
    """Calls of the model of rows with one argument spoilt: of the sensor, or of a row."""
    count, modes = operator.count, operator.modes
    known = Known.before(prior, 1e-7)
    if of_sensor:
        name = str(random.choice([f.name for f in fields(Known)][:7]))
        known = replace(known, **{name: np.asarray(spoilt(getattr(known, name), random))})
    model = RowModel(operator, known)
    row = {"contacts": unknowns.contacts[:, :4], "ground": 3, "shift": np.zeros(modes + count)}
    if not of_sensor:
        name = str(random.choice(list(row)))
        row[name] = spoilt(row[name], random)
    model.shares(row["contacts"])
    model.mutual(spoilt(row["contacts"], random))
    misfit, root = np.full(count, 0.1), 0.01 * np.eye(count)
    compiled.outliers(spoilt(misfit, random), spoilt(root, random), np.ones(count, bool), 3)
    model.row(**row)


def of_follow(random, operator, unknowns, prior) -> None:
    """Some rows of a state whose belief, or one of the rows, is spoilt."""
    known = Known.before(prior, 1e-7)
    follower = Follower(operator, 0.008, 0.6)
    state, count = follower.begin(known), operator.count
    belief, name = state.belief, str(random.choice(["mean", "covariance", "sizes", "none"]))
    for i, (x, y, strength, size) in enumerate(unknowns.contacts[:, :4]):
        mean, own = [x, y, 0.1, 0.0, strength], 1e-4 * np.eye(5)
        belief = belief.with_contact(np.array(mean), own, np.array([size, 0.1]), i + 1, 0.0)
    if name != "none":
        belief = belief.replaced(**{name: spoilt(getattr(belief, name), random)})
    state.belief, at = belief, int(random.integers(6))
    for i in range(6):
        row = [np.full(count, 0.5), np.arange(count) != i, i, i * 1e-3]
        row[0][random.integers(count)] = random.random()
        if i == at:
            which = int(random.integers(4))
            row[which] = spoilt(np.array(row[which]), random)
            row[2:] = [each.item() if getattr(each, "size", 0) == 1 else each for each in row[2:]]
        wait = [row[k] for k in (0, 1, 3)]
        follower.wait(state, *wait) if random.random() < 0.2 else follower.follow(state, *row)
    state.belief.unlearned(spoilt(known.shift_deviation, random))
    state.belief.without(int(random.integers(-1, 3)))


def main() -> None:
    asked = options(__doc__, rounds=2000, seed=0)
    warnings.simplefilter("ignore", np.exceptions.ComplexWarning)
    given, ended = sensor(), Counter[str]()
    for number in range(asked.rounds):
        random = np.random.default_rng([asked.seed, number])
        try:
            one(random, *given)
            ended["answered"] += 1
        except REFUSED as error:
            ended[type(error).__name__] += 1
            if "\n" in str(error).strip() and not isinstance(error, TypeError):
                raise AssertionError(f"round {number}: more than one line: {error}") from error
    print(f"{asked.rounds} rounds:", ", ".join(f"{k} {n}" for k, n in ended.most_common()))


if __name__ == "__main__":
    main()

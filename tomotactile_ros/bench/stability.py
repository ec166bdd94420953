"""What comes out at the extremes: the error against a reference, or the refusal.

Each row changes one thing of an ordinary set-up: 8 x 8 electrodes on 200 mm x 200 mm, one contact of 5 mm
radius, 1 mV of noise, 12 bits, 20 x 20 pixels.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, PRESSURE, record
from tomotactile_ros.contact import Contact, ContactLaw
from tomotactile_ros.defects import Adc, Defects, Noise
from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import Layout, equal_grid
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.basis import FrameBasis
from tomotactile_ros.reconstruction.linear import LinearImage
from tomotactile_ros.scene import Scene
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.contacts import contact_points
from tomotactile_ros.sheet.frames import frame
from tomotactile_ros.sheet.sensitivity import Sensitivity

_PLACE = np.array([0.13, -0.21])  # of the contact, in parts of the sides
_CELLS = 20


@dataclass(frozen=True)
class Trial:
    """One row: `outcome(value)` gives a text for people and an error, a number without unit or in V or m."""

    what: str
    measure: str
    values: tuple
    outcome: Callable[[float], float]


def run(step: int = 1, tick: Callable[[], None] = lambda: None) -> Iterator[dict]:
    """Rows: what, value, measure, error (None where refused), refusal, warnings.

    Every `step`-th value of each extreme, and the last; `tick` is called after each.
    """
    for trial in trials():
        for value in _values(trial, step):
            yield _row(trial, value)
            tick()


def count(step: int = 1) -> int:
    """Number of rows."""
    return sum(len(_values(trial, step)) for trial in trials())


def _values(trial, step):
    return tuple(dict.fromkeys([*trial.values[::step], trial.values[-1]]))


def _row(trial, value):
    error, refusal = None, None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            error = float(trial.outcome(value))
        except InputError as refused:
            refusal = str(refused)
    return {
        "what": trial.what,
        "value": _finite(value),
        "measure": trial.measure,
        "error": None if error is None else _finite(error),
        "refusal": refusal,
        "warnings": sorted({str(warning.message) for warning in caught}),
    }


def _finite(number):
    """The number, as text where JSON knows none."""
    return float(number) if np.isfinite(number) else str(number)


def trials() -> tuple[Trial, ...]:
    powers = tuple(10.0**n for n in range(-3, 10, 2))
    return (
        Trial("sheet resistance, ohm/sq", "voltage, parts of drive", powers, _by_resistance),
        Trial("sheet resistance, ohm/sq", "place, parts of side", powers, _place_by_resistance),
        Trial(
            "contact conductance, S/m2", "voltage, parts of drive", _CONDUCTANCES, _by_conductance
        ),
        Trial(
            "contact conductance, S/m2",
            "place, parts of side",
            _CONDUCTANCES,
            _place_by_conductance,
        ),
        Trial("lambda^2, eq. 1", "image, parts of its norm", _LAMBDAS, _by_lambda),
        Trial("lambda^2, eq. 1", "place, parts of side", _LAMBDAS, _place_by_lambda),
        Trial("noise, V", "place, parts of side", (0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0), _by_noise),
        Trial("converter, bits", "place, parts of side", (1, 2, 4, 8, 12, 16, 24), _by_bits),
        Trial(
            "dead channels of 64",
            "place, parts of side",
            (0, 1, 4, 16, 32, 48, 60, 62, 63),
            _by_dead,
        ),
        Trial("side, m", "place, parts of side", (1e-3, 1e-2, 0.2, 1.0, 10.0), _by_side),
        Trial("aspect ratio", "voltage, parts of drive", (1, 3, 10, 30, 100), _by_aspect),
        Trial("electrodes to a side", "place, parts of side", (1, 2, 3, 4, 8, 16), _by_electrodes),
        Trial("gap of electrodes, radii", "voltage, parts of drive", (0, 0.01, 0.1, 1), _by_gap),
        Trial(
            "condition, float32", "image, parts of its norm", _CONDITIONS, _by_condition(np.float32)
        ),
        Trial(
            "condition, float64", "image, parts of its norm", _CONDITIONS, _by_condition(np.float64)
        ),
        Trial("condition, as used", "image, parts of its norm", _CONDITIONS, _by_condition(None)),
    )


_CONDUCTANCES = (0.0, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e9, 1e30, np.inf)
_LAMBDAS = (0.0, 1e-30, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e12, 1e30)
_CONDITIONS = (1.0, 1e2, 1e4, 1e6, 1e8, 1e10, 1e12, 1e14, 1e16)


def _layout(side=0.2, count=8, resistance=1e4, size=None, radius=None) -> Layout:
    size = size or (side, side)
    radius = radius or 0.1 * min(size) / count
    return equal_grid(count, count, size, radius, resistance)


def _voltages(layout, conductance, model, place=_PLACE):
    """(E, E) of a contact of 1/40 of the shorter side, V per V of drive."""
    size = np.array(layout.outline.size)
    contact = Contact("disc", center=place * size, radius=size.min() / 40)
    points, areas, radii = contact.patches(6)
    flow = np.full(len(areas), conductance)
    sheet = make_sheet(layout, model, h=max(size.min() / 40, size.max() / 400))
    return frame(*contact_points(sheet, points, areas, radii, flow), 1.0)


def _models_apart(layout, conductance, place=_PLACE):
    """Largest difference of closed form and finite elements, V per V of drive."""
    frames = [_voltages(layout, conductance, model, place) for model in ("closed_form", "fem")]
    return _far(*frames)


def _far(one, other):
    """Largest difference of two frames; infinite where one has readings that the other lacks."""
    if (np.isfinite(one) != np.isfinite(other)).any():
        return np.inf
    return np.nanmax(np.abs(one - other))


def _by_resistance(resistance):
    """Bare contacts: the sheet resistance changes no voltage."""
    frames = [_voltages(_layout(resistance=r), np.inf, "closed_form") for r in (resistance, 1e4)]
    return _far(*frames)


def _by_conductance(conductance):
    return _models_apart(_layout(), conductance)


def _by_aspect(ratio):
    return _models_apart(_layout(size=(0.2, 0.2 / ratio)), np.inf)


def _by_gap(gap):
    """Electrodes of a 2 x 2 grid with a gap of so many radii between them."""
    radius = 0.075 / (2 + gap)
    layout = equal_grid(2, 2, (0.2, 0.2), radius, 1e4, margin=0.0625)
    return _models_apart(layout, np.inf, np.array([0.38, -0.36]))


def _place(layout, *, law=LAW, pressure=PRESSURE, noise=NOISE, bits=12, dead=(), level=None):
    """Distance of the strongest contact from the true one, in parts of the longer side; nan: none."""
    size = np.array(layout.outline.size)
    scene = Scene(
        "extreme",
        DRIVE,
        (),
        law,
        Noise(noise, 1) if noise else None,
        Adc(bits, DRIVE),
        Defects(dead=tuple(dead)),
    )
    recording = record(layout, scene, [(_PLACE * size)[None]], pressure, size.max() / 40)
    settings = Settings(
        resolution=_CELLS, noise=max(noise, 1e-6), regularization=level, contact_law=law or LAW,
        contact_radius=size.max() / 40,
    )  # fmt: skip
    pipeline = Pipeline(layout, settings)
    result = pipeline.process(recording.frames[0], np.arange(layout.electrodes), DRIVE)
    for image in (result.potential, result.pressure):
        if not np.isfinite(image[pipeline.grid.inside]).all():
            raise InputError("the image is not finite")
    if not result.contacts:
        raise InputError(
            "idle: no contact is reported" if result.idle else "no contact is reported"
        )
    found = result.contacts[0]
    return np.hypot(*(np.array([found.x, found.y]) - _PLACE * size)) / size.max()


def _place_by_resistance(resistance):
    """A contact as conductive as the sheet."""
    return _place(_layout(resistance=resistance), law=ContactLaw(3e4 / resistance / PRESSURE, 1.0))


def _place_by_conductance(conductance):
    if conductance == np.inf:
        return _place(_layout(), law=None)
    if conductance == 0:
        return _place(_layout(), pressure=0.0)
    return _place(_layout(), law=ContactLaw(conductance / PRESSURE, 1.0))


def _place_by_lambda(level):
    return _place(_layout(), level=level)


def _by_noise(noise):
    return _place(_layout(), noise=noise)


def _by_bits(bits):
    return _place(_layout(), bits=bits)


def _by_dead(number):
    order = np.random.default_rng(5).permutation(64)
    return _place(_layout(), dead=sorted(order[:number].tolist()))


def _by_side(side):
    law = replace(LAW, coefficient=LAW.coefficient * (0.2 / side) ** 2)
    return _place(_layout(side=side), law=law)


def _by_electrodes(number):
    return _place(_layout(count=number))


class _OneStep:
    """Eq. 1 on a noisy frame, by the singular values of J: right to 1e-8 at any lambda that is used here."""

    def __init__(self):
        layout = _layout()
        grid_points = (np.indices((_CELLS, _CELLS)).reshape(2, -1).T + 0.5) / _CELLS - 0.5
        self.transfer = make_sheet(layout).transfer(0.2 * grid_points, 0.002)
        self.matrix = Sensitivity(self.transfer).dense()
        self.left, self.values, self.right = np.linalg.svd(self.matrix, full_matrices=False)
        voltages = np.nan_to_num(_voltages(layout, np.inf, "fem")) * DRIVE
        voltages += NOISE * np.random.default_rng(2).standard_normal(voltages.shape)
        np.fill_diagonal(voltages, 0.0)
        self.frame = voltages.ravel()

    def exact(self, level):
        filtered = self.values / (self.values**2 + level) if level else 1 / self.values
        return self.right.T @ (filtered * (self.left.T @ self.frame))

    def error(self, image, level):
        exact = self.exact(level)
        return np.linalg.norm(image - exact) / np.linalg.norm(exact)


_kept: list[_OneStep] = []


def _one_step():
    if not _kept:
        _kept.append(_OneStep())
    return _kept[0]


def _as_used(problem, level):
    basis = FrameBasis(problem.transfer)
    return LinearImage(basis, level).image(problem.frame.astype(np.float32))


def _by_lambda(level):
    problem = _one_step()
    return problem.error(_as_used(problem, level), level)


def _by_condition(dtype):
    """Normal equations (J'J + lambda^2 I) f = J'v in one precision, or what the package does."""

    def outcome(condition):
        problem = _one_step()
        largest = problem.values[0] ** 2
        level = largest / (condition - 1) if condition > 1 else 1e6 * largest
        if dtype is None:
            return problem.error(_as_used(problem, level), level)
        matrix = problem.matrix.astype(dtype)
        gram = matrix.T @ matrix + dtype(level) * np.eye(matrix.shape[1], dtype=dtype)
        try:
            image = np.linalg.solve(gram, matrix.T @ problem.frame.astype(dtype))
        except np.linalg.LinAlgError:
            raise InputError("the matrix is singular") from None
        return problem.error(image, level)

    return outcome

"""The contact law from contacts of known force: g = c p^m, a straight line between logarithms.

Whatever is constant in a sensor and not in the model (sheet resistance, size of the contact) ends
up in c: presses for calibration should resemble those of use. What was learned of the sensor, and
the radius of the foot, if they are known, leave less to it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.estimation.estimator import Estimator, State
from tomotactile_ros.frame import Frame, stacked
from tomotactile_ros.layouts.layout import Layout, check_on_sheet
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.reconstruction.settings import Settings
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import read_mapping, write_mapping

NODE = "/**/reconstruction"
_FOOT = 0.01  # relative deviation of the radius of a foot that is known
_LEAST_RATIO = 1.5  # of the largest to the smallest force, to fit the exponent


@dataclass(frozen=True)
class Fit:
    """A contact law, the root mean square relative error of its forces, and the number of
    presses."""

    law: ContactLaw
    error: float
    presses: int


def measure_conductance(
    layout: Layout,
    frames: Iterable[Frame] | ArrayLike,
    grounded: ArrayLike | None = None,
    drive_voltage: float | None = None,
    sensor: SensorState | None = None,
    foot_radius: float | None = None,
) -> tuple[float, float]:
    """Conductance (S) and area (m^2) of the one contact in frames, medians over them.

    frames : `Frame`s, also those of a file, or their voltages alone: (N, L, E) V, and then
    grounded : (L,) electrode of each row; drive_voltage : V
    sensor : what was learned of it; foot_radius : of a round foot, m
    """
    if foot_radius is not None:
        check_on_sheet(layout, checks.length(foot_radius, "foot_radius"), "foot_radius")
    given = stacked(frames, grounded, drive_voltage)
    found = _estimated(layout, *given, sensor, foot_radius)
    found = [contacts[0] for contacts in found if contacts]
    if not found:
        raise InputError("no frame shows a contact")
    return float(np.median([c.conductance for c in found])), float(
        np.median([c.area for c in found])
    )


def _estimated(layout, frames, grounded, drive_voltage, sensor, foot_radius):
    """Contacts of each frame, strongest first, by the estimator."""
    settings = Settings()
    estimator = Estimator(
        layout,
        noise=settings.noise,
        law=settings.law,
        radius=settings.contact_radius if foot_radius is None else foot_radius,
        sensor=sensor,
        spread=None if foot_radius is None else _FOOT,
    )
    state = State()
    return [estimator.estimate(f, grounded, drive_voltage, state).contacts for f in frames]


def fit_contact_law(
    forces: ArrayLike, conductances: ArrayLike, areas: ArrayLike, exponent: float | None = None
) -> Fit:
    """Least squares in logarithms.

    Parameters
    ----------
    forces : (n,) N; conductances : (n,) S; areas : (n,) m^2
    exponent : m, where it is known; needed where all forces are alike
    """
    forces, conductances, areas = (np.asarray(x, float) for x in (forces, conductances, areas))
    if not len(forces) or not (forces > 0).all():
        raise InputError("force: presses with a force above 0 N are needed")
    if not ((conductances > 0) & np.isfinite(conductances)).all():
        raise InputError("frames: a press shows no conductance")
    pressure, density = np.log(forces / areas), np.log(conductances / areas)
    if exponent is None and forces.max() < _LEAST_RATIO * forces.min():
        raise InputError(
            f"force: {forces.min():g} to {forces.max():g} N are too alike to fit the exponent; press with "
            f"forces {_LEAST_RATIO:g} times apart, or give --exponent"
        )
    if exponent is None:
        slope = np.polyfit(pressure, density, 1)[0]
    else:
        slope = checks.positive(exponent, "exponent", "number")
    if not slope > 0:
        raise InputError(
            "force: conductance does not grow with force, check the order of the presses"
        )
    offset = (density - slope * pressure).mean()
    error = np.expm1((density - offset) / slope - pressure)
    law = ContactLaw(float(np.exp(offset)), float(slope))
    return Fit(law, float(np.sqrt((error**2).mean())), len(forces))


def save_calibration(path: str | Path, fit: Fit) -> None:
    """Write the law as parameters of the reconstruction node (`params_file`)."""
    parameters = {
        "contact_coefficient": fit.law.coefficient,
        "contact_exponent": fit.law.exponent,
    }
    write_mapping(path, {NODE: {"ros__parameters": parameters}})


def load_calibration(path: str | Path) -> ContactLaw:
    """The contact law in a file of `save_calibration`, or in any parameter file of the node."""
    content = read_mapping(path)
    section = content.get(NODE)
    parameters = section.get("ros__parameters") if isinstance(section, dict) else None
    if not isinstance(parameters, dict):
        raise InputError(f"{path}: {NODE}: is missing, a file written by 'calibrate' is needed")
    values = []
    for key in ("contact_coefficient", "contact_exponent"):
        if key not in parameters:
            raise InputError(f"{path}: {NODE}.ros__parameters.{key}: is missing")
        value = parameters[key]
        if isinstance(value, str):  # YAML 1.1 on 1e-4
            try:
                value = float(value)
            except ValueError:
                pass
        values.append(checks.positive(value, f"{path}: {NODE}.ros__parameters.{key}", "number"))
    coefficient, exponent = values
    return ContactLaw(coefficient, exponent)

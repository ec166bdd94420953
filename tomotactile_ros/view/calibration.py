"""The fit of a contact law as a picture: presses, the law, and how far the forces are off it."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.support.files import save_figure


def save_fit(
    path: str | os.PathLike,
    law: ContactLaw,
    forces: ArrayLike,
    conductances: ArrayLike,
    areas: ArrayLike,
) -> None:
    """Write a picture of presses of `forces` (n,), N, that had `conductances` (n,), S, over `areas`
    (n,), m^2, and of the law that was fitted to them."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    force, conductance, area = (np.asarray(x, float) for x in (forces, conductances, areas))
    pressure, density = force / area, conductance / area
    found = law.pressure(density) * area
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    line = np.geomspace(pressure.min() / 1.5, pressure.max() * 1.5, 50)
    label = f"g = {law.coefficient:.3g} p^{law.exponent:.3g}"
    left.plot(line / 1e3, law.conductance(line), color="0.5", label=label)
    left.plot(pressure / 1e3, density, "o", label="presses")
    left.set(xscale="log", yscale="log", xlabel="pressure / kPa", ylabel="conductance / (S/m²)")
    for axis in (left.xaxis, left.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    left.legend(frameon=False)
    right.axhline(0, color="0.5")
    off = 100 * (found / force - 1)
    right.plot(force, off, "o")
    most = max(1.0, 1.1 * float(np.abs(off).max()))  # rounding alone is not blown up
    right.set(ylim=(-most, most), xlabel="true force / N", ylabel="error of the law's force / %")
    for axes in (left, right):
        axes.grid(alpha=0.3, which="both")
    presses = "one press" if len(force) == 1 else f"{len(force)} presses"
    figure.suptitle(f"contact law from {presses}")
    save_figure(figure, path)

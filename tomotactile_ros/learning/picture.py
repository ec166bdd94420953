"""A picture of what was learned: map of the sheet's conductance, and each channel with its error
bars."""

from __future__ import annotations

import os

import numpy as np

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning import findings
from tomotactile_ros.learning.recorded import Learned
from tomotactile_ros.support.files import save_figure

_CELLS = 80  # of a map, along the longer side
_LEARNED, _EXPECTED = "C0", "0.6"  # colours of channels


def save_picture(path: str | os.PathLike, layout: Layout, learned: Learned) -> None:
    """Write the PNG: maps of the sheet on the left, gains, offsets and resistances on the right."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 8.6), layout="constrained")
    state = learned.state
    figure.suptitle(
        f"{layout.name}: learned from {findings.count(state.touches, 'touch', 'es')}, "
        f"{findings.count(learned.untouched, 'untouched frame')}",
        fontsize=12,
    )
    left, right = figure.subfigures(1, 2, width_ratios=[1, 1.35])  # type: ignore[misc] # an array
    above, below = left.subplots(2, 1)
    _maps(left, above, below, layout, learned)
    _channels(right, learned)
    save_figure(figure, path)


def _maps(figure, above, below, layout, learned):
    grid = Grid.for_outline(layout.outline, _CELLS)
    at = learned.operator.field.at(grid.pixels)
    state = learned.state
    sheet = slice(0, learned.operator.field.count)
    values = 100 * np.expm1(at @ state.mean[sheet])
    field = learned.operator.field
    left = findings.unevenness(state, learned.operator) * field.left[field.cell_of(grid.pixels)]
    spread = 100 * np.hypot(state.std_across(at), left)
    most = max(5.0, np.abs(values).max())
    ratio, direction, uncertain = findings.anisotropy(state, learned.operator)
    way = (
        f"{ratio:.2f} : 1 along {direction:.0f}°"
        if ratio - 1 > 2 * uncertain
        else "the same in all directions"
    )
    title = f"conductance of the sheet, {way}"
    _map(
        figure,
        above,
        layout,
        grid.fill(values),
        "RdBu_r",
        (-most, most),
        title,
        "deviation from the mean / %",
    )
    _map(
        figure, below, layout, grid.fill(spread), "viridis", (0, max(spread.max(), 0.1)),
        "its standard deviation", "%",
    )  # fmt: skip


def _map(figure, axes, layout, values, colours, limits, title, label):
    xmin, ymin, xmax, ymax = (1e3 * side for side in layout.outline.bounds)
    image = axes.imshow(
        values,
        extent=(xmin, xmax, ymin, ymax),
        origin="upper",
        cmap=colours,
        vmin=limits[0],
        vmax=limits[1],
    )
    figure.colorbar(image, ax=axes, label=label)
    for ring in (layout.outline.shell, *layout.outline.holes):
        axes.plot(*(1e3 * np.vstack([ring, ring[:1]]).T), color="0.3", linewidth=1)
    axes.plot(
        *(1e3 * layout.positions.T),
        "o",
        color="white",
        markeredgecolor="0.3",
        markersize=3.5,
        clip_on=False,
    )
    axes.set_title(title, fontsize=10)
    axes.set(xlabel="x / mm", ylabel="y / mm", aspect="equal")


def _channels(figure, learned):
    parts = (
        ("gain", 100.0, "gain minus 1 / %", -1.0),
        ("offset", 1e3, "offset / mV", 0.0),
        ("resistance", 1.0, "resistance to ground / Ω", 0.0),
    )
    state = learned.state
    numbers = np.arange(state.electrodes)
    good = ~np.isin(numbers, list(learned.faults))
    for axes, (part, unit, label, shift) in zip(figure.subplots(3, 1, sharex=True), parts):
        values, spread = findings.of_channels(state, learned.operator, part)
        values, spread = unit * (values + shift), unit * spread
        below = np.minimum(spread, values) if part == "resistance" else spread  # none is negative
        found = good & (state.known(part) >= findings.FOUND)
        axes.axhline(0, color="0.7", linewidth=0.8)
        for which, colour in ((found, _LEARNED), (good & ~found, _EXPECTED)):
            axes.errorbar(
                numbers[which], values[which], (below[which], spread[which]), fmt="o", color=colour, markersize=3,
                capsize=2, linewidth=1,
            )  # fmt: skip
        axes.set_ylabel(label)
        axes.margins(x=0.01)
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_xlabel("electrode")
    for colour, name in ((_LEARNED, "learned"), (_EXPECTED, "hardly more than what was expected")):
        figure.axes[0].plot([], [], "o", color=colour, markersize=4, label=name)
    figure.legend(
        loc="outside upper left",
        ncols=2,
        frameon=False,
        fontsize=9,
        title="error bars: one standard deviation",
        title_fontsize=9,
        alignment="left",
    )

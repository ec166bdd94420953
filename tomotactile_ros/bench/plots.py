"""Plots of a result: the Pareto front of speed and accuracy, and the growth of cost."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tomotactile_ros.bench import trade
from tomotactile_ros.errors import InputError

_COLOURS = {"fast": "tab:blue", "balanced": "tab:orange", "accurate": "tab:green"}
_MARKERS = {20: "v", 40: "o", 80: "^"}


def save_front(path: str | Path, result: dict) -> None:
    """Position error of the reported contact against the time of one frame; the front as a line."""
    from matplotlib.ticker import LogLocator

    figure = _figure(7.5, 5.2)
    axes = figure.add_subplot()
    rows = [row for row in result["trade"] if row["layout"] == trade.DEFAULT_LAYOUT]
    others = [row for row in result["trade"] if row["layout"] != trade.DEFAULT_LAYOUT]
    for row in rows + others:
        full = row["conditions"] is None
        colour = _COLOURS[row["profile"]]
        axes.plot(
            *_place(row),
            _MARKERS[row["resolution"]] if row in rows else "x",
            color=colour,
            markerfacecolor=colour if full else "none",
            markersize=8 if row in rows else 6,
        )
    for row in others + [row for row in rows if row["conditions"] is not None]:
        axes.annotate(_name(row), _place(row), (5, 4), textcoords="offset points", fontsize=7)
    line = [_place(row) for row in trade.front(rows)]
    axes.step(*np.transpose(line), where="post", color="0.3", linewidth=1, zorder=0)
    for label, style in _legend():
        axes.plot([], [], label=label, **style)
    axes.set(
        xscale="log", yscale="log", xlabel="time of one frame, median / ms",
        ylabel="error of a contact's place, mean / mm",
        title=f"Speed and accuracy, one thread of {result['machine']['processor']}",
    )  # fmt: skip
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    axes.grid(which="both", color="0.9")
    axes.legend(frameon=False, fontsize=8)
    _write(figure, path)


def save_growth(path: str | Path, result: dict) -> None:
    """Set-up, frame and memory against electrodes and pixels, with the fitted exponents."""
    figure = _figure(9.0, 4.0)
    units = {
        "setup": ("set-up / s", 1.0),
        "frame": ("frame / ms", 1e3),
        "memory": ("memory / MB", 1e-6),
    }
    for number, (by, growth) in enumerate(result["growth"].items()):
        axes = figure.add_subplot(1, 2, number + 1)
        sizes = [point[by] for point in growth["points"]]
        for key, (label, scale) in units.items():
            values = [scale * point[key] for point in growth["points"]]
            axes.loglog(sizes, values, "o-", label=f"{label}, n^{growth['exponents'][key]:.2f}")
        axes.set(xlabel=f"number of {by}, n")
        axes.set_xticks(sizes, [str(size) for size in sizes], minor=False)
        axes.minorticks_off()
        axes.grid(color="0.9")
        axes.legend(frameon=False, fontsize=8)
    _write(figure, path)


def _place(row):
    return 1e3 * row["frame"]["median"], 1e3 * row["contact_error"]["mean"]


def _name(row):
    ground = "" if row["conditions"] is None else f", {row['conditions']} grounds"
    return row["layout"] + ground if row["layout"] != trade.DEFAULT_LAYOUT else ground[2:]


def _legend():
    for profile, colour in _COLOURS.items():
        yield profile, {"marker": "o", "color": colour, "linestyle": ""}
    for cells, marker in _MARKERS.items():
        yield f"{cells} x {cells} pixels", {"marker": marker, "color": "0.5", "linestyle": ""}
    yield "fewer ground conditions", {"marker": "o", "color": "0.5", "linestyle": "", "mfc": "none"}
    yield "other layouts", {"marker": "x", "color": "0.5", "linestyle": ""}
    yield "front", {"color": "0.3"}


def _figure(width, height):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _write(figure, path):
    try:
        figure.savefig(path, dpi=110)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None

"""The plot of a result: the Pareto front of speed and accuracy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from tomotactile_ros.bench import trade
from tomotactile_ros.bench.accuracy import SENSORS
from tomotactile_ros.bench.cases import is_default
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.support.files import save_figure

_COLOURS = {"fast": "tab:blue", "balanced": "tab:orange", "accurate": "tab:green"}
_TITLES = {"textbook": "sensor of the textbook", "worn": "worn sensor"}


def save_front(path: str | Path, result: dict) -> None:
    """OSPA distance of contacts against the time of one frame: a row of panels for each sensor, a
    panel for each number of electrodes.

    The choices on the front are named, the others are pale; peers stand beside their layout.
    """
    panels: dict[int, list[dict]] = {}
    for row in result["trade"]:
        panels.setdefault(load_layout(row["layout"]).electrodes, []).append(row)
    figure = Figure(figsize=(max(6.5, 4.4 * len(panels)), 8.4), layout="constrained")
    axes = figure.subplots(len(SENSORS), len(panels), sharex=True, sharey=True, squeeze=False)
    for i, sensor in enumerate(SENSORS):
        for j, (electrodes, rows) in enumerate(sorted(panels.items())):
            _draw_front(axes[i, j], rows, sensor)
            axes[i, j].set_title(f"{_TITLES[sensor]}, {electrodes} electrodes", fontsize=10)
            if any(map(is_default, rows)):
                _draw_peers(axes[i, j], result["peers"]["problem"], sensor)
        axes[i, 0].set_ylabel("OSPA distance of contacts, mean / mm")
    for each in axes[-1]:
        each.set_xlabel("time of one frame, median / ms")
    axes[0, 0].set_xlim(left=axes[0, 0].get_xlim()[0] / 4)
    for profile, colour in _COLOURS.items():
        axes[0, -1].plot([], [], "o", color=colour, label=profile)
    axes[0, -1].plot([], [], color="0.3", label="front: none is faster and better")
    axes[0, -1].plot([], [], "x", color="0.3", label="peer")
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.suptitle(f"Speed and accuracy, one thread of {result['machine']['processor']}")
    save_figure(figure, path)


def _draw_front(axes, rows, sensor):
    best = list(trade.front(rows, sensor))
    for row in rows:
        alpha = 1.0 if row in best else 0.3
        colour = _COLOURS[row["profile"]]
        axes.plot(*_place(row, sensor), "o", color=colour, markersize=7, alpha=alpha)
    for row in best:
        _name(axes, row["layout"].partition("-")[0], _place(row, sensor), -8)
    steps = np.transpose([_place(row, sensor) for row in best])
    axes.step(*steps, where="post", color="0.3", zorder=1)
    axes.set(xscale="log", yscale="log", axisbelow=True)
    axes.margins(0.12, 0.15)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
        axis.set_tick_params(which="both", labelsize=8)
    axes.grid(which="both", color="0.93")


def _draw_peers(axes, peers, sensor):
    for name, found in peers.items():
        if name == "fast" or "ospa" not in found:
            continue
        place = 1e3 * found["frame"]["median"], 1e3 * found["ospa"][sensor]
        axes.plot(*place, "x", color="0.3", markersize=7)
        _name(axes, name, place, 6)


def _name(axes, name, place, beside):
    """Left or right of a point, so many of its own points `beside` it."""
    side = "left" if beside > 0 else "right"
    axes.annotate(
        name, place, (beside, 0), textcoords="offset points", fontsize=7, color="0.3",
        horizontalalignment=side, verticalalignment="center",
    )  # fmt: skip


def _place(row, sensor):
    return 1e3 * row["frame"][sensor]["median"], 1e3 * row["ospa"][sensor]

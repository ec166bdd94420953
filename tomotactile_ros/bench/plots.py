"""Plots of a result: the Pareto front of speed and accuracy, and the growth of cost."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tomotactile_ros.bench import trade
from tomotactile_ros.bench.cases import find_layout
from tomotactile_ros.support.files import save_figure

_COLOURS = {"fast": "tab:blue", "balanced": "tab:orange", "accurate": "tab:green"}
_MARKERS = {20: "v", 40: "o", 80: "^"}
_LABEL = 7  # points
_QUANTITIES = (
    ("setup", "set-up / s", 1.0),
    ("frame", "frame / ms", 1e3),
    ("memory", "memory / MB", 1e-6),
)


def save_front(path: str | Path, result: dict) -> None:
    """Blur of the image against the time of one frame, a panel for each number of electrodes.

    The choices on the front are named, the others are pale.
    """
    panels = {}
    for row in result["trade"]:
        panels.setdefault(find_layout(row["layout"]).electrodes, []).append(row)
    figure = _figure(max(6.5, 4.4 * len(panels)), 5.2)
    all_axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    fronts = []
    for axes, (electrodes, rows) in zip(all_axes, sorted(panels.items())):
        fronts.append(list(trade.front(rows)))
        _draw_front(axes, rows, fronts[-1])
        axes.set_title(f"{electrodes} electrodes")
        axes.set_xlabel("time of one frame, median / ms")
    all_axes[0].set_xlim(left=all_axes[0].get_xlim()[0] / 4)
    for axes, best in zip(all_axes, fronts):
        _name_front(axes, best)
    all_axes[0].set_ylabel("blur of a contact's image, mean / mm")
    all_axes[0].annotate(
        "better", (0.03, 0.03), (0.16, 0.12), "axes fraction", color="0.4", fontsize=9,
        arrowprops={"arrowstyle": "->", "color": "0.4"},
    )  # fmt: skip
    for label, style in _legend():
        all_axes[-1].plot([], [], label=label, **style)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.suptitle(f"Speed and accuracy, one thread of {result['machine']['processor']}")
    save_figure(figure, path)


def _draw_front(axes, rows, best):
    for row in rows:
        colour = _COLOURS[row["profile"]]
        axes.plot(
            *_place(row),
            _MARKERS[row["resolution"]],
            color=colour,
            markerfacecolor=colour if row["conditions"] is None else "none",
            markersize=7,
            alpha=1.0 if row in best else 0.3,
        )
    axes.step(*np.transpose([_place(row) for row in best]), where="post", color="0.3", zorder=1)
    axes.set(xscale="log", yscale="log", axisbelow=True)
    axes.margins(0.12, 0.15)
    for axis in (axes.xaxis, axes.yaxis):
        _plain_numbers(axis)
    axes.grid(which="both", color="0.93")


def _name_front(axes, best):
    """Names left of their points, below the front, where no other point is; each lower than the
    one before."""
    above = np.inf
    for row in best:
        place = _place(row)
        height = axes.transData.transform(place)[1] * 72 / axes.figure.dpi
        above = min(height, above - _LABEL - 1)
        axes.annotate(
            _name(row), place, (-8, above - height), textcoords="offset points",
            fontsize=_LABEL, horizontalalignment="right", verticalalignment="center",
        )  # fmt: skip


def save_growth(path: str | Path, result: dict) -> None:
    """Set-up, frame and memory against electrodes and pixels, with the fitted powers."""
    figure = _figure(10.0, 5.6)
    grown = result["growth"]
    all_axes = figure.subplots(len(grown), len(_QUANTITIES), squeeze=False, sharey="col")
    for row, (by, growth) in zip(all_axes, grown.items()):
        sizes = np.array([point[by] for point in growth["points"]])
        for axes, (key, label, scale) in zip(row, _QUANTITIES):
            values = scale * np.array([point[key] for point in growth["points"]])
            power = growth["exponents"][key]
            middle = np.exp(np.log(values).mean() - power * np.log(sizes).mean())
            axes.plot(sizes, middle * sizes**power, "--", color="0.6", label=f"∝ n^{power:.2f}")
            axes.plot(sizes, values, "o", color="tab:blue")
            axes.set(xscale="log", yscale="log", xlabel=f"number of {by}, n", ylabel=label)
            axes.set_xticks(sizes, [str(size) for size in sizes])
            axes.set_xticks([], minor=True)
            _plain_numbers(axes.yaxis)
            axes.grid(color="0.9")
            axes.legend(frameon=False, fontsize=9, loc="upper left")
    figure.suptitle(f"Growth of cost, profile fast, one thread of {result['machine']['processor']}")
    save_figure(figure, path)


def _plain_numbers(axis):
    from matplotlib.ticker import LogLocator

    axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("{x:g}")
    axis.set_tick_params(which="both", labelsize=8)


def _place(row):
    return 1e3 * row["frame"]["median"], 1e3 * trade.blur(row)


def _name(row):
    family = row["layout"].partition("-")[0]
    ground = "" if row["conditions"] is None else f", {row['conditions']} grounds"
    return f"{family} {row['resolution']}²{ground}"


def _legend():
    for profile, colour in _COLOURS.items():
        yield profile, {"marker": "o", "color": colour, "linestyle": ""}
    yield "fewer ground conditions", {"marker": "o", "color": "0.5", "linestyle": "", "mfc": "none"}
    for cells, marker in _MARKERS.items():
        yield f"{cells} x {cells} pixels", {"marker": marker, "color": "0.5", "linestyle": ""}
    yield "front: none is faster and better", {"color": "0.3"}


def _figure(width, height):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure

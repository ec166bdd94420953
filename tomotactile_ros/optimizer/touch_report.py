"""Pictures of what is expected of contacts: ellipses over the sheet, and what more electrodes or
rows give."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from tomotactile_ros.evaluation.metrics import worst
from tomotactile_ros.evaluation.posterior import SEPARATION
from tomotactile_ros.optimizer.explore import Choice
from tomotactile_ros.optimizer.report import Zones, draw_sheet
from tomotactile_ros.optimizer.step import Step
from tomotactile_ros.support.files import save_figure

_LARGEST = 0.6  # of the spacing of contacts: semi-axis of an ellipse of the worst tenth
_WORDS = "mean place error", "place, worst tenth", "distance of pairs with the same d'"
_LEGEND = (
    "Ellipses: one standard deviation of the place of a contact there, magnified, by the estimator's own "
    f"model; red: the worst tenth. Grey: electrodes, to scale.\n{SEPARATION}"
)


def save_touch_report(
    path: str | os.PathLike, history: Sequence[Step], best: Step, title: str, keep_out: Zones = ()
) -> None:
    """Write a picture: ellipses at the start and at the best step, and the history.

    `keep_out` are discs (x, y, radius) without electrode centres, m.
    """
    from matplotlib.figure import Figure

    start = history[0]
    assert start.posterior is not None and best.posterior is not None  # of this method
    figure = Figure(figsize=(15, 5.8), layout="constrained")
    figure.suptitle(title, fontsize=11)
    zones = "; hatched: no electrode allowed" if keep_out else ""
    figure.supxlabel(_LEGEND + zones, fontsize=8.5)
    axes = figure.subplots(1, 3, width_ratios=[1, 1, 0.75])
    factor = _factor(start.posterior)
    when = "before", f"after (step {best.iteration})"
    for axis, step, words in zip(axes, (start, best), when):
        draw_sheet(axis, step.layout, "0.75", keep_out)
        _ellipses(axis, step.posterior, factor, words)
    steps = [step.iteration for step in history]
    lengths = np.array([step.posterior.lengths for step in history if step.posterior is not None])
    for words, values in zip(_WORDS, (lengths / lengths[0]).T):
        axes[2].plot(steps, values, "o-", label=words, markersize=4)
    axes[2].set(xlabel="round", ylabel="relative to the start", title="history")
    axes[2].xaxis.get_major_locator().set_params(integer=True)
    axes[2].grid(alpha=0.3)
    axes[2].legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), frameon=False)
    save_figure(figure, path)


def _ellipses(axes, posterior, factor, words):
    """What is known of a place, magnified by `factor`."""
    from matplotlib.collections import EllipseCollection

    variances, ways = np.linalg.eigh(posterior.covariance)
    across, along = 2e3 * factor * np.sqrt(variances).T
    angle = np.degrees(np.arctan2(ways[:, 1, 1], ways[:, 0, 1]))
    limit = np.sort(posterior.place)[-max(1, round(0.1 * len(posterior.place)))]
    colours = np.where(posterior.place >= limit, "tab:red", "tab:blue")
    axes.add_collection(
        EllipseCollection(
            along,
            across,
            angle,
            units="x",
            offsets=1e3 * posterior.places,
            transOffset=axes.transData,
            facecolors="none",
            edgecolors=colours,
            linewidths=1,
        )
    )
    mean, tenth = 1e6 * posterior.place.mean(), 1e6 * worst(posterior.place)
    axes.set_title(
        f"{words}\nmean {mean:.0f} µm, worst tenth {tenth:.0f} µm; ellipses × {factor:.3g}",
        fontsize=10,
    )


def save_exploration(
    path: str | os.PathLike,
    found: Sequence[Sequence[Choice]],
    place: float | None = None,
    frame_time: float | None = None,
    best: Choice | None = None,
) -> None:
    """Write a picture: error against the number of electrodes, and against the time of a frame.

    place, m, and frame_time, s, that were asked for are lines, and `best` is a ring.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullLocator

    figure = Figure(figsize=(13, 5.2), layout="constrained")
    figure.supxlabel(
        "Expected by the estimator's own model, of contacts all over the sheet: a real sensor is not "
        "better. Solid: mean; dashed: worst tenth; dotted: what was asked for; ring: what was chosen",
        fontsize=8.5,
    )
    axes = figure.subplots(1, 2)
    whole = [choices[-1] for choices in found]
    counts = [len(each.rows) for each in whole]
    axes[0].plot(counts, [1e3 * each.place for each in whole], "o-", label="mean")
    axes[0].plot(counts, [1e3 * each.worst_tenth for each in whole], "s--", label="worst tenth")
    axes[0].set_xscale("log", base=2)
    axes[0].set_xticks(counts, [str(count) for count in counts])
    axes[0].set(xlabel="electrodes, all of them grounded in a frame", ylabel="place error / mm")
    axes[0].legend()
    for choices in found:
        times = [1e3 * each.frame_time for each in choices]
        means = [1e3 * each.place for each in choices]
        name = f"{choices[0].layout.electrodes} electrodes"
        [line] = axes[1].plot(times, means, "o-", label=name)
        tenth = [1e3 * each.worst_tenth for each in choices]
        axes[1].plot(times, tenth, "s--", color=line.get_color(), markersize=4)
    if best is not None:
        at = 1e3 * best.frame_time, 1e3 * best.worst_tenth
        axes[1].plot(*at, "o", markersize=13, fillstyle="none", color="k")
    if frame_time is not None:
        axes[1].axvline(1e3 * frame_time, color="0.3", linestyle=":")
    axes[1].set_xscale("log", base=2)
    times = sorted({1e3 * each.frame_time for choices in found for each in choices})
    axes[1].set_xticks(_apart(times), [f"{each:g}" for each in _apart(times)])
    axes[1].set(xlabel="time of a frame / ms", ylabel="place error / mm")
    axes[1].legend()
    for axis in axes:
        axis.set_yscale("log")
        if place is not None:
            axis.axhline(1e3 * place, color="0.3", linestyle=":")
        for which in (axis.yaxis.set_major_formatter, axis.yaxis.set_minor_formatter):
            which(lambda value, _: f"{value:.3g}" if f"{value:e}"[0] in "125" else "")
        axis.xaxis.set_minor_locator(NullLocator())
        axis.grid(alpha=0.3, which="both", axis="y")
        axis.grid(alpha=0.3, axis="x")
    save_figure(figure, path)


def _apart(times):
    """Those of increasing times whose labels have room beside each other."""
    kept = times[:1]
    for each in times[1:]:
        if each > 1.4 * kept[-1]:
            kept.append(each)
    return kept


def _factor(posterior):
    """By which ellipses are magnified, one significant digit."""
    a, b = posterior.places.max(axis=0) - posterior.places.min(axis=0)
    step = np.sqrt(a * b / len(posterior.places))
    factor = _LARGEST * step / max(worst(posterior.place), 1e-12)
    digit = 10.0 ** np.floor(np.log10(factor))
    return float(digit * max(1, round(factor / digit)))

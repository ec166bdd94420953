"""A picture of what an optimization did: electrodes, maps of HWHM and position error, history."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.optimizer.scan import Scan
from tomotactile_ros.optimizer.step import Step, ratio
from tomotactile_ros.support.files import save_figure

Zones = Sequence[tuple[float, float, float]]  # (x, y, radius) of discs
_LEGEND = (
    "Each cell of a map is a contact that was put there alone. HWHM: half width at half maximum of its "
    "image. Position error: from the contact to the middle of its image.\n"
    "Blur: root mean square distance of the image from the contact. Noise gain: noise of an image cell "
    "over noise of a reading. Worst tenth: mean over the tenth of all contacts with the largest values.\n"
    "Less is better everywhere. White discs: electrodes, to scale"
)
_SCAN_LEGEND = (
    "Place error: expected from the estimator's own model for contacts all over the sheet; the rows are chosen "
    "by it. Images: eq. 1, which plays no part in the choice. Less is better.\n"
    "Number at an electrode: the smallest of these scans that still grounds it; dots: in none of them."
)


def save_report(
    path: str | os.PathLike, history: Sequence[Step], best: Step, title: str, keep_out: Zones = ()
) -> None:
    """Write a picture: the start above, the best step below, the history beside them.

    `keep_out` are discs (x, y, radius) without electrode centres, m.
    """
    from matplotlib.figure import Figure

    a, b = best.layout.outline.size
    figure = Figure(figsize=(14.5, float(np.clip(8.6 * b / a, 6.6, 9.6))), layout="constrained")
    figure.suptitle(f"{title}\n{_settings(best)}", fontsize=11)
    axes = figure.subplots(2, 3, width_ratios=[1, 1, 0.85])
    zones = "; hatched: no electrode allowed." if keep_out else "."
    figure.supxlabel(_LEGEND + zones, fontsize=8.5)
    start = history[0]
    for column, (label, pick) in enumerate(
        (("HWHM", "hwhm_map"), ("position error", "position_error_map"))
    ):
        maps = [1e3 * getattr(step.quality, pick) for step in (start, best)]
        top = max(np.nanmax(each) for each in maps)
        for row, (step, values) in enumerate(zip((start, best), maps)):
            when = "before" if row == 0 else f"after (step {best.iteration})"
            mean = np.nanmean(values)
            image = _map(axes[row, column], step.layout, values, top, keep_out)
            bar = axes[row, column].inset_axes([1.02, 0.0, 0.04, 1.0])
            figure.colorbar(image, cax=bar, label=f"{label} / mm")
            axes[row, column].set_title(f"{label} {when}: mean {mean:.1f} mm", fontsize=10)
    _history(axes[0, 2], history, best)
    _table(axes[1, 2], start, best)
    save_figure(figure, path)


def _settings(step):
    settings = step.quality.settings
    return (
        f"model {settings['model']}, contact radius {1e3 * settings['contact_radius']:g} mm, "
        f"lambda² = {settings['regularization']:g}, {settings['positions']} contact positions"
    )


def _map(axes, layout, values, top, keep_out):
    xmin, ymin, xmax, ymax = (1e3 * side for side in layout.outline.bounds)
    image = axes.imshow(
        values, extent=(xmin, xmax, ymin, ymax), origin="upper", cmap="viridis", vmin=0, vmax=top
    )
    draw_sheet(axes, layout, "white", keep_out)
    return image


def draw_rim(axes, layout: Layout) -> None:
    """The sheet's rim and that of its holes, mm."""
    for ring in (layout.outline.shell, *layout.outline.holes):
        axes.plot(*(1e3 * np.vstack([ring, ring[:1]]).T), color="0.3", linewidth=1)
    axes.set(aspect="equal", xlabel="x / mm", ylabel="y / mm")


def draw_sheet(axes, layout: Layout, colour: str, keep_out: Zones = ()) -> None:
    """Rim, electrodes to scale, in a colour, and where none may be, mm."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    draw_rim(axes, layout)
    discs = [Circle(1e3 * each, 1e3 * layout.radius) for each in layout.positions]
    axes.add_collection(PatchCollection(discs, facecolor=colour, edgecolor="black", linewidth=0.6))
    for x, y, radius in keep_out:
        zone = Circle((1e3 * x, 1e3 * y), 1e3 * radius, fill=False, hatch="///", edgecolor="0.7")
        axes.add_patch(zone)
    xmin, ymin, xmax, ymax = (1e3 * side for side in layout.outline.bounds)
    pad = 0.04 * max(xmax - xmin, ymax - ymin)
    axes.set(xlim=(xmin - pad, xmax + pad), ylim=(ymin - pad, ymax + pad))


def _history(axes, history, best):
    lines = (
        ("mean HWHM", lambda m: m["hwhm"]["mean"], "o-"),
        ("HWHM, worst tenth", lambda m: m["hwhm"]["worst_tenth"], "s-"),
        ("HWHM, worst region", lambda m: m["hwhm"]["worst_region"], "^-"),
        ("mean position error", lambda m: m["position_error"]["mean"], "d-"),
    )
    steps = [step.iteration for step in history]
    for label, pick, style in lines:
        values = np.array([pick(step.metrics) for step in history])
        with np.errstate(invalid="ignore", divide="ignore"):  # of a figure that was 0
            axes.plot(steps, values / values[0], style, label=label, markersize=4)
    axes.axvline(best.iteration, color="0.6", linestyle=":", label="best score")
    axes.set(ylabel="relative to the start", title="history, step by step")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, frameon=False)


def _table(axes, start, best):
    axes.axis("off")
    rows = []
    for label, group, key in (
        ("HWHM mean", "hwhm", "mean"),
        ("HWHM worst tenth", "hwhm", "worst_tenth"),
        ("HWHM worst region", "hwhm", "worst_region"),
        ("pos. error mean", "position_error", "mean"),
        ("pos. error worst tenth", "position_error", "worst_tenth"),
        ("blur mean", "blur", "mean"),
    ):
        before, after = start.metrics[group][key], best.metrics[group][key]
        rows.append(
            [label, f"{1e3 * before:.1f}", f"{1e3 * after:.1f}", f"{ratio(before, after):.2f}"]
        )
    if "noise_gain" in start.metrics:
        before, after = start.metrics["noise_gain"], best.metrics["noise_gain"]
        rows.append(
            ["noise gain / (mV/V)", f"{1e3 * before:.2f}", f"{1e3 * after:.2f}"]
            + [f"{after / before:.2f}"]
        )
    table = axes.table(
        rows,
        colLabels=["mm", "before", "after", "ratio"],
        colWidths=[0.52, 0.16, 0.16, 0.16],
        cellLoc="right",
        loc="center",
    )
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    table.scale(1, 1.5)


def save_scans(path: str | os.PathLike, found: Sequence[Scan]) -> None:
    """Write a picture: place error and images against the number of rows, and which they are."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 5.2), layout="constrained")
    figure.suptitle(f"{found[0].quality.layout.name}: electrodes to ground in a frame")
    figure.supxlabel(_SCAN_LEGEND, fontsize=8.5)
    contacts, images, which = figure.subplots(1, 3)
    counts = [len(scan.grounded) for scan in found]
    for label, key, style in (("mean", "mean", "o-"), ("worst tenth", "worst_tenth", "s--")):
        contacts.plot(
            counts, [1e3 * scan.metrics["place"][key] for scan in found], style, label=label
        )
    for label, group, key, style in (
        ("mean HWHM", "hwhm", "mean", "o-"),
        ("HWHM, worst tenth", "hwhm", "worst_tenth", "s-"),
        ("mean position error", "position_error", "mean", "d-"),
    ):
        values = [1e3 * scan.quality.metrics[group][key] for scan in found]
        images.plot(counts, values, style, label=label)
    contacts.set_ylabel("expected place error of a contact / mm")
    images.set_ylabel("width and position error of images / mm")
    for axes in (contacts, images):
        _by_rows(axes, counts)
    _ranks(which, found)
    save_figure(figure, path)


def _by_rows(axes, counts):
    """An axis of numbers of rows, with frames per second above it."""
    axes.set_xscale("log", base=2)
    axes.set_xticks(counts, [str(count) for count in counts])
    axes.minorticks_off()
    axes.set(xlabel="rows (grounded electrodes) in a frame", ylim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend()
    rate = axes.secondary_xaxis("top", functions=(_invert, _invert))
    rate.set_xticks([1 / count for count in counts], [f"{1e3 / count:.3g}" for count in counts])
    rate.minorticks_off()
    rate.set_xlabel("frames per second at 1 ms a row")


def _invert(x):
    return 1 / np.maximum(x, 1e-9)


def _ranks(axes, found):
    """Every electrode with the smallest scan that still grounds it."""
    layout = found[0].quality.layout
    smallest = np.zeros(layout.electrodes, int)
    for scan in sorted(found, key=lambda scan: -len(scan.grounded)):
        smallest[scan.grounded] = len(scan.grounded)
    draw_rim(axes, layout)
    for x, y, count in zip(*(1e3 * layout.positions.T), smallest):
        if not count:
            axes.plot(x, y, ".", color="0.6")
            continue
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
        axes.text(x, y, str(count), ha="center", va="center", fontsize=9, bbox=box)
    axes.set_title("rows of the smallest scan with this electrode", fontsize=10)

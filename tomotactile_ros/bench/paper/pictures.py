"""The figures of the article, drawn from what was computed: x to the right, y upwards, in mm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from tomotactile_ros.bench.paper.article import MODELS, REPORTED, SIDE
from tomotactile_ros.bench.paper.experiment import Image
from tomotactile_ros.bench.paper.simulation import Run, Spread, figures
from tomotactile_ros.evaluation.layout_quality import LayoutQuality
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.support.files import save_figure

_COLOURS = {
    "closed-form": "tab:blue",
    "fem": "tab:orange",
    "fem-inset": "tab:red",
    "point-nodes": "tab:green",
}


def save_spreads(path: Path, named: Sequence[tuple[str, dict[str, Spread]]], title: str) -> None:
    """Point spreads: one row for each layout, one column for each contact."""
    places = list(named[0][1])
    figure, axes = _sheets(
        len(named), len(places), (3.0 * len(places) + 1.2, 3.1 * len(named) + 0.9)
    )
    for row, (name, found) in zip(axes, named, strict=True):
        for each, (place, spread) in zip(row, found.items(), strict=True):
            shown = _image(each, spread.image, spread.layout, 1.0, "0.6")
            rows, columns = spread.image.shape
            across = 1e3 * SIDE * ((np.arange(columns) + 0.5) / columns - 0.5)
            along = 1e3 * SIDE * (0.5 - (np.arange(rows) + 0.5) / rows)
            each.contour(across, along, spread.image, [0.5], colors="white", linewidths=1.2)
            x, y = 1e3 * spread.centre
            rim = Circle((x, y), 1e3 * spread.hwhm, fill=False, color="white", linestyle=":")
            each.add_patch(rim)
            each.plot(x, y, "wx", markersize=7)
            each.plot(*(1e3 * spread.contact), "r+", markersize=9)
            each.set_title(f"{place}: {_merits(spread)}", fontsize=9)
        _name_row(row, name)
    figure.colorbar(shown, ax=list(axes.ravel()), label="reconstructed potential / its maximum")
    marks = (
        "+ contact, × centre of the image, line: half of the maximum, dots: HWHM about the centre"
    )
    figure.suptitle(f"{title}\n{marks}", fontsize=10)
    save_figure(figure, path)


def save_maps(path: Path, named: Sequence[tuple[str, LayoutQuality]], title: str) -> None:
    """Fig. 3A, B: maps of HWHM above, of position error below, one column for each layout."""
    figure, axes = _sheets(2, len(named), (2.6 * len(named) + 0.9, 6.0))
    both = {"HWHM": "hwhm_map", "position error": "position_error_map"}
    for row, (label, pick) in zip(axes, both.items(), strict=True):
        maps = [100 / SIDE * getattr(quality, pick) for _, quality in named]
        top = max(float(np.nanmax(each)) for each in maps)
        for each, values, (name, quality) in zip(row, maps, named, strict=True):
            image = _image(each, values, quality.layout, top)
            each.set_title(f"{name}\nmean {np.nanmean(values):.1f} %", fontsize=9)
        figure.colorbar(image, ax=list(row), label=f"{label} / % of the side")
    figure.suptitle(title, fontsize=11)
    save_figure(figure, path)


def save_steps(path: Path, runs: Sequence[Run]) -> None:
    """Fig. 3C, D: mean HWHM, worst region and mean position error after each update."""
    count = runs[0].count
    reported = REPORTED[count]
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    labels = "mean HWHM", "HWHM of the worst region", "mean position error"
    for column, (each, label) in enumerate(zip(figure.subplots(1, 3), labels, strict=True)):
        for run in runs:
            values = [figures(step)[column] for step in run.steps]
            each.plot(values, "o-", color=_COLOURS[run.model], label=MODELS[run.model])
        if column < 2:
            given = reported.equal[column], reported.optimized[column]
            each.plot([0, reported.best], given, "k*", markersize=10, label="article")
        each.set(xlabel="updates", ylabel="% of the side", xticks=range(reported.updates + 1))
        each.set_title(label, fontsize=10)
        each.set_ylim(0, 1.05 * each.get_ylim()[1])
        each.grid(color="0.9")
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    figure.suptitle(f"{count} × {count} electrodes")
    save_figure(figure, path)


def save_images(path: Path, named: Sequence[tuple[str, dict[str, Image]]]) -> None:
    """Fig. 4: potential images, one row for each layout; each image has colours of its own."""
    places = list(named[0][1])
    figure, axes = _sheets(
        len(named), len(places), (2.6 * len(places) + 0.5, 2.9 * len(named) + 0.4)
    )
    for row, (name, images) in zip(axes, named, strict=True):
        for each, (place, image) in zip(row, images.items(), strict=True):
            _image(each, image.potential, image.layout, float(np.nanmax(image.potential)), "0.6")
            for contact in image.scene.contacts:
                each.add_patch(Polygon(1e3 * contact.vertices, fill=False, color="red"))
                if contact.shape == "disc":  # too small to be seen
                    each.plot(*(1e3 * contact.centroid), "r+", markersize=9)
            single = image.hwhm is not None
            each.set_title(f"{place}\n{_merits(image)}" if single else place, fontsize=9)
        _name_row(row, name)
    figure.suptitle(
        "Reconstructed potential, from 0 (dark) to the maximum of each image; red: the conductors",
        fontsize=11,
    )
    save_figure(figure, path)


def _sheets(rows: int, columns: int, size: tuple[float, float]):
    """A figure, and axes in mm (rows, columns)."""
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for each in axes[-1]:
        each.set_xlabel("x / mm")
    for each in axes[:, 0]:
        each.set_ylabel("y / mm")
    return figure, axes


def _merits(found) -> str:
    return f"HWHM {100 / SIDE * found.hwhm:.1f} %, PE {100 / SIDE * found.error:.1f} %"


def _image(axes, values: np.ndarray, layout: Layout, top: float, rim: str = "black"):
    xmin, ymin, xmax, ymax = 1e3 * np.array(layout.outline.bounds)
    extent = xmin, xmax, ymin, ymax
    drawn = axes.imshow(values, extent=extent, origin="upper", cmap="viridis", vmin=0, vmax=top)
    for place in 1e3 * layout.positions:
        axes.add_patch(Circle(place, 1e3 * layout.radius, fill=False, color=rim, linewidth=0.7))
    axes.set(xlim=(xmin - 6, xmax + 6), ylim=(ymin - 6, ymax + 6), aspect="equal")
    return drawn


def _name_row(row, name: str) -> None:
    how = {"xycoords": "axes fraction", "rotation": 90, "va": "center", "ha": "right"}
    row[0].annotate(name, (-0.42, 0.5), **how)

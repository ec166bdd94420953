"""A pressure image as a figure with axes in mm, a colour bar in kPa and the contacts marked."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from tomotactile_ros.layouts.layout import Layout, check_layout
from tomotactile_ros.reconstruction.settings import DEFAULT_LAW, Result
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import save_figure
from tomotactile_ros.view.colours import LEAST_CONDUCTANCE, LEAST_PRESSURE
from tomotactile_ros.view.contact_lines import (
    contact_lines,
    numbers_of,
    stand_for_all,
    withheld_line,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_LINES = 6  # about contacts, below the picture
_TITLE = 62  # characters of a line of the title
_LINE_WIDTH = 88  # characters of a line about a contact


def plot(
    result: Result,
    layout: Layout,
    truth: Sequence[dict] | None = None,
    title: str = "",
    calibrated: bool | None = None,
) -> Figure:
    """The figure of what a `Pipeline` returned; save it with ``savefig``, a notebook shows it.

    Parameters
    ----------
    result : of `Pipeline.process`; where it withholds its contacts the title says why.
    layout : gives the frame and the electrodes.
    truth : what `Scene.truth` says, drawn as crosses; None where it is not known.
    title : above the picture.
    calibrated : whether a contact law gives pressures; otherwise colours are conductances.
        By default as the result says, but not where `truth` has contacts of which none has a
        force: bare conductors, which were estimated with the law that settings have by default.
    """
    checks.instance(result, "result", Result, "Pipeline.process gives one")
    check_layout(layout)
    if calibrated is None:
        forces = [contact.get("force") is not None for contact in truth or ()]
        calibrated = result.calibrated and (any(forces) or not forces)
    if result.calibrated and not calibrated:
        result = result.without_law(DEFAULT_LAW)
    shown = result.image, layout, result.contacts, truth, title, calibrated
    figure = pressure_figure(*shown, reason=result.reason, complete=result.complete)
    vars(figure)["_repr_png_"] = partial(_png, figure)  # what IPython asks for
    return figure


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=80, bbox_inches="tight")
    return buffer.getvalue()


def save_pressure(
    path: str | os.PathLike, pressure: np.ndarray, layout: Layout, *shown: Any, **more: Any
) -> None:
    """Write the figure of `pressure_figure` as PNG, SVG or PDF by its name; its folder is made."""
    figure = pressure_figure(pressure, layout, *shown, **more)
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    save_figure(figure, path, bbox_inches="tight", pad_inches=0.1)


def pressure_figure(
    pressure: np.ndarray,
    layout: Layout,
    contacts: Sequence = (),
    truth: Sequence[dict] | None = None,
    title: str = "",
    calibrated: bool = True,
    *,
    reason: str = "",
    trails: Sequence[np.ndarray] = (),
    complete: bool = True,
) -> Figure:
    """The figure.

    Parameters
    ----------
    pressure : (H, W) Pa, row 0 at the +y edge, NaN outside the outline; `Result.image` where nothing
        is calibrated.
    layout : gives the frame and the electrodes.
    contacts : estimates, strongest first, drawn as rings of their radius.
    truth : what `Scene.truth` says, drawn as crosses; None where it is not known.
    title : above the picture.
    calibrated : whether a contact law gives pressures; otherwise colours are conductances, S/m².
    reason : why contacts are withheld, below the title; empty: they are not.
    trails : (M, 2) m each, where contacts have been of late.
    complete : whether all was tried; else one contact may stand for all, drawn as a broken ring.
    """
    from matplotlib.figure import Figure

    xmin, ymin, xmax, ymax = (1e3 * side for side in layout.outline.bounds)
    figure = Figure(figsize=_size(xmax - xmin, ymax - ymin), layout="constrained")
    axes = figure.add_subplot()
    values, least, label = pressure / 1e3, LEAST_PRESSURE / 1e3, "pressure / kPa"
    if not calibrated:
        values, least, label = pressure, LEAST_CONDUCTANCE, "conductance / (S/m²)"
    image = axes.imshow(
        values,
        cmap="viridis",
        vmin=0.0,
        vmax=max(least, float(np.nanmax(values, initial=0.0))),
        extent=(xmin, xmax, ymin, ymax),
        origin="upper",
    )
    # a part of the map's axes: as high as the map, whatever its shape
    figure.colorbar(image, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), label=label)
    for ring in (layout.outline.shell, *layout.outline.holes):
        axes.plot(*(1e3 * np.vstack([ring, ring[:1]]).T), color="0.4", linewidth=1)
    axes.plot(
        *(1e3 * layout.positions.T), "o", color="white", markeredgecolor="0.5", markersize=3.5,
        clip_on=False, zorder=3, label="electrode",
    )  # fmt: skip
    for trail in trails:
        axes.plot(*(1e3 * trail.T), color="red", alpha=0.5, linewidth=1)
    _draw_contacts(axes, contacts, truth or (), complete)
    axes.set(xlabel="x / mm", ylabel="y / mm", xlim=(xmin, xmax), ylim=(ymin, ymax))
    lines = contact_lines(contacts, truth, calibrated, _LINE_WIDTH, complete)[:_MOST_LINES]
    if reason:
        lines = ["contacts are not known"]
        title = "\n".join([*filter(None, [title]), *wrap(withheld_line(reason), _TITLE)])
    if not calibrated:
        lines.append("no contact law: forces and pressures are not known")
    figure.supxlabel("\n".join(lines), fontsize=7.5, family="monospace")
    figure.suptitle(title, fontsize=11)
    axes.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), borderaxespad=0.2, ncols=3, frameon=False
    )
    return figure


def _size(width: float, height: float) -> tuple[float, float]:
    """Size of a figure, inches, whose map is `width` x `height`, with room for what is around
    it."""
    scale = min(5.6 / width, 4.8 / height)
    return max(4.5, width * scale + 1.6), max(2.5, height * scale + 1.9)


def _draw_contacts(axes: Axes, contacts: Sequence, truth: Sequence[dict], complete: bool) -> None:
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=3, foreground="white")]  # legible on every colour
    middle = [sum(limits) / 2 for limits in (axes.get_xlim(), axes.get_ylim())]
    if contacts:  # patches have boxes in a legend, this has a ring
        axes.plot([], [], "o", color="red", fillstyle="none", label="contact")
    style = "dashed" if stand_for_all(contacts, complete) else "solid"
    for number, contact in zip(numbers_of(contacts, complete), contacts, strict=True):
        x, y, radius = 1e3 * contact.x, 1e3 * contact.y, 1e3 * contact.radius
        axes.add_patch(Circle((x, y), radius, fill=False, color="red", linestyle=style))
        right, upper = x > middle[0], y > middle[1]  # the number stands towards the middle
        axes.annotate(
            str(number or "?"),
            (x - radius if right else x + radius, y - radius if upper else y + radius),
            ha="right" if right else "left", va="top" if upper else "bottom",
            color="red", weight="bold", path_effects=halo,
        )  # fmt: skip
    if truth:
        x, y = np.array([(t["x"], t["y"]) for t in truth]).T * 1e3
        axes.plot(x, y, "x", color="orange", label="true position")

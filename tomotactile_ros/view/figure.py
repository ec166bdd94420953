"""A pressure image as a PNG file with axes in mm, a colour bar in kPa and the contacts marked."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tomotactile_ros.errors import InputError
from tomotactile_ros.files import save_figure
from tomotactile_ros.layout import Layout
from tomotactile_ros.view.contacts import contact_lines

_MOST_LINES = 6  # about contacts, below the picture


def save_pressure(
    path: str | os.PathLike,
    pressure: np.ndarray,
    layout: Layout,
    contacts: Sequence = (),
    truth: Sequence[dict] | None = None,
    title: str = "",
) -> None:
    """Write the figure.

    Parameters
    ----------
    path : of the PNG file; its folder is made.
    pressure : (H, W) Pa, row 0 at the +y edge, NaN outside the outline.
    layout : gives the frame and the electrodes.
    contacts : estimates, strongest first, drawn as rings of their radius.
    truth : what `Scene.truth` says, drawn as crosses; None where it is not known.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    xmin, ymin, xmax, ymax = (1e3 * side for side in layout.outline.bounds)
    figure = Figure(figsize=(7.5, 6.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    image = axes.imshow(
        pressure / 1e3, cmap="viridis", vmin=0.0, extent=(xmin, xmax, ymin, ymax), origin="upper"
    )
    figure.colorbar(image, ax=axes, label="pressure / kPa")
    for ring in (layout.outline.shell, *layout.outline.holes):
        axes.plot(*(1e3 * np.vstack([ring, ring[:1]]).T), color="0.4", linewidth=1)
    axes.plot(
        *(1e3 * layout.positions.T), "o", color="white", markeredgecolor="0.5", markersize=3.5,
        clip_on=False, label="electrode",
    )  # fmt: skip
    _draw_contacts(axes, contacts, truth or ())
    axes.set(xlabel="x / mm", ylabel="y / mm", title=title)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.08), ncols=3, frameon=False)
    lines = contact_lines(contacts, truth)[:_MOST_LINES]
    figure.supxlabel("\n".join(lines), fontsize=7.5, family="monospace")
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    save_figure(figure, path, bbox_inches="tight", pad_inches=0.1)


def _draw_contacts(axes, contacts: Sequence, truth: Sequence[dict]) -> None:
    from matplotlib.patches import Circle

    if contacts:  # patches have boxes in a legend, this has a ring
        axes.plot([], [], "o", color="red", fillstyle="none", label="contact")
    for number, contact in enumerate(contacts, 1):
        x, y, radius = 1e3 * contact.x, 1e3 * contact.y, 1e3 * contact.radius
        axes.add_patch(Circle((x, y), radius, fill=False, color="red"))
        axes.annotate(str(number), (x + radius, y + radius), color="red")
    if truth:
        x, y = np.array([(t["x"], t["y"]) for t in truth]).T * 1e3
        axes.plot(x, y, "x", color="orange", label="true position")

"""The physics of the sheet: models that fill a `Transfer`, and what is computed from one."""

from collections.abc import Sequence

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.sheet_field import Anisotropy
from tomotactile_ros.sheet.closed_form import ClosedFormSheet
from tomotactile_ros.sheet.fem import FemSheet, Resistance
from tomotactile_ros.sheet.transfer import Sheet
from tomotactile_ros.support.errors import InputError

MODELS = ("auto", "fem", "closed_form")


def make_sheet(
    layout: Layout,
    model: str = "auto",
    *,
    resistance: Resistance | None = None,
    anisotropy: Anisotropy | None = None,
    lines: Sequence[np.ndarray] = (),
    shunting: bool = True,
    h: float | None = None,
    ring: int | None = None,
) -> Sheet:
    """The cheapest model of `layout` that can do what is asked, or the one that `model` names.

    Parameters
    ----------
    layout : Layout
    model : `auto` takes the closed form for a uniform rectangle and finite elements otherwise
    resistance : function of points (n, 2) -> (n,), sheet resistance, ohm/sq; uniform without it
    anisotropy : of the whole sheet; none without it
    lines : polylines (V, 2), m, that elements follow: where the resistance jumps
    shunting : electrodes as equipotentials; without it, points with a radius (Kojima et al. 2023)
    h : element size of the mesh, m
    ring : charges on the rim of each electrode, of the closed form; see `ClosedFormSheet`
    """
    if model not in MODELS:
        raise InputError(f"model: {model!r} is none of {', '.join(MODELS)}")
    even = resistance is None and anisotropy is None
    uniform = layout.outline.is_uniform_rectangle and even
    if model == "closed_form" and not even:
        raise InputError("model: the closed form needs a uniform sheet resistance; use model fem")
    if model == "closed_form" or (model == "auto" and uniform):
        return ClosedFormSheet(layout, shunting=shunting, ring=ring)
    return FemSheet(
        layout, h=h, shunting=shunting, resistance=resistance, anisotropy=anisotropy, lines=lines
    )

"""What the page for the browser is made of, without the page: shapes in space, tables, curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tomotactile_ros.support.checks import at_least
from tomotactile_ros.view.colours import palette
from tomotactile_ros.view.contact_lines import contact_lines, numbers_of, pair, stand_for_all

TILE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2.0
_SIDES = 32  # of a circle
_ANGLES = np.linspace(0.0, 2 * np.pi, _SIDES + 1)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
DISC = np.column_stack([_CIRCLE[:-1], np.zeros(_SIDES)])
_TABLE = "width:100%;font-size:0.8em;text-align:right;white-space:nowrap;border-spacing:0.3em 0"
_STROKES = ("#888888", "#ff801a", "#3d7dca", "#28c85a", "#b04fc4", "#c0a020")
MOST_CURVES = len(_STROKES) - 1  # beside that of all contacts

Forces = Sequence[tuple[float, dict[int, float]]]


def fan(corners: np.ndarray) -> np.ndarray:
    """(n - 2, 3) triangles of a convex polygon of (n, 3) corners."""
    last = np.arange(2, len(corners))
    return np.column_stack([np.zeros(len(last), int), last - 1, last])


def frames_of(cells: np.ndarray) -> np.ndarray:
    """(H, W, 3, 3) rotations of cells (H, W, 3) of an image: columns tangent, bitangent, normal."""
    height, width = cells.shape[:2]
    x = np.gradient(cells, axis=1) if width > 1 else np.broadcast_to([1.0, 0.0, 0.0], cells.shape)
    y = -np.gradient(cells, axis=0) if height > 1 else np.broadcast_to([0.0, 1.0, 0.0], cells.shape)
    normal = np.cross(x, y)
    frames = np.stack([x, np.cross(normal, x), normal], axis=-1)
    return frames / np.linalg.norm(frames, axis=-2, keepdims=True)


def rings(places: np.ndarray, frames: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """(n, 2, 3) segments of the ellipses root x, |x| = 1, roots (N, 2, 2), m, in the tangent planes of
    frames (N, 3, 3) at places (N, 3), m."""
    points = places[:, None] + np.einsum("nik,nkl,al->nai", frames[:, :, :2], roots, _CIRCLE)
    return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)


def roots_of(covariances: np.ndarray) -> np.ndarray:
    """(N, 2, 2) m: times their transposes they are the covariances (N, 2, 2), m²."""
    values, vectors = np.linalg.eigh(covariances)
    return vectors * np.sqrt(np.maximum(values, 0.0))[:, None]


def discs(radii: Sequence[float]) -> np.ndarray:
    """(N, 2, 2) m, what `rings` takes for circles."""
    return np.reshape(np.asarray(radii, float), (-1, 1, 1)) * np.eye(2)


def linear(rgb: Any) -> np.ndarray:
    """Colours 0 to 255 as light, 0 to 255: what viser takes where many shapes are drawn at once."""
    part = np.asarray(rgb) / 255.0
    light = np.where(part > 0.04045, ((part + 0.055) / 1.055) ** 2.4, part / 12.92)  # sRGB
    return np.rint(255.0 * light).astype(np.uint8)


def strength_of(contact: Any, calibrated: bool) -> float:
    """Force, N, or without a contact law conductance, µS."""
    return float(contact.force) if calibrated else 1e6 * float(contact.conductance)


def table_of(
    contacts: Sequence, truth: Sequence[dict] | None, calibrated: bool, complete: bool = True
) -> str:
    """Contacts as rows of an HTML table, beside the truth where it is known."""
    if stand_for_all(contacts, complete):
        return f"<div>{contact_lines(contacts, truth, calibrated, complete=complete)[0]}</div>"
    if not contacts and not truth:
        return "<div>no contact</div>"
    weighed = any(each["force"] is not None for each in truth or ())  # else bare conductors
    heads = ["", "x, y / mm", "± / mm", "N" if calibrated else "µS"]
    heads += ["off / mm"] if truth is not None else []
    heads += ["true N"] if weighed else []
    rows = []
    partners = pair(contacts, truth or ())
    for k, c, j in zip(numbers_of(contacts), contacts, partners, strict=True):
        spread = np.sqrt(max(c.position_covariance[0], c.position_covariance[3], 0.0))
        row = [f"<b>{k}</b>", f"{1e3 * c.x:.1f}, {1e3 * c.y:.1f}"]
        row += ["–" if np.isnan(spread) else f"{1e3 * spread:.2f}"]
        least = at_least(c.force_std) if calibrated else ""
        row += [f"{least}{strength_of(c, calibrated):.2f}"]
        if truth is not None:
            row += ["ghost", ""] if j is None else _beside(c, truth[j])
        rows.append(row[: len(heads)])
    for j, each in enumerate(truth or ()):
        if j not in partners:
            force = "" if each["force"] is None else f"{each['force']:.2f}"
            place = f"{1e3 * each['x']:.1f}, {1e3 * each['y']:.1f}"
            rows.append(["", place, "", "", "missed", force][: len(heads)])
    lines = ["".join(f"<th>{head}</th>" for head in heads)]
    lines += ["".join(f"<td>{cell}</td>" for cell in row) for row in rows]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f'<table style="{_TABLE}">{body}</table>'


def _beside(contact: Any, true: dict) -> list[str]:
    off = np.hypot(contact.x - true["x"], contact.y - true["y"])
    return [f"{1e3 * off:.1f}", "" if true["force"] is None else f"{true['force']:.2f}"]


def bar(most: str) -> str:
    """The colours from nothing to full scale."""
    stops = ",".join("#" + bytes(palette()[k]).hex() for k in range(0, 256, 51))
    return (
        f'<div style="height:0.6em;background:linear-gradient(to right,{stops})"></div>'
        f'<div style="display:flex;justify-content:space-between;font-size:0.8em">'
        f"<span>0</span><span>{most}</span></div>"
    )


def curves(
    recent: Forces, chosen: Sequence[int], calibrated: bool
) -> tuple[tuple[np.ndarray, ...], tuple[dict, ...]]:
    """Data and series of the plot: time, the sum, and each chosen contact."""
    recent = recent or [(0.0, {0: 0.0})]
    numbers = (0, *chosen)
    data = [np.array([t for t, _ in recent])]
    data += [np.array([each.get(number, np.nan) for _, each in recent]) for number in numbers]
    unit = "N" if calibrated else "µS"
    labels = [f"all, {unit}", *(f"contact {number}" for number in chosen)]
    drawn = [
        {"label": label, "stroke": stroke, "width": 2}
        for label, stroke in zip(labels, _STROKES, strict=False)
    ]
    return tuple(data), ({"label": "s"}, *drawn)

"""Images of points near an electrode, in its rim.

A floating electrode is an equipotential: beside it, the field of a source at y has an image of the other
sign within, at y* = y R^2 / |y|^2 about its centre. For sources outside a circle of radius R

    G(x, y) = -(R_s / 2 pi) (ln |x - y| - ln (|x - y*| |y| / R)) + what is smooth,
    (|x - y*| |y| / R)^2 = |x|^2 |y|^2 / R^2 - 2 x y + R^2

(the circle theorem; Milne-Thomson 1940). Linear elements round the second logarithm off as they do the
first. On the electrode both are the same: what the mesh has there is a logarithm about its centre.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tomotactile_ros.sheet.green import softened

if TYPE_CHECKING:
    from tomotactile_ros.sheet.fem import FemSheet


def image_excess(
    sheet: FemSheet,
    electrode: int,
    points: np.ndarray,
    radii: np.ndarray,
    corners: np.ndarray,
    weights: np.ndarray,
) -> np.ndarray:
    """(T, m, m) what the true logarithm of images in the rim of an electrode exceeds the mesh's by.

    Parameters
    ----------
    points : (T, m, 2) that discs of radii (m,) lie at, beside the electrode, m
    corners, weights : (T, m, 3) unknowns of their triangles, and parts
    """
    metric, count = sheet.metric, points.shape[1]
    centre, radius = metric.at(sheet.layout.positions[electrode]), metric.radius
    acts = metric.mean * radii
    mutual = np.add.outer(acts**2, acts**2) / 2
    true = softened(_squared(metric.at(points) - centre, radius), mutual)
    nodes = corners.reshape(len(points), -1)
    at = sheet.seen_at(nodes) - centre
    away = np.log(np.maximum(np.hypot(at[..., 0], at[..., 1]), radius))
    on = nodes == electrode
    there = 0.5 * np.log(np.maximum(_squared(at, radius), 1e-12 * radius**2))
    there = np.where(on[:, :, None], away[:, None, :], there)
    there = np.where(on[:, None, :], away[:, :, None], there)
    there = there.reshape(len(points), count, 3, count, 3)
    return 0.5 * np.log(true) - np.einsum("tia,tiajb,tjb->tij", weights, there, weights)


def _squared(at: np.ndarray, radius: float) -> np.ndarray:
    """(T, n, n) of points (T, n, 2) about the centre of a circle."""
    norm = (at**2).sum(axis=-1)
    product = at @ at.transpose(0, 2, 1)
    return np.asarray(norm[:, :, None] * norm[:, None, :] / radius**2 - 2 * product + radius**2)

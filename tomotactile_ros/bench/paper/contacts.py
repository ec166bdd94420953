"""What counts at the end: places, pairs and forces of contacts that are found with each layout.

Frames of the reference model, which shares nothing with the estimator's; see `bench.layouts`. Few
contacts, so that it takes a minute: they tell factors of two, not a tenth.
"""

from __future__ import annotations

from tomotactile_ros.bench.layouts import EVEN, Amount, measure, reference
from tomotactile_ros.layouts.layout import Layout

AMOUNTS = {4: Amount(12, 8, (0.04,)), 8: Amount(6, 4, (0.014,))}


def found(layout: Layout, count: int) -> dict:
    """Figures of the profile `accurate` on even sheets: place (mean, p95), m; force (median, p95);
    pairs, the part told apart."""
    (measured,) = measure(reference(layout, AMOUNTS[count]), ("accurate",))
    even = measured.figures[EVEN]
    return {
        "place": (even["mean"], even["p95"]),
        "force": tuple(even["force"]),
        "pairs": float(measured.told[0]),
    }

"""What the article says (sections 2.3 and 3), and the models in which it is computed again."""

from __future__ import annotations

from dataclasses import dataclass

SIDE = 0.2  # m; figures in % are of it


@dataclass(frozen=True)
class Reported:
    """Of N x N electrodes, in %: mean HWHM and worst region, of the equal grid and optimized.

    updates : of the optimization
    best : the update whose figures the article gives
    ratios : optimized over equal, of mean HWHM, of the worst region, and of the mean position
        error, of which the article gives no more than that
    """

    updates: int
    best: int
    equal: tuple[float, float]
    optimized: tuple[float, float]
    ratios: tuple[float, float, float]


REPORTED = {
    4: Reported(3, 3, (32.4, 38.8), (31.1, 31.4), (0.958, 0.81, 0.901)),
    8: Reported(5, 4, (17.3, 18.0), (16.6, 16.8), (0.960, 0.93, 0.949)),
}
EXPERIMENT = {"centre": (36.9, 29.7), "side": (28.7, 24.7), "corner": (16.7, 17.0)}  # HWHM, %
MODELS = {
    "closed-form": "closed form, electrodes as points with a radius",
    "fem": "finite elements, electrodes as discs of one potential",
    "fem-inset": "electrodes as discs, the outermost contacts 5 mm inside the rim",
    "point-nodes": "finite elements of a 40 × 40 Delaunay mesh, electrodes as single nodes",
}

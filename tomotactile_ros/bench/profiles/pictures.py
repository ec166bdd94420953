"""Wide contacts as they are and as each profile images them."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.bench.profiles.figures import covered
from tomotactile_ros.bench.trials import DRIVE


def draw(path, pipelines, data):
    """Truth and the image of each profile, one row for each shape, on one scale."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    shapes, grid = data["shapes"], next(iter(pipelines.values())).grid
    figure, axes = pyplot.subplots(
        len(shapes),
        1 + len(pipelines),
        figsize=(11, 2.6 * len(shapes)),
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    grounded = np.arange(next(iter(pipelines.values())).layout.electrodes)
    left, bottom, right, top = 1e3 * np.array(grid.outline.bounds)
    for row, (group, frame) in zip(axes, shapes.values()):
        true = group[0]["pressure"] / 1e3
        images = {"truth": true * covered(group[0], grid)}
        for profile, pipeline in pipelines.items():
            images[profile] = pipeline.process(frame, grounded, DRIVE).pressure / 1e3
        for axis, (name, image) in zip(row, images.items()):
            shown = axis.imshow(image, vmin=0, vmax=1.5 * true, extent=(left, right, bottom, top))
            axis.set_title(name)
        row[0].set_ylabel("y / mm")
        figure.colorbar(shown, ax=row, extend="max", label="pressure / kPa")
    for axis in axes[-1]:
        axis.set_xlabel("x / mm")
    figure.savefig(path, dpi=80)

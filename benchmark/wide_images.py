"""A picture of wide contacts as they are and as each profile images them.

    scripts/setup python3 benchmark/wide_images.py docs/images/reconstruction.png

A rectangle, an L and a ring that is cut open by 2 degrees, of 10 kPa, on `equal-8x8`; finite elements make
the frames, with 1 mV of noise and 12 bits.
"""

import sys

import numpy as np
from matplotlib.figure import Figure
from shapely import Polygon, contains_xy

from tomotactile_ros.bench.cases import DEFAULT_LAYOUT, PROFILES
from tomotactile_ros.bench.trials import DRIVE, make_scene
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.files import save_figure

LETTER = np.array([[-6, -6], [5, -6], [5, -3], [-3, -3], [-3, 5], [-6, 5]]) / 100
_TURN = np.radians(np.linspace(1, 359, 90))
_CIRCLE = np.column_stack([np.cos(_TURN), np.sin(_TURN)])
SHAPES = (
    {"shape": "rectangle", "center": (0.01, 0.005), "size": (0.08, 0.05)},
    {"shape": "polygon", "points": LETTER},
    {"shape": "polygon", "points": np.concatenate([0.06 * _CIRCLE, 0.04 * _CIRCLE[::-1]])},
)
PRESSURE = 10e3  # Pa


def main():
    (path,) = sys.argv[1:]
    layout = load_layout(DEFAULT_LAYOUT)
    figure = Figure(figsize=(11, 2.6 * len(SHAPES)), layout="constrained")
    axes = figure.subplots(len(SHAPES), 1 + len(PROFILES), sharex=True, sharey=True)
    pipelines = {name: Pipeline(layout, Settings(name)) for name in PROFILES}
    grid = pipelines["fast"].grid
    left, bottom, right, top = 1e3 * np.array(layout.outline.bounds)
    for row, shape in zip(axes, SHAPES, strict=True):
        contact = Contact(**shape, pressure=PRESSURE)
        frame = Simulator(layout, make_scene([contact])).frame(0.5)
        touched = contains_xy(Polygon(contact.vertices), *grid.centres.T).reshape(grid.shape)
        images = {"truth": PRESSURE * touched}
        for name, pipeline in pipelines.items():
            images[name] = pipeline.process(frame, layout.grounded, DRIVE).pressure
        for axis, (name, image) in zip(row, images.items(), strict=True):
            extent = (left, right, bottom, top)
            shown = axis.imshow(image / 1e3, vmin=0, vmax=1.5e-3 * PRESSURE, extent=extent)
            axis.set_title(name)
        row[0].set_ylabel("y / mm")
        figure.colorbar(shown, ax=row, extend="max", label="pressure / kPa")
    for axis in axes[-1]:
        axis.set_xlabel("x / mm")
    save_figure(figure, path)


if __name__ == "__main__":
    main()

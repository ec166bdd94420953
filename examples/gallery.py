#!/usr/bin/env python3
"""The same frame by every method: the profiles, eq. 1 of Kojima et al. 2023, GREIT and JAC.

    python3 examples/gallery.py --out gallery.png

The frame is one of `sample.npz`, a simulated recording of two discs on 64 electrodes; another file of
frames can be given.
"""

import argparse
from pathlib import Path

import numpy as np

import tomotactile_ros as tt

SAMPLE = Path(__file__).with_name(
    "sample.npz"
)  # tomotactile simulate --layout equal-8x8 --scene default --frames 8
PROFILES = ("fast", "balanced", "accurate")


def images(frames, layout):
    """Name, (H, W) image and contacts by each method, of the first frame."""
    frame = next(iter(frames))
    voltages, drive = frame.voltages, frame.drive_voltage
    for profile in PROFILES:
        pipeline = tt.Pipeline(layout, tt.Settings(profile, contact_law=frames.contact_law))
        result = pipeline.process(frame)
        yield f"{profile}: pressure / kPa", result.image / 1e3, result.contacts
    paper = tt.Pipeline(layout, tt.Settings("paper", contact_law=frames.contact_law))
    yield "paper: potential / V", paper.process(frame).potential, []
    yield "greit: no unit", tt.greit(voltages, layout, drive), []
    yield "jac: parts of the drive voltage", tt.jac(voltages, layout, drive), []


def main() -> None:
    from matplotlib.figure import Figure

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=Path, default=SAMPLE, help="recorded frames (.npz)")
    parser.add_argument("--layout", default="equal-8x8", help="a layout file or a shipped one")
    parser.add_argument("--out", default="gallery.png", help="picture to write")
    args = parser.parse_args()

    layout, frames = tt.load_layout(args.layout), tt.load_frames(args.frames)
    truth = frames.truth[0] if frames.truth else []
    figure = Figure(figsize=(12, 7.6), layout="constrained")
    extent = 1e3 * np.array(layout.outline.bounds)[[0, 2, 1, 3]]
    for axes, (name, image, contacts) in zip(figure.subplots(2, 3).flat, images(frames, layout)):
        shown = axes.imshow(image, extent=extent)
        figure.colorbar(shown, ax=axes, shrink=0.85)
        axes.set(title=name, xlim=extent[:2], ylim=extent[2:], xticks=[], yticks=[])
        for each in truth:
            axes.plot(1e3 * each["x"], 1e3 * each["y"], "x", color="orange")
        for contact in contacts:
            axes.plot(1e3 * contact.x, 1e3 * contact.y, "o", color="red", fillstyle="none")
        print(
            f"{name}: peak {np.nanmax(image):.3g}"
            + (f", {len(contacts)} contacts" if contacts else "")
        )
    figure.savefig(args.out, dpi=75)
    print(f"{args.out} written")


if __name__ == "__main__":
    try:
        main()
    except tt.InputError as error:
        raise SystemExit(f"gallery: {error}") from None

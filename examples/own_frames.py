#!/usr/bin/env python3
"""Images of readings that you already have as numpy arrays, from any sensor.

    python3 examples/own_frames.py --out contacts.png

What is needed: where the electrodes are, which electrode was grounded in each row, the voltages and
the drive voltage. `measured_frames` stands for your own data; replace it.
"""

import argparse

import numpy as np

import tomotactile_ros as tt

DRIVE = 3.3  # V, of the driving layer
ROW_PERIOD = 0.001  # s from one row to the next
WIDTH, HEIGHT = 0.3, 0.18  # m


def my_layout() -> tt.Layout:
    """A sheet of 300 mm x 180 mm with 10 x 6 electrodes, row by row from the lower left."""
    x, y = np.meshgrid(np.linspace(-0.13, 0.13, 10), np.linspace(-0.07, 0.07, 6))
    return tt.Layout(
        name="fabric-10x6",
        outline=tt.Outline.rectangle(WIDTH, HEIGHT),
        sheet_resistance=20e3,  # ohm/sq
        radius=0.0025,  # m, of an electrode
        positions=np.column_stack([x.ravel(), y.ravel()]),  # m, origin in the middle
    )


def measured_frames(layout: tt.Layout) -> tuple[np.ndarray, np.ndarray]:
    """Idle frames (N, E, E) and one pressed frame (E, E), V.

    Reading [l, n] is that of electrode n while electrode l was grounded. NaN marks what was not
    read. Here they are simulated.
    """
    finger = tt.Contact(shape="disc", center=(0.08, -0.03), radius=0.006)  # a bare conductor
    noise = tt.Noise(rms=0.001)
    idle = tt.Simulator(layout, tt.Scene("idle", DRIVE, noise=noise))
    pressed = tt.Simulator(layout, tt.Scene("finger", DRIVE, (finger,), noise=noise))
    return (
        np.stack([idle.frame(0.0, sequence) for sequence in range(10)]) + 0.004,  # V, an offset
        pressed.frame(0.0, 10) + 0.004,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", default="contacts.png", help="picture to write")
    args = parser.parse_args()

    layout = my_layout()
    print(f"{layout.name}: simulating and imaging takes some seconds", flush=True)
    idle, voltages = measured_frames(layout)
    grounded = np.arange(layout.electrodes)  # of each row
    pipeline = tt.Pipeline(layout, tt.Settings("balanced", noise=0.001))
    pipeline.tare((frame, grounded) for frame in idle)
    frame = tt.Frame(voltages, grounded, drive_voltage=DRIVE, row_period=ROW_PERIOD)
    result = pipeline.process(frame)
    if result.state != "valid":
        print(f"no contacts are reported: {result.reason}")
    for contact in result.contacts:  # forces need a calibration: docs/calibration.md
        print(f"contact at x {1e3 * contact.x:.1f} mm, y {1e3 * contact.y:.1f} mm")
    for electrode, why in result.faults.items():
        print(f"electrode {electrode} left out: {why}")
    tt.plot(result, layout, title=layout.name, calibrated=False).savefig(args.out)
    print(f"{args.out} written")


if __name__ == "__main__":
    try:
        main()
    except tt.InputError as error:
        raise SystemExit(f"own_frames: {error}") from None

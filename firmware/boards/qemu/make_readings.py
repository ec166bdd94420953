#!/usr/bin/env python3
"""Writes readings.h, the table that stands for the sheet on the QEMU board.

    make_readings.py out.h --random 8 --frames 16         each reading drawn from its place
    make_readings.py out.h --layout equal-4x4 --scene default

The first needs nothing but Python, the second the package: frames that its simulator makes.
"""

from __future__ import annotations

import argparse
import zlib

RANGE, BITS = 3.3, 12


def random_table(electrodes: int, frames: int) -> list[list[list[int]]]:
    """Readings (frames, electrodes, electrodes) in counts of 16 bits: a checksum of their place."""
    return [
        [
            [zlib.crc32(b"%d %d %d" % (frame, row, electrode)) & 0xFFFE for electrode in range(electrodes)]
            for row in range(electrodes)
        ]
        for frame in range(frames)
    ]  # fmt: skip


def simulated_table(layout: str, scene: str, frames: int) -> list[list[list[int]]]:
    """Readings of simulated frames in counts; the grounded electrode reads 0."""
    import numpy as np

    from tomotactile_ros.layouts.layout import load_layout
    from tomotactile_ros.scenes.scene import load_scene
    from tomotactile_ros.simulation import Simulator

    simulator = Simulator(load_layout(layout), load_scene(scene))
    voltages = np.array([simulator.frame(frame / 10.0, frame) for frame in range(frames)])
    counts = np.round(np.nan_to_num(voltages) * 2**BITS / RANGE)
    return np.clip(counts, 0, 2**BITS - 1).astype(int).tolist()


def header(table: list[list[list[int]]], bits: int, zero: int, address: int) -> str:
    """The C header of a table."""
    rows = ["{{{}}}".format(", ".join(map(str, row))) for frame in table for row in frame]
    electrodes = len(table[0])
    frames = [
        "{" + ",\n ".join(rows[at : at + electrodes]) + "}"
        for at in range(0, len(rows), electrodes)
    ]
    return "\n".join(
        [
            "/* Made by make_readings.py. */",
            f"#define TABLE_ELECTRODES {electrodes}",
            f"#define TABLE_FRAMES {len(table)}u",
            f"#define TABLE_BITS {bits}",
            f"#define TABLE_ZERO {zero}",
            f"#define TABLE_ADDRESS {address}",
            f"#define TABLE_SCALE {RANGE / 2**bits!r}f",
            f"#define TABLE_DRIVE_VOLTAGE {RANGE!r}f",
            "#define TABLE_TEMPERATURE 23.5f",
            "static const uint16_t table[TABLE_FRAMES][TABLE_ELECTRODES][TABLE_ELECTRODES] = {",
            ",\n".join(frames),
            "};",
            "",
        ]
    )


def main() -> None:
    """Write the file that the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out")
    parser.add_argument("--random", type=int, metavar="ELECTRODES", help="any reading, 16 bits")
    parser.add_argument("--layout", default="equal-4x4")
    parser.add_argument("--scene", default="default")
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--zero", type=int, default=0, help="counts that mean 0 V")
    parser.add_argument("--address", type=int, default=0, help="of the device on a bus")
    options = parser.parse_args()
    if options.random:
        table, bits = random_table(options.random, options.frames), 16
    else:
        table, bits = simulated_table(options.layout, options.scene, options.frames), BITS
    with open(options.out, "w", encoding="utf-8") as file:
        file.write(header(table, bits, options.zero, options.address))


if __name__ == "__main__":
    main()

# ruff: noqa: N999 - the name of the command; modules of commands are imported by name
"""`tomotactile import`: readings of other programs (CSV, TSV, .mat, .npy, rosbag2) as frames."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from tomotactile_ros.frames_file import DEFAULT_DRIVE
from tomotactile_ros.importer.frames import import_frames
from tomotactile_ros.importer.leading import TIME_UNITS
from tomotactile_ros.importer.orders import ORDERS
from tomotactile_ros.importer.units import UNITS
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.support.files import check_out

HELP = "make frames of readings in a CSV, TSV, .mat or .npy file, or a bag of arrays"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "readings", help="file: .csv, .tsv, .txt, .dat, .mat, .npy, .npz, or a rosbag2"
    )
    parser.add_argument("--layout", required=True, help="layout file or name of an installed one")
    parser.add_argument("--out", required=True, help="frames to write (.npz)")
    parser.add_argument(
        "--axes",
        metavar="NLE",
        help="frames (N), rows (L) and electrodes (E) in the order of the indices, the slowest first "
        "(default: guessed)",
    )
    parser.add_argument(
        "--grounded", type=int, nargs="+", metavar="E", help="electrode of each row, from 0"
    )
    parser.add_argument("--order", choices=ORDERS, help="of the measurements of this library")
    parser.add_argument("--rotate-meas", action="store_true", help="as its option of this name")
    parser.add_argument("--unit", choices=UNITS, help="of readings (default: guessed)")
    parser.add_argument("--bits", type=int, help="of the converter, for counts")
    parser.add_argument("--full-scale", type=float, help="V of it (default: the drive voltage)")
    parser.add_argument(
        "--missing", nargs="+", default=[], metavar="X", help="what stands for a missing reading"
    )
    parser.add_argument(
        "--variable", help="name of the array in a file of several, or topic of a bag"
    )
    parser.add_argument(
        "--drive-voltage", type=float, default=DEFAULT_DRIVE, help=f"V (default: {DEFAULT_DRIVE})"
    )
    parser.add_argument("--row-period", type=float, help="s from row to row")
    parser.add_argument("--rate", type=float, help="frames/s")
    parser.add_argument("--time-unit", choices=TIME_UNITS, help="of a column of times")


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    check_out(args.out, ".npz")
    imported = import_frames(
        args.readings,
        layout,
        axes=args.axes,
        grounded=args.grounded,
        order=args.order,
        rotated=args.rotate_meas,
        unit=args.unit,
        bits=args.bits,
        full_scale=args.full_scale,
        missing=args.missing,
        variable=args.variable,
        drive_voltage=args.drive_voltage,
        row_period=args.row_period,
        rate=args.rate,
        time_unit=args.time_unit,
    )
    print(f"{args.readings}:")
    for line in imported.told:
        print(f"  {line}")
    imported.save(args.out)
    print(f"{args.out}: {len(imported.frames.voltages)} frames of {layout.name}")

"""`tomotactile conform`: which rules of the wire protocol a device keeps, and which it breaks."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from tomotactile_ros.devices.conformance import BROKEN, KEPT, Broken, LineFault, check
from tomotactile_ros.devices.line import open_line
from tomotactile_ros.support.errors import InputError

HELP = "check whether a device keeps to the wire protocol (docs/protocol.md)"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("port", help="/dev/tty..., usb:VID:PID, socket:// or rfc2217://HOST:PORT")
    parser.add_argument("--baud", type=int, default=2_000_000, help="bit/s (default: 2000000)")
    parser.add_argument("--address", type=int, default=0, help="on a bus, 1 to 254 (default: none)")


def run(args: Namespace) -> int:
    if not 0 <= args.address <= 254:
        raise InputError(f"--address: {args.address}, expected 0 (none) to 254")
    if not 1 <= args.baud <= 50_000_000:
        raise InputError(f"--baud: {args.baud} is no bit rate")
    counts: dict[str, int] = {}
    version = 0
    try:
        line = open_line(args.port, args.baud)
        try:
            for verdict in check(line, args.address):
                if verdict.version != version:
                    version = verdict.version
                    print(f"version {version}")
                remark = f": {verdict.remark}" if verdict.remark else ""
                print(f"  {verdict.result:<9}  {verdict.rule}{remark}", flush=True)
                counts[verdict.result] = counts.get(verdict.result, 0) + 1
        finally:
            line.close()
    except (LineFault, Broken) as error:
        raise InputError(str(error).removeprefix("port: ")) from None
    print(", ".join(f"{count} {result}" for result, count in counts.items()))
    return 1 if counts.get(BROKEN) or not counts.get(KEPT) else 0

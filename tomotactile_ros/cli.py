"""The command `tomotactile`: everything that the package does, without ROS."""

from __future__ import annotations

import importlib
import os
import sys

from tomotactile_ros.command_line import Parser, end_of_pipe, stop_like_ctrl_c
from tomotactile_ros.errors import InputError

COMMANDS = (
    "simulate",
    "reconstruct",
    "evaluate",
    "layout",
    "optimize",
    "calibrate",
    "inspect",
    "bench",
)


def main(argv: list[str] | None = None) -> int:
    """Run one command; 0 when it worked, 2 for bad input with one line on stderr."""
    sys.stdout.reconfigure(errors="replace")  # a terminal that knows no µ or · shows a ?
    # blocks of a hundred unknowns: threads of the linear algebra only wait for each other
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    parser = Parser(prog="tomotactile", description=__doc__)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in COMMANDS:
        module = importlib.import_module(f"tomotactile_ros.commands.{name}")
        command = commands.add_parser(name, help=module.HELP, description=module.HELP)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    args = parser.parse_args(argv)
    try:
        stop_like_ctrl_c()
        status = args.run(args) or 0
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        return end_of_pipe()
    except MemoryError:
        print(f"tomotactile {args.command}: there is not enough memory for this", file=sys.stderr)
        return 2
    except (InputError, OSError) as error:
        print(f"tomotactile {args.command}: {_one_line(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"tomotactile {args.command}: stopped", file=sys.stderr)
        return 130


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(main())

# PYTHON_ARGCOMPLETE_OK
"""The command `tomotactile`: everything that the package does, without ROS."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from tomotactile_ros import __version__
from tomotactile_ros.support.command_line import Parser, end_of_pipe, say_doubts, stop_like_ctrl_c
from tomotactile_ros.support.errors import InputError

COMMANDS = (
    "play",
    "run",
    "view",
    "watch",
    "record",
    "tare",
    "simulate",
    "replay",
    "conform",
    "emulate",
    "import",
    "reconstruct",
    "calibrate",
    "learn",
    "inspect",
    "layout",
    "optimize",
    "evaluate",
    "paper",
    "bench",
)


def main(argv: list[str] | None = None) -> int:
    """Run one command; 0 when it worked, 2 for bad input with one line on stderr."""
    sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr] # a terminal that knows no µ or · shows a ?
    # blocks of a hundred unknowns: threads of the linear algebra only wait for each other
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    nodes = os.environ.get("TOMOTACTILE_NODES", "")  # that scripts/tomotactile starts as well
    also = f"nodes, each with a --help of its own: {nodes}" if nodes else ""
    parser = Parser(prog="tomotactile", description=__doc__, epilog=also)
    parser.also = f"; {also}" if also else ""
    parser.add_argument("--version", action="version", version=f"tomotactile {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in _wanted(sys.argv[1:] if argv is None else argv):
        module = importlib.import_module(f"tomotactile_ros.commands.{name}")
        command = commands.add_parser(name, help=module.HELP, description=module.HELP)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    with suppress(ImportError):
        import argcomplete

        argcomplete.autocomplete(parser)
    args, unknown = parser.parse_known_args(argv)
    if unknown:
        commands.choices[args.command].refuse(unknown)
    say_doubts(f"tomotactile {args.command}")
    try:
        stop_like_ctrl_c()
        from tomotactile_ros.support.files import (
            check_inputs_stay,
        )  # brings numpy, which reads OMP_NUM_THREADS

        check_inputs_stay(vars(args))
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


def _wanted(argv: list[str]) -> Sequence[str]:
    """The command that is named, so that no other has to be imported; all where none is."""
    words = os.environ["COMP_LINE"].split()[1:] if "COMP_LINE" in os.environ else argv
    return words[:1] if words and words[0] in COMMANDS else COMMANDS


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(main())

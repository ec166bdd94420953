"""The command `tomotactile`: everything that the package does, without ROS."""

from __future__ import annotations

import argparse
import importlib
import sys

from tomotactile_ros.errors import InputError

COMMANDS = ("simulate", "reconstruct", "evaluate", "optimize", "calibrate", "inspect", "bench")


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        self.exit(2, f"{self.prog}: {message} (try --help)\n")


def main(argv: list[str] | None = None) -> int:
    """Run one command; 0 when it worked, 2 for bad input with one line on stderr."""
    parser = _Parser(prog="tomotactile", description=__doc__)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in COMMANDS:
        module = importlib.import_module(f"tomotactile_ros.commands.{name}")
        command = commands.add_parser(name, help=module.HELP, description=module.HELP)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    args = parser.parse_args(argv)
    try:
        return args.run(args) or 0
    except (InputError, OSError) as error:
        print(f"tomotactile {args.command}: {_one_line(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"tomotactile {args.command}: stopped", file=sys.stderr)
        return 130


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(main())

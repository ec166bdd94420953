"""`tomotactile optimize`: better electrode positions, as a layout file with a picture beside it."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace

from tomotactile_ros.optimizer.jobs import Move, job_of
from tomotactile_ros.optimizer.options import OPTIONS, Option
from tomotactile_ros.support.progress import Progress

HELP = "optimize where the electrodes are, or which of them to ground"


def add_arguments(parser: ArgumentParser) -> None:
    for option in OPTIONS:
        _add_option(parser, option)


def _add_option(parser: ArgumentParser, option: Option) -> None:
    """An option of the table as the parser has it."""
    how: dict = {"help": option.help[0].lower() + option.help[1:]}
    if option.kind is bool:
        how["action"] = "store_true"
    else:
        how |= {"type": option.kind, "default": option.default}
        if option.choices:
            how["choices"] = option.choices
        if option.several:
            how |= {"nargs": "+", "metavar": "N"}
        if option.metavar:
            how |= {"nargs": len(option.metavar), "metavar": option.metavar}
        if option.repeated:
            how |= {"action": "append", "default": list(option.default)}
        if option.name == "out":
            how["required"] = True
    parser.add_argument("--" + option.name.replace("_", "-"), **how)


def run(args: Namespace) -> None:
    job = job_of(vars(args), "--")
    moves = isinstance(job, Move)
    if moves and not args.layout and args.size is None:
        a, b = job.start.outline.size
        print(f"tomotactile optimize: no --size, taken as {a:g} m x {b:g} m", file=sys.stderr)
    try:
        with Progress(job.label, job.total) as progress:
            for stage in job.stages():
                progress.update(stage.done, stage.note)
    except KeyboardInterrupt:
        if not job.has_result:
            on = "; --resume, with the same options, goes on" if moves else ""
            print(f"no step was finished: nothing is written{on}", file=sys.stderr)
            raise
    finally:
        job.work.stop()
    for line in job.write():
        print(line)

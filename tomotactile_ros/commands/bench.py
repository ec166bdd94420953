"""`tomotactile bench`: the measured trade of speed for accuracy, stability, peers and growth of cost."""

from __future__ import annotations

import json
from pathlib import Path

from tomotactile_ros.errors import InputError

HELP = "measure speed, accuracy and stability on this machine"


def add_arguments(parser):
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--quick", action="store_true", help="a representative part (the default)")
    mode.add_argument("--full", action="store_true", help="everything with everything")
    parser.add_argument("--out", default="out/bench.json", help="file to write, plots beside it")
    parser.add_argument("--readme", help="document whose measured figures are rewritten")
    parser.add_argument("--from", dest="source", help="take this result instead of measuring")


def run(args):
    from tomotactile_ros.bench import plots, readme, report
    from tomotactile_ros.bench.machine import use_one_thread
    from tomotactile_ros.bench.run import measure
    from tomotactile_ros.yamlio import plain, write_atomic

    if args.source:
        result = load(args.source)
    else:
        use_one_thread()
        out = Path(args.out)
        out.parent.mkdir(parents=True, exist_ok=True)
        result = plain(measure("full" if args.full else "quick"))
        write_atomic(out, json.dumps(result, indent=1, allow_nan=False).encode())
        plots.save_front(out.with_name(f"{out.stem}-front.png"), result)
        plots.save_growth(out.with_name(f"{out.stem}-growth.png"), result)
    print("\n".join(report.lines(result)))
    if not args.source:
        print(f"\n{out}, with {out.stem}-front.png and {out.stem}-growth.png beside it")
    if args.readme:
        readme.rewrite(args.readme, result)
        print(f"{args.readme}: figures rewritten")


def load(path):
    """A result as it was written; InputError for any other file."""
    from tomotactile_ros.bench.run import FORMAT

    try:
        result = json.loads(Path(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(result, dict) or result.get("format") != FORMAT:
        raise InputError(f"{path}: not a result of `tomotactile bench` ({FORMAT})")
    return result

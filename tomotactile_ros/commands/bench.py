"""`tomotactile bench`: the measured trade of speed for accuracy, stability, peers and growth of
cost."""

from __future__ import annotations

import json
import shutil
from math import inf
from pathlib import Path

from tomotactile_ros.bench.sensor import TITLES
from tomotactile_ros.support.errors import InputError

HELP = "measure speed, accuracy and stability on this machine"


def add_arguments(parser):
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument(
        "--compare", nargs=2, metavar=("A", "B"), help="are the ratios in two results the same?"
    )
    mode.add_argument(
        "--parts",
        nargs="+",
        choices=(*TITLES, "stability"),
        help="only these parts on sensors that are not ideal: every press with its ghosts, misses, "
        "place and force; or the limits of stability",
    )
    parser.add_argument(
        "--methods",
        nargs="+",
        default=[],
        metavar="MODULE:FUNCTION",
        help="with --parts: other reconstructions beside the profiles: a function that takes a layout "
        "and returns them by name",
    )
    parser.add_argument(
        "--out",
        help="file to write, a plot beside it (default: out/bench.json, with --parts "
        "out/bench-parts.json)",
    )
    parser.add_argument("--readme", help="document whose measured figures are rewritten")


def run(args):
    """0; 1 where two results differ."""
    if args.compare:
        return _compare(*map(load, args.compare))
    if args.methods and not args.parts:
        raise InputError("--methods: belongs to --parts, which is missing")
    if args.readme and args.parts:
        raise InputError("--readme: its figures are not those of --parts")
    from tomotactile_ros.bench import plots, report, run
    from tomotactile_ros.bench.machine import use_one_thread
    from tomotactile_ros.bench.sensor.trial import find_methods, profiles
    from tomotactile_ros.support.files import check_out, write_atomic

    if args.readme:
        report.check(args.readme)  # before anything is measured
    use_one_thread()
    out = Path(args.out or ("out/bench-parts.json" if args.parts else "out/bench.json"))
    out.parent.mkdir(parents=True, exist_ok=True)
    check_out(out, ".json")
    todo = run.parts(args.parts or (), [profiles, *map(find_methods, args.methods)])
    kept = out.with_suffix(".part")
    result = {
        "format": run.FORMAT_OF_PARTS if args.parts else run.FORMAT,
        **run.measure(todo, kept, args.methods),
    }
    write_atomic(out, json.dumps(result, indent=1, allow_nan=False).encode())
    if not args.parts:
        plots.save_front(out.with_name(f"{out.stem}-front.png"), result)
    kept.unlink(missing_ok=True)
    width = shutil.get_terminal_size((0, 0)).columns or inf
    print("\n".join(report.lines(result, width)))
    print(f"\n{out}" + ("" if args.parts else ", with a plot of the front beside it"))
    if args.readme:
        report.rewrite(args.readme, result)
        print(f"{args.readme}: figures rewritten")
    return 0


def load(path):
    """A result as it was written; InputError for any other file."""
    from tomotactile_ros.bench.run import FORMAT

    try:
        result = json.loads(Path(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON: {error}") from None
    found = result.get("format") if isinstance(result, dict) else None
    if found != FORMAT:
        was = "is missing" if found is None else f"{found!r} is of another version"
        raise InputError(f"{path}: format: {was}, `tomotactile bench` reads {FORMAT}")
    return result


def _compare(one, other):
    from tomotactile_ros.bench import compare

    print("\n".join(compare.lines(one, other)))
    return 0 if compare.agree(one, other) else 1

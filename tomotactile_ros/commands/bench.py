"""`tomotactile bench`: the measured trade of speed for accuracy, stability, peers and growth of
cost."""

from __future__ import annotations

import json
import shutil
import sys
from math import inf
from pathlib import Path

from tomotactile_ros.support.errors import InputError

HELP = "measure speed, accuracy and stability on this machine"


def add_arguments(parser):
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--from", dest="source", help="take this result instead of measuring")
    mode.add_argument(
        "--compare", nargs=2, metavar=("A", "B"), help="are the ratios in two results the same?"
    )
    mode.add_argument(
        "--parts",
        nargs="+",
        choices=(
            "time",
            "channels",
            "sheets",
            "layouts",
            "crowd",
            "wide",
            "wide-channels",
            "stability",
        ),
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
    args.out = args.out or ("out/bench-parts.json" if args.parts else "out/bench.json")
    if args.parts:
        return _measure_parts(args)
    from tomotactile_ros.bench import report

    if args.readme:
        report.check(args.readme)  # before anything is measured
    result = load(args.source) if args.source else _measure(args)
    width = shutil.get_terminal_size((0, 0)).columns or inf
    print("\n".join(report.lines(result, width)))
    if not args.source:
        print(f"\n{args.out}, with a plot of the front beside it")
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


def _measure_parts(args):
    """Tables of single parts; the file has the same rows."""
    from tomotactile_ros.bench import extremes as limits
    from tomotactile_ros.bench import report
    from tomotactile_ros.bench.machine import use_one_thread
    from tomotactile_ros.bench.sensor import tables
    from tomotactile_ros.bench.sensor.parts import measure
    from tomotactile_ros.bench.sensor.trial import find_methods, profiles
    from tomotactile_ros.support.files import check_out, write_atomic
    from tomotactile_ros.support.yamlio import plain

    use_one_thread()
    out = Path(args.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    check_out(out, ".json")
    methods = [profiles, *map(find_methods, args.methods)]
    found, extremes = {}, []
    for part in dict.fromkeys(args.parts):
        print(f"{part} ...", file=sys.stderr, flush=True)
        if part == "stability":
            extremes = list(limits.run())
        else:
            found[part] = measure(part, methods=methods)
    content = {"format": "tomotactile-bench-parts/1", "sensor": plain(found)}
    if extremes:
        content["stability"] = plain(extremes)
    write_atomic(out, json.dumps(content, indent=1, allow_nan=False).encode())
    width = shutil.get_terminal_size((0, 0)).columns or inf
    if found:
        print("\n".join(tables.text(found, width)))
    if extremes:
        print("\n".join(report.stability_lines(extremes, width)))
    print(f"\n{out}", file=sys.stderr)
    return 0


def _measure(args):
    from tomotactile_ros.bench import plots
    from tomotactile_ros.bench.machine import use_one_thread
    from tomotactile_ros.bench.run import Store, measure, parts
    from tomotactile_ros.support.files import check_out, write_atomic
    from tomotactile_ros.support.yamlio import plain

    use_one_thread()
    out = Path(args.out)
    out.parent.mkdir(parents=True, exist_ok=True)
    check_out(out, ".json")
    store = Store(out.with_suffix(".part.json"))
    count = len(list(parts()))
    if store.parts:
        print(
            f"{store.path}: continued, {len(store.parts)} of {count} parts are done",
            file=sys.stderr,
        )
    elif store.path.exists():
        print(
            f"{store.path}: was measured with other code or on another machine: starting over",
            file=sys.stderr,
        )
    store.save()  # a folder that takes no file is told now, not after the first part
    try:
        result = plain(measure(store))
    except KeyboardInterrupt:
        print(
            f"{store.path}: keeps what is done, {len(store.parts)} of {count} parts; "
            "the same command goes on from there",
            file=sys.stderr,
        )
        raise
    write_atomic(out, json.dumps(result, indent=1, allow_nan=False).encode())
    plots.save_front(out.with_name(f"{out.stem}-front.png"), result)
    store.remove()
    return result


def _compare(one, other):
    from tomotactile_ros.bench import compare

    print("\n".join(compare.lines(one, other)))
    return 0 if compare.agree(one, other) else 1

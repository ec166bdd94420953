"""`tomotactile optimize`: better electrode positions, as a layout file with a picture beside it."""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser, Namespace
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from tomotactile_ros import checks
from tomotactile_ros.commands.layout import DEFAULT_SIZE, add_grid, insist_on_usual_size
from tomotactile_ros.errors import InputError
from tomotactile_ros.evaluation.point_spread import LEAST_REGULARIZATION, MOST_CELLS, RESOLUTION
from tomotactile_ros.files import YAML, check_out, check_picture
from tomotactile_ros.layout import load_layout
from tomotactile_ros.optimizer.grounding import scans
from tomotactile_ros.optimizer.objective import DEFAULT_AIMS
from tomotactile_ros.optimizer.request import METHODS, Request, start_layout
from tomotactile_ros.optimizer.step import best_of, finished, ratio
from tomotactile_ros.optimizer.workers import Workers
from tomotactile_ros.progress import Progress, track

HELP = "optimize where the electrodes are, or which of them to ground"

_ALIASES = {"paper": "equalize"}
_RECORDED = (  # options that decide what comes out
    "rows",
    "cols",
    "size",
    "layout",
    "method",
    "radius",
    "sheet_resistance",
    "unusual_size",
    "steps",
    "regularization",
    "resolution",
    "spacing",
    "margin",
    "keep_out",
    "asymmetric",
    "aims",
    "scenes",
    "starts",
    "seed",
)


def add_arguments(parser: ArgumentParser) -> None:
    add_grid(parser)
    parser.add_argument("--layout", help="start from this layout instead of an equal grid")
    parser.add_argument(
        "--method",
        choices=(*METHODS, "grounding"),
        type=lambda name: _ALIASES.get(name, name),
        required=True,
        help="equalize: the paper's; free: least blur; grounding: which electrodes to ground",
    )
    parser.add_argument("--out", required=True, help="layout file (.yaml) to write")
    parser.add_argument("--report", help="picture (.png) to write (default: beside the layout)")
    parser.add_argument("--name", help="of the layout (default: that of the file)")
    parser.add_argument("--radius", type=float, help="of an electrode, m")
    parser.add_argument("--sheet-resistance", type=float, default=1e4, help="ohm/sq")
    parser.add_argument(
        "--steps",
        type=int,
        help="updates of equalize (default: 5), or generations of evolution at the end of free "
        "(default: none on rectangles, 30 on other outlines)",
    )
    parser.add_argument("--regularization", type=float, default=1000.0, help="lambda^2")
    parser.add_argument(
        "--resolution",
        type=int,
        default=RESOLUTION,
        help="contact positions along the longer side (default: 40)",
    )
    parser.add_argument("--spacing", type=float, help="smallest distance of two centres, m")
    parser.add_argument("--margin", type=float, default=0.0, help="from the rim to a centre, m")
    parser.add_argument(
        "--keep-out",
        type=float,
        nargs=3,
        action="append",
        default=[],
        metavar=("X", "Y", "R"),
        help="disc without electrode centres, m; may be repeated",
    )
    parser.add_argument(
        "--asymmetric", action="store_true", help="move every electrode on its own (slow)"
    )
    parser.add_argument(
        "--aims",
        type=float,
        nargs=4,
        metavar=("MEAN", "WORST", "ERROR", "OTHER"),
        help="of free, relative to the start: mean HWHM, worst tenth, mean position error, "
        "and position error at lambda^2 / 10 and * 10 (default: 0.8 0.8 0.72 1.0)",
    )
    parser.add_argument(
        "--scenes",
        type=float,
        metavar="AIM",
        help="of free: count the blur of scenes with two and with wide contacts too, with this "
        "aim relative to the start, for instance 0.9",
    )
    parser.add_argument("--starts", type=int, help="of free: layouts to start from (default: 8)")
    parser.add_argument("--seed", type=int, default=0, help="of the free search")
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="processes of the free search"
    )
    parser.add_argument(
        "--conditions",
        type=int,
        nargs="+",
        help="numbers of ground conditions to compare (default: all down to 4 by halves)",
    )

    parser.set_defaults(default_of=parser.get_default)


def run(args: Namespace) -> None:
    start = _given_layout(args) if args.layout else _grid(args)
    report = args.report or Path(args.out).with_suffix(".png")
    check_out(args.out, *YAML)
    check_picture(report)
    if args.method == "grounding":
        _choose_grounding(args, start, report)
    else:
        _move_electrodes(args, start, report)


def _move_electrodes(args, start, report):
    from tomotactile_ros.optimizer.report import save_report

    request = _request(args, start)
    if not args.layout and args.size is None:
        a, b = start.outline.size
        print(f"tomotactile optimize: no --size, taken as {a:g} m x {b:g} m", file=sys.stderr)
    try:
        history, best = _search(args, request)
    except KeyboardInterrupt:
        print("no step was finished: nothing is written", file=sys.stderr)
        raise
    name = args.name or Path(args.out).stem
    settings = {"command": _command(args)} | request.settings()
    finished(best.layout, name, args.method, settings, history, best).save(args.out)
    title = f"{start.name} -> {name}, method {args.method}"
    save_report(report, history, best, title, request.keep_out)
    if len(history) - 1 < request.total:
        print(f"ended after {len(history) - 1} of {request.total} steps; the best so far is kept")
    print("\n".join(_summary(history[0], best)))
    print(f"{args.out}, {report}: step {best.iteration} of {history[-1].iteration}")


def _request(args, start):
    if args.workers < 1:
        raise InputError(f"--workers: {args.workers} is not a positive number")
    return Request(
        start,
        args.method,
        steps=args.steps,
        regularization=args.regularization,
        spacing=args.spacing,
        margin=args.margin,
        keep_out=tuple(map(tuple, args.keep_out)),
        symmetric=not args.asymmetric,
        aims=_aims(args.aims, args.scenes),
        starts=args.starts,
        seed=args.seed,
        resolution=args.resolution,
    )


def _search(args, request):
    """All steps, and the best; with progress."""
    several = args.method == "free" and args.workers > 1
    pool = Workers(args.workers) if several else nullcontext()
    with pool as executor, Progress(args.method, request.total) as progress:
        return best_of(
            request.steps_of(executor), lambda step: progress.update(step.iteration, _note(step))
        )


def _given_layout(args):
    for key in ("rows", "cols", "size", "radius", "sheet_resistance"):
        if getattr(args, key) != args.default_of(key):
            raise InputError(f"--{key.replace('_', '-')}: --layout has its own, give only one")
    return load_layout(args.layout)


def _grid(args):
    if args.rows is None or args.cols is None:
        raise InputError("--rows and --cols, or --layout, are needed")
    size = args.size or DEFAULT_SIZE
    layout = start_layout(args.rows, args.cols, size, args.radius, args.sheet_resistance)
    insist_on_usual_size(args, layout)
    return layout


def _command(args):
    """The command that makes the same layout again."""
    words = ["tomotactile", "optimize"]
    for key in _RECORDED:
        value = getattr(args, key)
        if value in (None, args.default_of(key)):
            continue
        option = "--" + key.replace("_", "-")
        repeated = value if key == "keep_out" else [value]
        for each in repeated:
            numbers = each if isinstance(each, (list, tuple)) else [each]
            words += [option] if each is True else [option, *(f"{number}" for number in numbers)]
    return " ".join(words)


def _aims(numbers, scenes):
    if scenes is not None:
        checks.positive(scenes, "--scenes", "number")
    aims = replace(DEFAULT_AIMS, scenes=scenes)
    if numbers is None:
        return aims
    for number in numbers:
        checks.positive(number, "--aims", "number")
    *central, other = numbers
    return replace(aims, central=tuple(central), other=(*aims.other[:2], other))


def _note(step):
    hwhm = step.metrics["hwhm"]
    return (
        f"HWHM {1e3 * hwhm['mean']:.1f} mm, worst tenth {1e3 * hwhm['worst_tenth']:.1f} mm, "
        f"position error {1e3 * step.metrics['position_error']['mean']:.1f} mm"
    )


def _summary(start, best):
    for label, group, key in (
        ("mean HWHM", "hwhm", "mean"),
        ("HWHM of the worst tenth", "hwhm", "worst_tenth"),
        ("HWHM of the worst region", "hwhm", "worst_region"),
        ("mean position error", "position_error", "mean"),
    ):
        before, after = start.metrics[group][key], best.metrics[group][key]
        yield f"{label:26} {1e3 * before:7.2f} -> {1e3 * after:7.2f} mm  x {ratio(before, after):.3f}"


def _choose_grounding(args, layout, report):
    from tomotactile_ros.optimizer.report import save_grounding

    checks.positive(args.regularization, "--regularization", "number", LEAST_REGULARIZATION)
    checks.integer(args.resolution, "--resolution", 2, MOST_CELLS)
    counts = args.conditions or _halves(layout.electrodes)
    found = list(
        track(
            scans(layout, counts, args.regularization, resolution=args.resolution),
            "ground conditions",
            total=len(counts),
        )
    )
    print("conditions  speed  mean HWHM/mm  worst tenth/mm  position error/mm  noise gain/(mV/V)")
    for scan in found:
        metrics = scan.quality.metrics
        print(
            f"{len(scan.grounded):10d} {scan.speed:6.2f} {1e3 * metrics['hwhm']['mean']:13.2f} "
            f"{1e3 * metrics['hwhm']['worst_tenth']:15.2f} "
            f"{1e3 * metrics['position_error']['mean']:18.2f} {1e3 * metrics['noise_gain']:18.3g}"
        )
    grounding = {str(len(scan.grounded)): scan.grounded.tolist() for scan in found}
    replace(
        layout,
        name=args.name or Path(args.out).stem,
        provenance=layout.provenance | {"grounding": grounding},
    ).save(args.out)
    save_grounding(report, found)
    print(f"{args.out}: provenance.grounding lists the electrodes to ground; {report}")


def _halves(count):
    counts = []
    while count >= 4:
        counts.append(count)
        count //= 2
    return counts or [count]

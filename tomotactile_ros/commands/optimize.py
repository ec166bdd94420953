"""`tomotactile optimize`: better electrode positions, as a layout file with a picture beside it."""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser, Namespace
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from tomotactile_ros.evaluation.point_spread import LEAST_REGULARIZATION, MOST_CELLS
from tomotactile_ros.evaluation.posterior import CONTACT_RADIUS, MEMORY, NOISE, Conditions
from tomotactile_ros.layouts.arrangements import MAX_SPREAD
from tomotactile_ros.optimizer.checkpoint import state_file_of
from tomotactile_ros.optimizer.explore import FEWEST
from tomotactile_ros.optimizer.options import (
    OPTIONS,
    SEARCH,
    Option,
    command_of,
    refuse_unknown,
    request_of,
    start_of,
)
from tomotactile_ros.optimizer.request import ALIASES, METHODS
from tomotactile_ros.optimizer.scan import spread
from tomotactile_ros.optimizer.step import best_of, ratio
from tomotactile_ros.optimizer.workers import Workers
from tomotactile_ros.simulation import ROW_PERIOD
from tomotactile_ros.support import checks, memory
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import YAML, check_out, check_picture
from tomotactile_ros.support.progress import Progress, track

HELP = "optimize where the electrodes are, or which of them to ground"

_PLACE = 0.002  # m
_SCANS = ("scan", "grounding")  # the second is the name of old
_OF_EXPLORE = ("noise", "contact_radius")  # of the search's options


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--method",
        choices=(*METHODS, *ALIASES, *_SCANS),
        default=METHODS[0],
        help="touch (default): contacts best known; equalize (or paper): the paper's; free: least "
        "blur; scan (or grounding): which electrodes to ground, and in which order",
    )
    parser.add_argument("--out", required=True, help="layout file (.yaml) to write")
    parser.add_argument("--report", help="picture (.png) to write (default: beside the layout)")
    parser.add_argument("--name", help="of the layout (default: that of the file)")
    for option in OPTIONS:
        _add_option(parser, option)
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="processes of the search"
    )
    parser.add_argument(
        "--conditions",
        type=int,
        nargs="+",
        help="of scan: numbers of ground conditions to compare, the last of which is written (default: "
        "all down to 4 by halves, and all are written)",
    )
    parser.add_argument(
        "--frame-time",
        type=float,
        help="of scan: time for a frame, s, instead of --conditions; of --explore: the longest",
    )
    parser.add_argument(
        "--row-period",
        type=float,
        default=ROW_PERIOD,
        help="of scan and --explore: time of a row, s",
    )
    parser.add_argument(
        "--explore",
        type=int,
        nargs="+",
        metavar="N",
        help="compare numbers of electrodes and of rows on this sheet instead: a table, a picture, and "
        "a layout of the fewest that do for --place and --frame-time",
    )
    parser.add_argument(
        "--place", type=float, default=_PLACE, help="of --explore: error wanted, m (default: 0.002)"
    )


def _add_option(parser: ArgumentParser, option: Option) -> None:
    """An option of the table as the parser has it."""
    how: dict = {"help": option.help[0].lower() + option.help[1:]}
    if option.kind is bool:
        how["action"] = "store_true"
    else:
        how |= {"type": option.kind, "default": option.default}
        if option.choices:
            how["choices"] = option.choices
        if option.metavar:
            how |= {"nargs": len(option.metavar), "metavar": option.metavar}
        if option.repeated:
            how |= {"action": "append", "default": list(option.default)}
    parser.add_argument("--" + option.name.replace("_", "-"), **how)


def run(args: Namespace) -> None:
    for count in args.explore or ():
        checks.integer(count, "--explore", FEWEST, MAX_SPREAD)
    if args.explore and not args.layout and not args.rows:
        args.electrodes = args.explore[0]  # any number: of the start the sheet alone counts
    _refuse(args)
    start = start_of(vars(args), "--")
    report = args.report or Path(args.out).with_suffix(".png")
    check_out(args.out, *YAML)
    check_picture(report)
    if args.explore:
        _explore(args, start, report)
    elif args.method in _SCANS:
        _choose_scan(args, start, report)
    else:
        _move_electrodes(args, start, report)


def _refuse(args):
    """Raise InputError for options that what is to be done would leave out."""
    if args.explore:
        left_out = [option for option in SEARCH if option.name not in _OF_EXPLORE]
        refuse_unknown(left_out, "scan", vars(args), "--")
    elif args.method in _SCANS:
        refuse_unknown(SEARCH, "scan", vars(args), "--")
    elif args.conditions or args.frame_time is not None:
        name = "--conditions" if args.conditions else "--frame-time"
        raise InputError(f"{name}: only method scan knows it, and --explore a frame time")
    if args.explore and args.conditions:
        raise InputError("--conditions: of --method scan, --explore compares numbers of its own")


def _move_electrodes(args, start, report):
    from tomotactile_ros.optimizer.report import save_report
    from tomotactile_ros.optimizer.touch_report import save_touch_report

    request = _request(args, start)
    if not args.layout and args.size is None:
        a, b = start.outline.size
        print(f"tomotactile optimize: no --size, taken as {a:g} m x {b:g} m", file=sys.stderr)
    try:
        history, best = _search(args, request)
    except KeyboardInterrupt:
        print("no step was finished: nothing is written", file=sys.stderr)
        raise
    stopped = len(history) - 1 < request.total
    name = args.name or Path(args.out).stem
    command = command_of(request.method, vars(args))
    request.result(name, history, best, command=command).save(args.out)
    title = f"{start.name} -> {name}, method {request.method}"
    save = save_report if best.posterior is None else save_touch_report
    save(report, history, best, title, request.keep_out)
    if stopped:
        print(f"ended after {len(history) - 1} of {request.total} steps; the best so far is kept")
        if request.method == "touch":
            print("--resume, with the same options, goes on")
    elif request.state_file is not None:
        request.state_file.unlink(missing_ok=True)
    print("\n".join(_summary(history[0], best)))
    print(f"{args.out}, {report}: step {best.iteration} of {history[-1].iteration}")


def _request(args, start):
    if args.workers < 1:
        raise InputError(f"--workers: {args.workers} is not a positive number")
    return request_of(start, args.method, vars(args), state_file_of(args.out))


def _search(args, request):
    """All steps, and the best; with progress."""
    several = request.method != "equalize" and args.workers > 1
    if request.method == "touch":
        busy = min(args.workers, max(request.total_starts, 2))  # two look at the start
        memory.check(
            busy * MEMORY * request.layout.electrodes,
            f"{busy} processes at {request.layout.electrodes} electrodes",
        )
    pool = Workers(args.workers) if several else nullcontext()
    with pool as executor, Progress(request.method, request.total) as progress:
        return best_of(
            request.steps_of(executor), lambda step: progress.update(step.iteration, _note(step))
        )


def _note(step):
    if step.posterior is not None:
        place = step.posterior.metrics["place"]
        return (
            f"place {1e6 * place['mean']:.0f} um, worst tenth {1e6 * place['worst_tenth']:.0f} um, "
            f"score {step.score:.3f}"
        )
    hwhm = step.metrics["hwhm"]
    return (
        f"HWHM {1e3 * hwhm['mean']:.1f} mm, worst tenth {1e3 * hwhm['worst_tenth']:.1f} mm, "
        f"position error {1e3 * step.metrics['position_error']['mean']:.1f} mm"
    )


def _summary(start, best):
    if best.posterior is not None:
        yield from _expected(start.posterior, best.posterior)
        yield "images of eq. 1, which this method does not optimize:"
    for label, group, key in (
        ("mean HWHM", "hwhm", "mean"),
        ("HWHM of the worst tenth", "hwhm", "worst_tenth"),
        ("HWHM of the worst region", "hwhm", "worst_region"),
        ("mean position error", "position_error", "mean"),
    ):
        before, after = start.metrics[group][key], best.metrics[group][key]
        yield f"{label:26} {1e3 * before:7.2f} -> {1e3 * after:7.2f} mm  x {ratio(before, after):.3f}"


def _expected(before, after):
    """What is expected of contacts, at places that the search did not see."""
    room = "" if len(after.pairs) else ", none of which has room"
    yield f"expected of contacts, pairs {1e3 * after.conditions.apart:.3g} mm apart{room}:"
    for label, group, key, scale, unit in (
        ("mean place error", "place", "mean", 1e6, "um"),
        ("place, worst tenth", "place", "worst_tenth", 1e6, "um"),
        ("mean force error", "force", "mean", 100, "%"),
        ("mean d' of pairs", "separation", "mean", 1, ""),
    ):
        if not before.metrics[group]:
            continue
        old, new = (scale * each.metrics[group][key] for each in (before, after))
        yield f"{label:26} {old:7.2f} -> {new:7.2f} {unit:2}  x {ratio(old, new):.3f}"


def _choose_scan(args, layout, report):
    """Compare scans of fewer rows, and write the layout with the last of those that were asked
    for."""
    from tomotactile_ros.optimizer.report import save_scans
    from tomotactile_ros.optimizer.scan import FEW, Chooser, scans

    checks.positive(args.regularization, "--regularization", "number", LEAST_REGULARIZATION)
    checks.integer(args.resolution, "--resolution", 2, MOST_CELLS)
    counts = _counts(args, layout)
    for count in counts:
        checks.integer(count, "--conditions", 1, layout.electrodes)
    chooser = Chooser(layout)
    how = {"regularization": args.regularization, "resolution": args.resolution}
    found = list(
        track(scans(layout, counts, chooser, **how), "ground conditions", total=len(counts))
    )
    print("conditions  speed  place/um  worst tenth/um  force/%  mean HWHM/mm  position error/mm")
    for scan in found:
        place, force = scan.metrics["place"], scan.metrics["force"]
        images = scan.quality.metrics
        print(
            f"{len(scan.grounded):10d} {scan.speed:6.2f} {1e6 * place['mean']:9.1f} "
            f"{1e6 * place['worst_tenth']:15.1f} {100 * force['mean']:8.2f} "
            f"{1e3 * images['hwhm']['mean']:13.2f} "
            f"{1e3 * images['position_error']['mean']:18.2f}"
        )
    asked = args.conditions or args.frame_time is not None
    scan = found[-1 if asked else 0]
    taken = scan.grounded
    if len(taken) < layout.electrodes:
        print(
            f"{len(taken)} rows: {1e6 * scan.metrics['place']['mean']:.1f} um, and no choice of as many "
            f"is expected below {1e6 * chooser.least(len(taken)):.1f} um"
        )
    rows = min(FEW, len(taken))
    in_turn, order = (1e3 * chooser.after(each) for each in (np.sort(taken), taken))
    print(
        f"place error expected from any {rows} successive rows: {order:.2f} mm, {in_turn:.2f} mm with these "
        "electrodes in turn"
    )
    grounding = {str(len(scan.grounded)): scan.grounded.tolist() for scan in found}
    replace(
        layout,
        name=args.name or Path(args.out).stem,
        scan=tuple(taken.tolist()),
        provenance=layout.provenance | {"grounding": grounding},
    ).save(args.out)
    save_scans(report, found)
    print(f"{args.out}: scan of {len(taken)} rows; provenance.grounding has the others; {report}")


def _explore(args, start, report):
    """Numbers of electrodes and rows compared, and the fewest that do written."""
    from tomotactile_ros.optimizer.explore import answer, explore
    from tomotactile_ros.optimizer.touch_report import save_exploration

    checks.length(args.place, "--place")
    if args.frame_time is not None:
        checks.positive(args.frame_time, "--frame-time", "time in s")
    conditions = Conditions(
        noise=NOISE if args.noise is None else args.noise,
        radius=CONTACT_RADIUS if args.contact_radius is None else args.contact_radius,
    )
    sheet = start.outline, args.explore, start.radius, start.sheet_resistance
    steps = explore(*sheet, args.row_period, conditions)
    found = list(track(steps, "numbers of electrodes", total=len(args.explore)))
    print("electrodes  rows  frame/ms  place/um  worst tenth/um  force/%")
    for choice in (each for choices in found for each in choices):
        print(
            f"{choice.layout.electrodes:10d} {len(choice.rows):5d} {1e3 * choice.frame_time:9.3g} "
            f"{1e6 * choice.place:9.1f} {1e6 * choice.worst_tenth:15.1f} {100 * choice.force:8.2f}"
        )
    limit = "" if args.frame_time is None else f" within {1e3 * args.frame_time:g} ms"
    wanted = f"{1e3 * args.place:g} mm in the worst tenth{limit}"
    best = answer([each for choices in found for each in choices], args.place, args.frame_time)
    save_exploration(report, found, args.place, args.frame_time, best)
    if best is None:
        raise InputError(
            f"--explore: none of these numbers of electrodes is expected to reach {wanted}; {report} "
            "shows what they come to"
        )
    scan = best.rows if len(best.rows) < best.layout.electrodes else ()
    order = tuple(spread(best.layout.positions, scan)) if scan else ()
    name = args.name or Path(args.out).stem
    replace(best.layout, name=name, scan=order, surface=start.surface).save(args.out)
    print(
        f"{args.out}, {report}: {best.layout.electrodes} electrodes, {len(best.rows)} rows are the "
        f"fewest that are expected to reach {wanted}"
    )


def _counts(args, layout):
    """Numbers of rows to compare."""
    if args.frame_time is None:
        return args.conditions or _halves(layout.electrodes)
    if args.conditions:
        raise InputError("--frame-time: says how many rows there are, as --conditions does")
    checks.positive(args.frame_time, "--frame-time", "time in s")
    checks.positive(args.row_period, "--row-period", "time in s")
    count = min(int(args.frame_time / args.row_period + 1e-9), layout.electrodes)
    if count < 1:
        raise InputError(
            f"--frame-time: {args.frame_time:g} s is less than one row takes, {args.row_period:g} s"
        )
    return [count]


def _halves(count):
    counts = []
    while count >= 4:
        counts.append(count)
        count //= 2
    return counts or [count]

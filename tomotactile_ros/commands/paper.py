"""`tomotactile paper`: figures and numbers of Kojima et al. 2023 computed again, beside theirs."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.optimizer.work import Work
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import write_atomic
from tomotactile_ros.support.progress import Progress
from tomotactile_ros.support.yamlio import plain

HELP = "figures and numbers of the paper that this package implements, computed again beside theirs"
_OTHERS = {
    4: {"touch": "touch-4x4", "free": "free-4x4"},
    8: {"free": "free-8x8"},
}  # beside the article's
_NOTES = {
    8: "Method touch keeps the equal grid, also with a free radius (tomotactile optimize --rows 8 --cols 8 "
    "--size 0.2 0.2 --radius 0.0025 --steps 1 --radius-range 0.00125 0.0025 --starts 4): its figures are those of equal."
}
_AFTER = 11  # calls that need the optimized layouts
_CONTACTS = {16: 12, 64: 6}  # as many as three minutes allow, by electrodes


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--out",
        default="out/paper",
        help="folder for index.html and its pictures (default: out/paper)",
    )
    parser.add_argument(
        "--layout",
        action="append",
        default=[],
        help="another layout, beside those with as many electrodes on the same outline, or as the first of "
        "its own kind; as many as wanted",
    )
    parser.add_argument(
        "--contacts",
        type=int,
        help="single contacts on each kind of sheet by which layouts are compared, and half as many pairs "
        "at each distance (default: 12 for 16 electrodes, else 6; more take longer)",
    )
    parser.add_argument("--workers", type=int, default=2, help="processes (default: 2)")


def run(args: Namespace) -> None:
    if args.workers < 1:
        raise InputError(f"--workers: {args.workers} is not at least 1")
    if args.contacts is not None:
        checks.integer(args.contacts, "--contacts", 1, 10_000)
    out = Path(args.out)
    if out.exists() and not out.is_dir():
        raise InputError(f"--out: {out} is a file, a folder is needed")
    given = [load_layout(each) for each in args.layout]
    out.mkdir(parents=True, exist_ok=True)
    from tomotactile_ros.bench.paper import experiment, simulation
    from tomotactile_ros.bench.paper.article import MODELS
    from tomotactile_ros.bench.paper.contacts import found
    from tomotactile_ros.evaluation.layout_quality import evaluate_layout

    counts = simulation.COUNTS
    groups = [
        [("equal", load_layout(f"equal-{count}x{count}"))]
        + [(name, load_layout(each)) for name, each in _OTHERS[count].items()]
        for count in counts
    ]
    for layout in given:
        _put(groups, layout)

    def measured(group: int, name: str, layout: Layout) -> dict:
        singles = args.contacts or _CONTACTS.get(layout.electrodes, 6)
        return {
            ("contacts", group, name): (found, layout, singles),
            ("maps", group, name): (partial(evaluate_layout, model="point_nodes"), layout),
        }

    first: dict = {}
    for number, group in enumerate(groups):
        for name, layout in group:
            first |= measured(number, name, layout)
    for model in MODELS:
        for count in counts:
            first["model", model, count] = (simulation.optimize, count, model)
    done: dict = {}
    with ExitStack() as at_end, Progress("paper", len(first) + _AFTER) as progress:
        workers = Work(args.workers)
        at_end.callback(workers.stop)
        _compute(workers, first, done, progress)
        second: dict = {}
        for number, count in enumerate(counts):
            best = done["model", "point-nodes", count].layout
            best = replace(best, name=f"optimized-{count}x{count}")
            groups[number].insert(1, ("optimized", best))
            second |= measured(number, "optimized", best)
            for name, layout in groups[number][:2]:
                second["spreads", count, name] = (simulation.spreads, layout, count)
                if count == 8:
                    second["images", name] = (experiment.images, layout)
        optimized = {MODELS[each]: done["model", each, 8].layout for each in reversed(MODELS)}
        second["trials",] = (experiment.trials, groups[counts.index(8)][0][1], optimized)
        _compute(workers, second, done, progress)
    _write(out, groups, done)


def _write(out: Path, groups: list[list[tuple[str, Layout]]], done: dict) -> None:
    """Pictures and the page into `out`, and the ratios on the terminal."""
    from tomotactile_ros.bench.paper import page, pictures, simulation
    from tomotactile_ros.bench.paper.article import MODELS

    counts = simulation.COUNTS
    runs = [done["model", model, count] for count in counts for model in MODELS]
    two = "equal", "optimized"
    for count in counts:
        title = f"{count} × {count} electrodes, {MODELS['point-nodes']}"
        mine = [each for each in runs if each.count == count]
        own = done["model", "point-nodes", count]
        name = f"fig3-{count}x{count}"
        spreads = [(each, done["spreads", count, each]) for each in two]
        pictures.save_spreads(out / f"{name}-spreads.png", spreads, title)
        steps = [(f"update {i}" if i else "equal", step) for i, step in enumerate(own.steps)]
        pictures.save_maps(out / f"{name}-maps.png", steps, title)
        pictures.save_steps(out / f"{name}-steps.png", mine)
    images = [(name, done["images", name]) for name in two]
    pictures.save_images(out / "fig4-images.png", images)
    shown = []
    for number, group in enumerate(groups):
        title = _title(group[0][1])
        picture = f"layouts-{number + 1}.png"
        maps = [(name, done["maps", number, name]) for name, _ in group]
        pictures.save_maps(out / picture, maps, f"{title}\n{MODELS['point-nodes']}")
        contacts = [(name, done["contacts", number, name]) for name, _ in group]
        note = _NOTES.get(counts[number], "") if number < len(counts) else ""
        shown.append(page.Group(title, picture, contacts, note))
    text = page.page(runs, images, done["trials",], shown)
    write_atomic(out / "index.html", text.encode())
    for count in counts:
        print(f"{count} x {count}, optimized over equal: mean HWHM / worst region / mean PE")
        for row in page.ratio_rows(runs, count):
            print(f"  {row[0]:75} {row[3]}")
    print(f"nearest to the article: {MODELS[simulation.nearest(runs)]}")
    print(out / "index.html")


def _put(groups: list[list[tuple[str, Layout]]], layout: Layout) -> None:
    """A layout into the group of its kind, or into a new one."""
    for group in groups:
        like = group[0][1]
        if like.electrodes == layout.electrodes and plain(like.outline.to_dict()) == plain(
            layout.outline.to_dict()
        ):
            names = [name for name, _ in group]
            name = layout.name
            while name in (*names, "optimized"):
                name += "'"
            group.append((name, layout))
            return
    groups.append([(layout.name, layout)])


def _title(layout: Layout) -> str:
    a, b = layout.outline.size
    return (
        f"{layout.electrodes} electrodes, {layout.outline.kind} of {1e3 * a:g} mm × {1e3 * b:g} mm"
    )


def _compute(work: Work, tasks: dict, done: dict, progress: Progress) -> None:
    """Results of calls (function, arguments ...) into `done`, by their keys."""
    keys = list(tasks)
    for number, result in work.results(_called, dict(enumerate(tasks.values()))):
        done[keys[number]] = result
        progress.update(len(done), " ".join(map(str, keys[number])))


def _called(function, *arguments):
    return function(*arguments)

"""`tomotactile paper`: figures and numbers of Kojima et al. 2023 computed again, beside theirs."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.optimizer.workers import Workers
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import write_atomic
from tomotactile_ros.support.progress import Progress

HELP = "figures and numbers of the paper that this package implements, computed again beside theirs"
_OTHERS = {"electrodes of half the radius": "small", "free": "free"}  # layouts beside the article's


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
        help="another layout of 16 or 64 electrodes beside those of its number, as of method touch; as "
        "many as wanted",
    )
    parser.add_argument("--workers", type=int, default=2, help="processes (default: 2)")


def run(args: Namespace) -> None:
    if args.workers < 1:
        raise InputError(f"--workers: {args.workers} is not at least 1")
    out = Path(args.out)
    if out.exists() and not out.is_dir():
        raise InputError(f"--out: {out} is a file, a folder is needed")
    given = [load_layout(each) for each in args.layout]
    for layout in given:
        if layout.electrodes not in (16, 64) or layout.outline.size != (0.2, 0.2):
            raise InputError(
                f"--layout: {layout.name} does not have 16 or 64 electrodes on 0.2 m x 0.2 m"
            )
    out.mkdir(parents=True, exist_ok=True)
    from tomotactile_ros.bench.paper import experiment, page, pictures, simulation
    from tomotactile_ros.bench.paper.article import MODELS
    from tomotactile_ros.bench.paper.contacts import found

    counts = simulation.COUNTS
    with Workers(args.workers) as workers:
        tasks = {}
        for model in reversed(MODELS):  # what others wait for first
            for count in counts:
                tasks[workers.submit(simulation.optimize, count, model)] = (model, count)
        beside = {
            count: [
                ("equal", load_layout(f"equal-{count}x{count}")),
                *((name, load_layout(f"{each}-{count}x{count}")) for name, each in _OTHERS.items()),
                *((each.name, each) for each in given if each.electrodes == count**2),
            ]
            for count in counts
        }
        others = {}
        for count in counts:
            for name, layout in beside[count]:
                tasks[workers.submit(found, layout, count)] = (name, count)
                others[count, name] = workers.submit(simulation.on_maps, layout)
        total = len(tasks) + len(counts) + 2
        with Progress("paper", total) as progress:
            done: dict = {}
            waiting = dict(tasks)
            while waiting:
                for task in as_completed(list(waiting)):
                    key = waiting.pop(task)
                    done[key] = task.result()
                    progress.update(len(done), " ".join(map(str, key)))
                    if key[0] == "point-nodes":  # the layout of the article's own model
                        best = done[key].steps[done[key].best].layout
                        best = replace(best, name=f"optimized-{key[1]}x{key[1]}")
                        waiting[workers.submit(found, best, key[1])] = ("optimized", key[1])
                        if key[1] == 8:
                            for name, layout in (
                                ("equal", load_layout("equal-8x8")),
                                ("optimized", best),
                            ):
                                waiting[workers.submit(experiment.images, layout)] = (
                                    name,
                                    "images",
                                )
        maps = {key: task.result() for key, task in others.items()}
    runs = [done[model, count] for count in counts for model in MODELS]
    contacts = {}
    for count in counts:
        own = done["point-nodes", count]
        shown = done[simulation.nearest(runs), count]
        steps = [(f"update {i}" if i else "equal", step) for i, step in enumerate(shown.steps)]
        pictures.save_maps(
            out / f"fig3-{count}x{count}-maps.png",
            steps,
            f"{count} × {count}, {MODELS[shown.model]}",
        )
        pictures.save_steps(
            out / f"fig3-{count}x{count}-steps.png", [each for each in runs if each.count == count]
        )
        named = [("equal", own.steps[0]), ("optimized", own.steps[own.best])]
        named += [(name, maps[count, name]) for name, _ in beside[count][1:]]
        pictures.save_maps(
            out / f"layouts-{count}x{count}.png",
            named,
            f"{count} × {count}, {MODELS['point-nodes']}",
        )
        contacts[count] = [(name, done[name, count]) for name, _ in named]
    images = [(name, done[name, "images"]) for name in ("equal", "optimized")]
    pictures.save_images(out / "fig4-images.png", images)
    text = page.page(runs, images, contacts)
    write_atomic(out / "index.html", text.encode())
    for count in counts:
        print(f"{count} x {count}, optimized over equal: mean HWHM / worst region / mean PE")
        for row in page.ratio_rows(runs, count):
            print(f"  {row[0]:75} {row[3]}")
    print(f"nearest to the article: {MODELS[simulation.nearest(runs)]}")
    print(out / "index.html")

"""Speed and accuracy of the profiles side by side, on data from an independent model.

Finite elements (h = a 80th of the side, electrodes as equipotentials) make the frames, the closed
form reconstructs them: 8 x 8 electrodes on 200 mm, discs of radius 5 mm, 1 mV noise, 12-bit
converter, with a uniform sheet and with one that varies by 10 %. Prints a table; --out writes it as
JSON, --pictures the images.

    OMP_NUM_THREADS=1 python benchmark/reconstruction_accuracy.py [--singles 200] [--pairs 40]
    [--idle 10000]

With --parts it only does what `tomotactile bench --parts` does: the sensor as it is, on frames of
the reference model, other reconstructions (--methods) beside the profiles. With --sizes N it only
prints how the force of single discs depends on their radius, from N discs at each of five kinds of
places for each of four pressures (40 s with N = 4), and with --contact-radius what that setting
does. With --times N it only prints what a frame takes with N x N electrodes and --resolution, of
two discs that move about.

Figures
-------
HWHM, PE        of the potential image (evaluation.metrics), of single contacts anywhere on the
sheet up to its rim contact error   distance of the contact that belongs to the true one ghosts,
missed  in all frames, of one contact and of two (evaluation.scoring); ghosts with doubled ones told
apart      least distance from which on 9 of 10 pairs give exactly two contacts, each nearer to its
own force error     mean |F - F_true| / F_true; two contacts 50 to 120 mm apart with 10 and 30 kPa
noise gain      standard deviation of the image under noise over its maximum, in parts of noise /
drive voltage
"""

from __future__ import annotations

import argparse
import json
import sys

from tomotactile_ros.bench.cases import PROFILES
from tomotactile_ros.bench.profiles.data import SHEETS, collect, moving
from tomotactile_ros.bench.profiles.figures import figures, idle_alarms
from tomotactile_ros.bench.profiles.pictures import draw
from tomotactile_ros.bench.profiles.sizes import sizes
from tomotactile_ros.bench.profiles.times import dense_time, frame_times, image_time, warm_starts
from tomotactile_ros.bench.sensor import tables
from tomotactile_ros.bench.sensor.parts import PARTS
from tomotactile_ros.bench.sensor.run import run
from tomotactile_ros.bench.sensor.trial import find_methods, profiles
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import plain


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layout", default="equal-8x8")
    parser.add_argument("--singles", type=int, default=200)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--idle", type=int, default=10000)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--parts", nargs="+", choices=PARTS)
    parser.add_argument("--methods", nargs="+", default=[], metavar="MODULE:FUNCTION")
    parser.add_argument("--sizes", type=int, metavar="N")
    parser.add_argument("--contact-radius", type=float, default=0.005, metavar="M")
    parser.add_argument("--times", type=int, metavar="N")
    parser.add_argument("--resolution", type=int, default=40, metavar="CELLS")
    parser.add_argument("--out")
    parser.add_argument("--pictures")
    return parser.parse_args()


def main():
    args = arguments()
    if args.times:
        frame_times(args.times, args.resolution)
    elif args.parts:
        save(sensor(args.parts, args.methods), args.out)
    else:
        layout = load_layout(args.layout)
        settings = {name: Settings(name, contact_radius=args.contact_radius) for name in PROFILES}
        pipelines = {name: Pipeline(layout, each) for name, each in settings.items()}
        if args.sizes:
            save(sizes(layout, pipelines, args.sizes, args.seed), args.out)
        else:
            save(everything(layout, pipelines, args), args.out)


def sensor(parts, methods):
    """Prints the tables of the parts; returns the same."""
    every = [profiles, *map(find_methods, methods)]
    found = {part: run(part, methods=every) for part in parts}
    print("\n".join(tables.text(found)))
    return plain(found)


def everything(layout, pipelines, args):
    """Prints all tables; returns the same."""
    table = {}
    for sheet, variation in SHEETS.items():
        data = collect(layout, variation, args.singles, args.pairs, args.seed)
        table[sheet] = {name: figures(pipeline, data) for name, pipeline in pipelines.items()}
        print_figures(sheet, table[sheet])
        if args.pictures and variation is None:
            draw(args.pictures, pipelines, data)
    table["fast image"] = image_alone(layout, pipelines["fast"], data)
    table["moving"] = dict(starts(layout, pipelines))
    table["idle"] = {}
    for name, pipeline in pipelines.items():
        alarms, seconds = idle_alarms(pipeline, args.idle)
        print(
            f"{name}: {alarms} false contacts on {args.idle} idle frames, {1e3 * seconds:.3f} ms each"
        )
        table["idle"][name] = {"false contacts": alarms, "time, ms": 1e3 * seconds}
    return table


def print_figures(sheet, scores):
    print(f"\n{sheet}\n{'':28}" + "".join(f"{profile:>12}" for profile in PROFILES))
    for key, first in scores["fast"].items():
        if isinstance(first, dict):
            for distance in first:
                values = [scores[profile][key][distance] for profile in PROFILES]
                print(f"  told apart, {distance:14}" + "".join(f"{v:12.2f}" for v in values))
        else:
            print(f"{key:28}" + "".join(f"{scores[p][key]:12.4g}" for p in PROFILES))


def image_alone(layout, pipeline, data):
    median, p99 = (1e3 * each for each in image_time(pipeline, data["singles"][1]))
    dense = 1e3 * dense_time(layout)
    print(f"\nfast, image alone: {median:.3f} ms median, {p99:.3f} ms p99; dense {dense:.3f} ms")
    return {"median, ms": median, "p99, ms": p99, "dense, ms": dense}


def starts(layout, pipelines):
    """Prints and yields what a start from the last image saves where contacts move."""
    for name, frames in moving(layout).items():
        for profile in ("balanced", "accurate"):
            times = 1e3 * warm_starts(pipelines[profile], frames)
            print(
                f"{name}, {profile}: {times[0]:.2f} ms from the last frame, {times[1]:.2f} ms from scratch"
            )
            yield f"{name}, {profile}", {"times, ms": times.tolist()}


def save(table, path):
    if path:
        with open(path, "w", encoding="utf-8") as file:
            json.dump(table, file, indent=1)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"reconstruction_accuracy: {error}")

"""Speed and accuracy of the profiles side by side, on data from an independent model.

Finite elements (h = a 80th of the side, electrodes as equipotentials) make the frames, the closed form
reconstructs them: 8 x 8 electrodes on 200 mm, discs of radius 5 mm, 1 mV noise, 12-bit converter, with a uniform
sheet and with one that varies by 10 %. Prints a table; --out writes it as JSON, --pictures the images.

    OMP_NUM_THREADS=1 python benchmark/reconstruction_accuracy.py [--singles 200] [--pairs 40] [--idle 10000]

With --sizes N it only prints how the force of single discs depends on their radius, from N discs at each of five kinds
of places for each of four pressures (40 s with N = 4), and with --contact-radius what that setting does. With --times N
it only prints what a frame takes with N x N electrodes and --resolution, of two discs that move about.

Figures
-------
HWHM, PE        of the potential image (evaluation.metrics), of single contacts anywhere on the sheet up to its rim
contact error   distance of the strongest contact to the true one
told apart      least distance from which on 9 of 10 pairs give exactly two contacts, each nearer to its own
force error     mean |F - F_true| / F_true; two contacts 50 to 120 mm apart with 10 and 30 kPa
noise gain      standard deviation of the image under noise over its maximum, in parts of noise / drive voltage
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

from tomotactile_ros.contact import Contact, ContactLaw
from tomotactile_ros.defects import Adc, Defects, Noise, SheetVariation
from tomotactile_ros.evaluation.metrics import quality
from tomotactile_ros.layout import equal_grid, load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.active_set import Memory
from tomotactile_ros.scene import Scene
from tomotactile_ros.simulation import Simulator

LAW = ContactLaw(1e-4, 1.0)
DRIVE = 3.3
APART = (0.020, 0.024, 0.028, 0.032, 0.036, 0.040, 0.045, 0.050, 0.060)
RADII = (0.002, 0.003, 0.004, 0.005, 0.006, 0.008, 0.010, 0.012, 0.015, 0.020)
PRESSURES = (2e3, 10e3, 30e3, 100e3)
SHEETS = {"uniform": None, "10 % variation": SheetVariation(0.1, 0.05, 3)}
PROFILES = ("fast", "balanced", "accurate")


def simulate(layout, groups, variation, noise=0.001, seed=0):
    """(N, E, E) frames of N groups of contacts."""
    contacts = []
    for i, group in enumerate(groups):
        for shape in group:
            contacts.append(Contact(**shape, start=float(i), end=float(i + 1)))
    defects = Defects(sheet_variation=variation)
    scene = Scene(
        "benchmark",
        DRIVE,
        contacts,
        LAW,
        Noise(noise, seed) if noise else None,
        Adc(12, DRIVE),
        defects,
    )
    simulator = Simulator(layout, scene)
    return np.array([simulator.frame(i + 0.5, i) for i in range(len(groups))])


def disc(position, pressure=20e3, radius=0.005):
    return {"shape": "disc", "center": tuple(position), "radius": radius, "pressure": pressure}


def pairs_at(distance, count, random, pressures=(20e3, 20e3)):
    """`count` pairs of discs, centres `distance` (m, or a range) apart, all on the sheet."""
    pairs = []
    while len(pairs) < count:
        middle, turn = random.uniform(-0.095, 0.095, 2), random.uniform(0, np.pi)
        length = random.uniform(*distance) if np.ndim(distance) else distance
        half = length / 2 * np.array([np.cos(turn), np.sin(turn)])
        if (np.abs([middle - half, middle + half]) <= 0.095).all():
            pairs.append([disc(middle - half, pressures[0]), disc(middle + half, pressures[1])])
    return pairs


def outline_shapes():
    """Wide, L-shaped and ring contacts as groups; the ring is cut open by 2 degrees."""
    turn = np.radians(np.linspace(1, 359, 90))
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    ring = np.concatenate([0.06 * circle, 0.04 * circle[::-1]])
    ell = [
        (-0.06, -0.06),
        (0.05, -0.06),
        (0.05, -0.03),
        (-0.03, -0.03),
        (-0.03, 0.05),
        (-0.06, 0.05),
    ]
    wide = {"shape": "rectangle", "center": (0.01, 0.005), "size": (0.08, 0.05), "pressure": 10e3}
    return {
        "wide": [wide],
        "L": [{"shape": "polygon", "points": np.array(ell), "pressure": 10e3}],
        "ring": [{"shape": "polygon", "points": ring, "pressure": 10e3}],
    }


def matched(contacts, truth):
    """(n,) distances and relative force errors of the contacts nearest to the true ones (each used once)."""
    left, distances, errors = list(contacts), [], []
    for true in truth:
        x, y = true["center"]
        if not left:
            distances.append(np.inf)
            errors.append(1.0)
            continue
        best = min(left, key=lambda c: np.hypot(c.x - x, c.y - y))
        left.remove(best)
        force = true["pressure"] * np.pi * true["radius"] ** 2
        distances.append(float(np.hypot(best.x - x, best.y - y)))
        errors.append(abs(best.force - force) / force)
    return np.array(distances), np.array(errors)


class Runner:
    """Processes frames and keeps the time each took."""

    def __init__(self, pipeline, grounded):
        self.pipeline, self.grounded, self.times = pipeline, grounded, []

    def __call__(self, frame):
        start = time.perf_counter()
        result = self.pipeline.process(frame, self.grounded, DRIVE)
        self.times.append(time.perf_counter() - start)
        return result


def score(pipeline, data, args):
    """Figures of one profile on the frames `data` of one sheet."""
    run = Runner(pipeline, np.arange(pipeline.layout.electrodes))
    for frame in data["singles"][1][:5]:
        run(frame)
    run.times.clear()
    groups, frames = data["singles"]
    results = [run(frame) for frame in frames]
    positions = np.array([group[0]["center"] for group in groups])
    images = np.array([pipeline.grid.gather(result.potential) for result in results])
    sharp = quality(images, positions, pipeline.grid)
    side = max(pipeline.layout.outline.size)
    near = [matched(result.contacts, group) for result, group in zip(results, groups)]
    first = np.array([d[0] for d, _ in near])
    figures = {
        "HWHM mean, %": 100 * sharp.hwhm.mean() / side,
        "PE mean, mm": 1e3 * sharp.position_error.mean(),
        "PE p95, mm": 1e3 * np.percentile(sharp.position_error, 95),
        "contact error mean, mm": 1e3 * first.mean(),
        "contact error p95, mm": 1e3 * np.percentile(first, 95),
        "one contact found, %": 100 * np.mean([len(result.contacts) == 1 for result in results]),
        "force error one, %": 100 * np.mean([e[0] for _, e in near]),
        "lambda, median": float(np.median([result.regularization for result in results])),
    }
    told = {}
    for distance in APART:
        groups, frames = data[distance]
        good = []
        for group, frame in zip(groups, frames):
            contacts = run(frame).contacts
            good.append(len(contacts) == 2 and (matched(contacts, group)[0] < distance / 2).all())
        told[distance] = np.mean(good)
    figures["told apart at, mm"] = 1e3 * least_distance(told)
    figures["pairs told apart"] = {f"{1e3 * d:.0f} mm": round(float(v), 3) for d, v in told.items()}
    groups, frames = data["two"]
    errors = [matched(run(frame).contacts, group)[1] for group, frame in zip(groups, frames)]
    figures["force error two, %"] = 100 * np.mean(errors)
    figures["time median, ms"] = 1e3 * np.median(run.times)
    figures["time p99, ms"] = 1e3 * np.percentile(run.times, 99)
    figures["noise gain"] = noise_gain(pipeline, data["repeats"][1])
    grid = pipeline.grid
    for name, (group, frame) in data["shapes"].items():
        image = run(frame).potential
        found = image >= 0.5 * np.nanmax(image)
        true = covered(group[0], grid)
        figures[f"IoU {name}"] = np.count_nonzero(found & true) / np.count_nonzero(found | true)
    return figures


def least_distance(told):
    """The least distance from which on all are told apart in 9 of 10 cases; nan if there is none."""
    best = np.nan
    for distance in sorted(told, reverse=True):
        if told[distance] < 0.9:
            break
        best = distance
    return best


def noise_gain(pipeline, frames):
    run = Runner(pipeline, np.arange(pipeline.layout.electrodes))
    images = np.array([pipeline.grid.gather(run(frame).potential) for frame in frames])
    spread = np.sqrt(images.var(axis=0).mean())
    return float(spread / images.mean(axis=0).max() / (0.001 / DRIVE))


def covered(shape, grid):
    """(H, W) cells whose centre the contact covers."""
    from shapely import Polygon, contains_xy

    polygon = Polygon(Contact(**shape).vertices)
    return contains_xy(polygon, *grid.centres.T).reshape(grid.shape)


def image_time(pipeline, frames):
    """Median and p99 of the linear image alone, float32 frame in V to image, s."""
    frames = frames.astype(np.float32)
    local = pipeline._model.local(np.arange(pipeline.layout.electrodes))
    times = []
    for _ in range(20):
        for frame in frames:
            start = time.perf_counter()
            local.image(local.meter.read(frame, DRIVE))
            times.append(time.perf_counter() - start)
    return np.median(times), np.percentile(times, 99)


def dense_time(layout, resolution=40):
    """Median time of a dense float32 product (K, L E) by (L E,), s: the same image without structure."""
    size = layout.electrodes**2
    matrix = np.ones((resolution**2, size), np.float32)
    vector = np.ones(size, np.float32)
    times = []
    for _ in range(100):
        start = time.perf_counter()
        matrix @ vector
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def idle_alarms(pipeline, count, seed=1):
    """Contacts reported on `count` frames of noise alone, and the median time of one, s."""
    random = np.random.default_rng(seed)
    electrodes = pipeline.layout.electrodes
    run, alarms = Runner(pipeline, np.arange(electrodes)), 0
    step = DRIVE / 4096
    for _ in range(count):
        noise = 0.001 * random.standard_normal((electrodes, electrodes))
        frame = np.clip(np.round(noise / step), 0, 4095) * step
        np.fill_diagonal(frame, np.nan)
        alarms += bool(run(frame).contacts)
    return alarms, float(np.median(run.times)) if count else 0.0


def collect(layout, variation, args):
    random = np.random.default_rng(args.seed)
    singles = [[disc(p)] for p in random.uniform(-0.095, 0.095, (args.singles, 2))]
    data = {"singles": (singles, simulate(layout, singles, variation))}
    for distance in APART:
        groups = pairs_at(distance, args.pairs, random)
        data[distance] = groups, simulate(layout, groups, variation)
    groups = pairs_at((0.05, 0.12), args.pairs, random, (10e3, 30e3))
    data["two"] = groups, simulate(layout, groups, variation)
    repeats = [[disc((0.013, -0.021))]] * 40
    data["repeats"] = repeats, simulate(layout, repeats, variation)
    shapes = outline_shapes()
    frames = simulate(layout, list(shapes.values()), variation)
    data["shapes"] = {name: (group, frame) for (name, group), frame in zip(shapes.items(), frames)}
    return data


def moving(layout, count=16, step=0.0005):
    """Frames (N, E, E) of contacts that move by `step` (m) from frame to frame."""
    shift = step * np.arange(count)
    pairs = [[disc((-0.05 + s, 0.02)), disc((0.04, s - 0.03))] for s in shift]
    wide = {"shape": "rectangle", "size": (0.08, 0.05), "pressure": 10e3}
    groups = {
        "two discs of 5 mm": pairs,
        "disc of 15 mm": [[disc((s - 0.03, 0.02), radius=0.015)] for s in shift],
        "80 mm x 50 mm": [[wide | {"center": (s - 0.01, 0.005)}] for s in shift],
    }
    return {name: simulate(layout, group, None) for name, group in groups.items()}


def warm_starts(pipeline, frames):
    """Median time, s, and mean number of linear systems of a frame, from the last frame and from scratch."""
    grounded, nothing = np.arange(pipeline.layout.electrodes), np.zeros(len(pipeline.grid.pixels))
    starts = {
        "kept": lambda maker: None,
        "forgotten": lambda maker: maker.forget(),
        "empty": lambda maker: setattr(maker, "memories", (Memory(nothing), Memory(nothing))),
    }
    times, steps = {}, {}
    for start, prepare in starts.items():
        run, steps[start] = Runner(pipeline.with_settings(pipeline.settings), grounded), []
        maker = run.pipeline._make_image
        for frame in frames:
            prepare(maker)
            run(frame)
            steps[start].append(sum(memory.steps for memory in maker.memories))
        times[start] = np.median(run.times[1:])
    steps = {start: np.mean(each[1:]) for start, each in steps.items()}
    return np.array([times["kept"], times["forgotten"]]), np.array([steps["kept"], steps["empty"]])


def frame_times(side, resolution, frames=20, rounds=10):
    """Prints the time of a whole frame of each profile and of reading it: closed form, `side` x `side` electrodes."""
    layout = equal_grid(side, side, (0.2, 0.2), 0.02 / side, 1e4)
    pairs = pairs_at((0.05, 0.12), frames, np.random.default_rng(1), (10e3, 30e3))
    contacts = [
        Contact(**shape, start=float(i), end=i + 1.0)
        for i, pair in enumerate(pairs)
        for shape in pair
    ]
    scene = Scene("times", DRIVE, contacts, LAW, Noise(0.001))
    simulator = Simulator(layout, scene, "closed_form")
    voltages = [simulator.frame(i + 0.5, i).astype(np.float32) for i in range(frames)]
    for profile in PROFILES:
        run = Runner(Pipeline(layout, Settings(profile, resolution=resolution)), simulator.grounded)
        for _ in range(rounds if profile == "fast" else 1):
            for frame in voltages:
                run(frame)
        median, p99 = 1e3 * np.percentile(run.times[frames // 2 :], [50, 99])
        print(f"{profile}: {median:.2f} ms a frame, p99 {p99:.2f} ms")
    meter = run.pipeline._model.local(simulator.grounded).meter
    reading = [timed(lambda frame=frame: meter.read(frame, DRIVE)) for frame in voltages * rounds]
    print(f"reading it, single precision: {1e3 * np.median(reading):.2f} ms")


def timed(work):
    """Time of `work`, s."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def places_of(layout, radius, random):
    """Places of a disc of `radius` (m): on an electrode, between two, amid four, at the rim, anywhere."""
    half = np.array(layout.outline.size) / 2 - radius
    side = round(layout.electrodes**0.5)
    pitch = (layout.positions.max(axis=0) - layout.positions.min(axis=0)) / (side - 1)
    corner = layout.positions.min(axis=0) + pitch * random.integers(1, side - 2, 2)
    jitter = random.uniform(-0.1, 0.1, 2)
    rim = random.uniform(-half, half)
    rim[random.integers(2)] = 1.0
    return {
        "on an electrode": corner + pitch * jitter,
        "between two": corner + pitch * (jitter + [0.5, 0.0]),
        "amid four": corner + pitch * (jitter + [0.5, 0.5]),
        "at the rim": np.where(rim == 1.0, half - random.uniform(0, 0.004), rim),
        "anywhere": random.uniform(-half, half),
    }


def sizes(layout, pipelines, count, seed):
    """Prints median and 95th percentile of the force's error, %, for discs of all RADII; returns the same."""
    random = np.random.default_rng(seed)
    groups, kinds = [], []
    for radius in RADII:
        for pressure in PRESSURES:
            for _ in range(count):
                for kind, place in places_of(layout, radius, random).items():
                    groups.append([disc(place, pressure, radius)])
                    kinds.append((radius, pressure, kind))
    kinds, table = np.array(kinds, object), {}
    for sheet, variation in SHEETS.items():
        frames = simulate(layout, groups, variation)
        for profile, pipeline in pipelines.items():
            run = Runner(pipeline, np.arange(layout.electrodes))
            errors = [
                matched(run(frame).contacts, group)[1][0] for frame, group in zip(frames, groups)
            ]
            rows = size_rows(100 * np.array(errors), kinds)
            table[f"{sheet}, {profile}"] = rows
            head = "".join(f"{1e3 * radius:9.0f} mm" for radius in RADII)
            print(f"\nforce error, % (median / 95 %): {sheet}, {profile}\n{'':20}{head}")
            for name, row in rows.items():
                print(f"{name:20}" + "".join(f"{m:6.1f}/{p:5.0f}" for m, p in row))
    return table


def size_rows(errors, kinds):
    """Median and 95th percentile of `errors` (N,) for each radius, by pressure, kind of place and in all."""
    rows = {f"{pressure / 1e3:g} kPa": kinds[:, 1] == pressure for pressure in PRESSURES}
    rows |= {kind: kinds[:, 2] == kind for kind in dict.fromkeys(kinds[:, 2])}
    rows["all up to 30 kPa"] = kinds[:, 1] < 50e3
    return {
        name: [
            np.percentile(errors[those & (kinds[:, 0] == radius)], [50, 95]).tolist()
            for radius in RADII
        ]
        for name, those in rows.items()
    }


def draw(path, pipelines, data):
    """Truth and the image of each profile, one row for each shape, on one scale."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    shapes, grid = data["shapes"], next(iter(pipelines.values())).grid
    figure, axes = pyplot.subplots(
        len(shapes),
        1 + len(pipelines),
        figsize=(11, 2.6 * len(shapes)),
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    grounded = np.arange(next(iter(pipelines.values())).layout.electrodes)
    left, bottom, right, top = 1e3 * np.array(grid.outline.bounds)
    for row, (group, frame) in zip(axes, shapes.values()):
        true = group[0]["pressure"] / 1e3
        images = {"truth": true * covered(group[0], grid)}
        for profile, pipeline in pipelines.items():
            images[profile] = pipeline.process(frame, grounded, DRIVE).pressure / 1e3
        for axis, (name, image) in zip(row, images.items()):
            shown = axis.imshow(image, vmin=0, vmax=1.5 * true, extent=(left, right, bottom, top))
            axis.set_title(name)
        row[0].set_ylabel("y / mm")
        figure.colorbar(shown, ax=row, extend="max", label="pressure / kPa")
    for axis in axes[-1]:
        axis.set_xlabel("x / mm")
    figure.savefig(path, dpi=80)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layout", default="equal-8x8")
    parser.add_argument("--singles", type=int, default=200)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--idle", type=int, default=10000)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--sizes", type=int, metavar="N")
    parser.add_argument("--contact-radius", type=float, default=0.005, metavar="M")
    parser.add_argument("--times", type=int, metavar="N")
    parser.add_argument("--resolution", type=int, default=40, metavar="CELLS")
    parser.add_argument("--out")
    parser.add_argument("--pictures")
    args = parser.parse_args()
    if args.times:
        frame_times(args.times, args.resolution)
        return
    layout = load_layout(args.layout)
    pipelines = {
        profile: Pipeline(layout, Settings(profile, contact_radius=args.contact_radius))
        for profile in PROFILES
    }
    if args.sizes:
        save(sizes(layout, pipelines, args.sizes, args.seed), args.out)
        return
    table = {}
    for sheet, variation in SHEETS.items():
        data = collect(layout, variation, args)
        scores = {profile: score(pipeline, data, args) for profile, pipeline in pipelines.items()}
        table[sheet] = scores
        print(f"\n{sheet}\n{'':28}" + "".join(f"{profile:>12}" for profile in PROFILES))
        for key in scores["fast"]:
            if isinstance(scores["fast"][key], dict):
                for distance in scores["fast"][key]:
                    values = [scores[profile][key][distance] for profile in PROFILES]
                    print(f"  told apart, {distance:14}" + "".join(f"{v:12.2f}" for v in values))
            else:
                print(f"{key:28}" + "".join(f"{scores[p][key]:12.4g}" for p in PROFILES))
        if args.pictures and variation is None:
            draw(args.pictures, pipelines, data)
    median, p99 = image_time(pipelines["fast"], data["singles"][1])
    dense = dense_time(layout)
    print(
        f"\nfast, image alone: {1e3 * median:.3f} ms median, {1e3 * p99:.3f} ms p99; dense {1e3 * dense:.3f} ms"
    )
    table["fast image"] = {
        "median, ms": 1e3 * median,
        "p99, ms": 1e3 * p99,
        "dense, ms": 1e3 * dense,
    }
    for name, frames in moving(layout).items():
        for profile in ("balanced", "accurate"):
            times, steps = warm_starts(pipelines[profile], frames)
            print(
                f"{name}, {profile}: {1e3 * times[0]:.2f} ms, {steps[0]:.1f} linear systems from the last frame; "
                f"{1e3 * times[1]:.2f} ms, {steps[1]:.1f} from scratch"
            )
            figures = {"times, ms": (1e3 * times).tolist(), "linear systems": steps.tolist()}
            table.setdefault("moving", {})[f"{name}, {profile}"] = figures
    for profile, pipeline in pipelines.items():
        alarms, idle_time = idle_alarms(pipeline, args.idle)
        print(
            f"{profile}: {alarms} false contacts on {args.idle} idle frames, {1e3 * idle_time:.3f} ms each"
        )
        table.setdefault("idle", {})[profile] = {
            "false contacts": alarms,
            "time, ms": 1e3 * idle_time,
        }
    save(table, args.out)


def save(table, path):
    if path:
        with open(path, "w", encoding="utf-8") as file:
            json.dump(table, file, indent=1)


if __name__ == "__main__":
    main()

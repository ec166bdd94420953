"""`tomotactile reconstruct`: images and contacts of recorded or simulated frames."""

from __future__ import annotations

import json
import math
import time
from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace

import numpy as np

from tomotactile_ros.commands.tare import add_tare_argument, apply_tare
from tomotactile_ros.devices.recording import load_recording
from tomotactile_ros.frame import Frame
from tomotactile_ros.frames_file import FramesFile, doubt_of
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.learning.file import load_sensor
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.calibration import load_calibration
from tomotactile_ros.reconstruction.mistakes import refuse_mistakes
from tomotactile_ros.reconstruction.settings import (
    AUTO,
    DEFAULT_LAW,
    IMAGES,
    PROFILES,
    UNKNOWN,
    ContactEstimate,
    Result,
    doubt_of_noise,
    doubt_of_settling,
)
from tomotactile_ros.scenes.contact_law import ContactLaw
from tomotactile_ros.sheet import MODELS
from tomotactile_ros.simulation import ROW_PERIOD
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import complaints_at
from tomotactile_ros.support.files import check_out
from tomotactile_ros.support.npz_writer import npz_writer
from tomotactile_ros.support.progress import track
from tomotactile_ros.view.contact_lines import fault_lines

HELP = "reconstruct pressure images and contacts from frames"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("frames", help="recorded frames: .npz or rosbag2")
    parser.add_argument("--layout", required=True, help="layout file or name of an installed one")
    parser.add_argument("--profile", default="fast", choices=PROFILES, help="default: fast")
    parser.add_argument("--out", required=True, help="file to write (.npz)")
    parser.add_argument("--resolution", type=int, default=40, help="cells along the longer side")
    parser.add_argument(
        "--regularization", type=float, help="lambda_J^2 of eq. 1 (default: by noise)"
    )
    parser.add_argument("--noise", type=float, default=0.001, help="noise of a reading, V rms")
    parser.add_argument("--contact-radius", type=float, default=0.005, help="typical, m")
    add_tare_argument(parser)
    parser.add_argument("--calibration", help="file of 'calibrate' (default: the frames' own law)")
    parser.add_argument("--sensor", help="file of 'learn': what is known about this sensor")
    parser.add_argument(
        "--drive-voltage", type=float, help="drive voltage, V (default: the frames' own)"
    )
    parser.add_argument(
        "--every-row",
        action="store_true",
        help="contacts after every row instead of every frame, followed from row to row; no images",
    )
    parser.add_argument("--topic", help="topic, for a bag of several sensors")
    parser.add_argument(
        "--deadline",
        type=float,
        help="time that a frame may take, s (default: as long as it needs)",
    )
    parser.add_argument("--image", choices=IMAGES, help="default: as the profile makes it")
    parser.add_argument(
        "--unknown",
        default=AUTO,
        metavar="WHAT,...",
        help=f"found with the contacts: {', '.join(UNKNOWN)} (default: {AUTO}, all)",
    )
    parser.add_argument("--no-contacts", action="store_true", help="linear images alone")
    parser.add_argument("--model", default="auto", choices=MODELS, help="physics (default: auto)")


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    recorded = load_recording(args.frames, layout, args.drive_voltage, args.topic, stored=True)
    check_out(args.out, ".npz")
    law, of_law = law_of_recording(args.calibration, recorded)
    settings = Settings(
        args.profile,
        resolution=args.resolution,
        regularization=args.regularization,
        noise=args.noise,
        contact_law=law,
        contact_radius=args.contact_radius,
        deadline=args.deadline,
        image=args.image,
        contacts=not args.no_contacts,
        unknown=tuple(args.unknown.split(",")),
        model=args.model,
    )
    with complaints_at(f"{args.frames}: "):
        refuse_mistakes(layout, recorded.voltages, recorded.grounded, recorded.drive, args.noise)
    sensor = load_sensor(args.sensor, layout, args.model) if args.sensor else None
    pipeline = Pipeline(layout, settings, sensor=sensor)
    apply_tare(args.tare, pipeline)
    stamps, told = stamps_of_recording(recorded)
    recorded = replace(recorded, stamps=stamps)
    latency: list[float] = []
    left_out: dict[int, str] = {}
    cut = 0
    withheld: Counter[str] = Counter()
    noise, settling = [], 0.0
    process = every_row if args.every_row else every_frame
    images = not args.every_row and args.image != "none"
    with results_writer(args.out, images, law) as take:
        frames = track(recorded, "reconstructing frames", len(recorded))
        for result, lasted, holds in _of_file(args.frames, process(pipeline, frames)):
            latency.append(lasted)
            cut += not result.complete
            left_out.update(result.faults)
            withheld.update([result.reason] * bool(result.reason))
            noise += [result.noise] * bool(np.isfinite(result.noise))
            settling = result.settling or settling
            take(result, lasted, holds)
    each = "row" if args.every_row else "frame"
    print(
        f"{args.out}: {len(latency)} {each}s, {pipeline.report}, "
        f"{1e3 * np.median(latency):.2f} ms a {each}"
    )
    if cut:
        why = "the deadline came before, or too much touches at once"
        print(f"not all was tried in {cut} of {len(latency)} {each}s: {why}")
    if told:
        print(told)
    for reason, count in withheld.most_common():
        print(f"{count} {each}s withheld: {reason}")
    for line in fault_lines(left_out):
        print(line)
    if noise and (doubt := doubt_of_noise(float(np.median(noise)), args.noise)):
        print(f"{doubt}: --noise")
    if doubt := doubt_of_settling(settling):
        print(f"{doubt}; this is subtracted")
    if pipeline.made_otherwise:
        print(pipeline.made_otherwise)
    if of_law:
        print(of_law)


def law_of_recording(
    calibration: str | None, recorded: FramesFile
) -> tuple[ContactLaw | None, str]:
    """The contact law of a recording, None where it says that there is none, and a line to print
    where forces are not known, or known for an assumed law only."""
    if calibration:
        return load_calibration(calibration), ""
    if recorded.contact_law is not None:
        return recorded.contact_law, ""
    hint = "(see 'tomotactile calibrate')"
    if recorded.lawless:
        return None, f"no contact law: places and conductances, but no forces and pressures {hint}"
    law = DEFAULT_LAW
    return law, (
        "the file names no contact law: forces and pressures assume "
        f"{law.coefficient:g} S/m^2 per Pa, and are off by one factor for other contacts {hint}"
    )


Processed = Iterator[tuple[Result, float, float]]


def every_frame(
    pipeline: Pipeline, frames: Iterable[Frame], clock: Callable[[], float] = time.perf_counter
) -> Processed:
    """Result, time that it took by the `clock`, s, and time for which it holds, s, of each frame."""
    for frame in frames:
        start = clock()
        result = pipeline.process(frame)
        yield result, clock() - start, frame.stamp + result.holds


def every_row(
    pipeline: Pipeline, frames: Iterable[Frame], clock: Callable[[], float] = time.perf_counter
) -> Processed:
    """The same of each row."""
    state = pipeline.rows()
    for frame in frames:
        for i, (row, ground) in enumerate(zip(frame.voltages, frame.grounded)):
            holds = frame.stamp + i * frame.row_period
            start = clock()
            result = pipeline.process_row(row, ground, frame.drive_voltage, holds, state)
            yield result, clock() - start, holds


def _of_file(path: str, results: Processed) -> Processed:
    """The same; what is refused is said to be of that file."""
    with complaints_at(f"{path}: "):
        yield from results


def stamps_of_recording(recorded) -> tuple[np.ndarray, str]:
    """(N,) s, when each frame began, and a line to print where the file does not tell, or tells
    what cannot be."""
    if recorded.stamps is not None:
        stamps = np.asarray(recorded.stamps, float)
        return stamps, doubt_of(stamps)
    lasts = len(recorded.grounded) * (recorded.row_period or ROW_PERIOD)
    frames = np.arange(len(recorded.voltages)) * lasts
    return frames, f"no stamps: times count from 0, a frame every {plain(1e3 * lasts, 4)} ms"


@contextmanager
def results_writer(
    path: str, images: bool = True, law: ContactLaw | None = DEFAULT_LAW
) -> Iterator[Callable[[Result, float, float], None]]:
    """A function that takes each result, its latency, s, and the time for which it holds, s, into a
    file.

    pressure (N, H, W) Pa, potential (N, H, W) V with `images`, contacts as JSON, latency (N,) s,
        stamps (N,) s, complete (N,) whether all was tried, ambiguous (N,) whether other contacts explain the
        readings nearly as well, and these, alternatives, as contacts;
    without a contact law: conductance (N, H, W) S/m² with `images`, and pressure NaN;
    where contacts of some frame are withheld, reason (N,), empty for the others. However many
    frames there are, it takes little memory.
    """
    reasons: list[str] = []

    def take(result: Result, latency: float, stamp: float) -> None:
        if images:
            writer.append(
                pressure=np.asarray(result.pressure, np.float32),
                potential=np.asarray(result.potential, np.float32),
            )
            if law is None:
                writer.append(conductance=np.asarray(result.conductance, np.float32))
        writer.append(latency=latency, stamps=float(stamp))
        writer.append(complete=result.complete, ambiguous=result.ambiguous)
        for name, found in (("contacts", result.contacts), ("alternatives", result.alternative)):
            told = json.dumps([contact_entry(contact) for contact in found or ()])
            writer.append_text(**{name: f"{', ' if reasons else '['}{told}"})
        reasons.append(result.reason)

    with npz_writer(path) as writer:
        yield take
        writer.append_text(contacts="]", alternatives="]")
        if any(reasons):
            writer.put(reason=np.array(reasons))


def contact_entry(contact: ContactEstimate) -> dict[str, float | None]:
    """What a result file says of a contact.

    position_std (m), force_std (N), probability and the velocity vx, vy (m/s) are None, null in
    JSON, where the profile estimates none, force_std also of a bare conductor; id is 0 where nobody follows contacts. Without a contact
    law force (N), pressure (Pa) and force_std are None, and conductance (S) is there instead.
    """
    entry = asdict(contact)
    if math.isnan(contact.force):
        entry.update(dict.fromkeys(("force", "pressure", "force_std")))
    else:
        del entry["conductance"]
        if not math.isfinite(contact.force_std):
            entry["force_std"] = None
    vx, vy = entry.pop("velocity")
    covariance = np.reshape(entry.pop("position_covariance"), (2, 2))
    if not np.isfinite(covariance).all():
        unknown = dict.fromkeys(("vx", "vy", "position_std", "force_std", "probability"))
        return {**entry, **unknown}
    spread = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    return {**entry, "vx": vx, "vy": vy, "position_std": spread}

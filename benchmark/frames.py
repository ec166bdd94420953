"""Frames by what they show: how long they take, and how often they show a contact that is none.

    scripts/setup python3 benchmark/frames.py [--profiles accurate ...] [--states N]
    scripts/setup python3 benchmark/frames.py --idle 100000 --pressed 12000

States of the reference model on 8 x 8 electrodes, 1 mV, 12 bits, no times of rows. Times: of each state two
frames of the untouched sheet, one of the touch, three more of it; ms of processor, median / p95.

Alarms: idle frames are of an untouched sheet; after each 100 another sensor, every other one with offsets of
3 mV rms and gains off by 2 %. Pressed frames: single contacts, each with new noise in 100 frames after one of
the untouched sheet.
"""

import numpy as np

from tomotactile_ros.bench.cases import PROFILES
from tomotactile_ros.bench.program import options, spread
from tomotactile_ros.bench.sensor.parts import WIRINGS, WORN
from tomotactile_ros.bench.sensor.readings import Wiring, potentials, readings, untouched
from tomotactile_ros.bench.sensor.states import states
from tomotactile_ros.bench.sensor.trial import Trial, judged
from tomotactile_ros.bench.tables import Table
from tomotactile_ros.bench.trials import make_pipeline
from tomotactile_ros.scenes.channels import Channels, Rms

CASES = {  # family, case and wiring
    "one contact": ("textbook-8x8", None, "textbook"),
    "gains off by 2 %": ("textbook-8x8", None, "gains 2 %"),
    "uneven by 20 %": ("sheets-8x8", "random 20%", "textbook"),
    "worn and uneven by 20 %": ("sheets-8x8", "random 20%", "worn"),
    "two contacts": ("beside-8x8", "two", "textbook"),
    "three contacts": ("crowd-8x8", "3 contacts", "textbook"),
    "six contacts": ("crowd-8x8", "6 contacts", "textbook"),
    "disc of 30 mm": ("wide-8x8", "disc of 30 mm", "textbook"),
    "rectangle of 80 x 50 mm": ("wide-8x8", "rectangle 80 x 50", "textbook"),
    "hand": ("wide-8x8", "hand", "textbook"),
    "plate of 100 mm": ("wide-8x8", "plate of 100 mm", "textbook"),
    "whole sheet, 100 N": ("wide-8x8", "whole sheet, 100 N", "textbook"),
}
KINDS = {"untouched": slice(0, 2), "new": slice(2, 3), "at rest": slice(3, 6)}  # of six frames
SAME = 100  # frames of one sensor, or of one contact


def times(family: str, case: str | None, wiring: str, profile: str, most: int):
    """(6, N) ms of two untouched frames, a new touch, and three at rest, of N states."""
    pressed, wires = states(family, case, most), (WIRINGS | {"worn": WORN})[wiring]
    nothing, frames = untouched(pressed.layout.electrodes), []
    for number, seen in enumerate(pressed.seen):
        both = [nothing] * 2 + [potentials(seen, wires)] * 4
        frames += [readings(each, wires, (number, k)) for k, each in enumerate(both)]
    trial = Trial("", pressed.layout, np.array(frames), [[]] * len(frames))
    found = judged(make_pipeline(pressed.layout, profile), trial)
    return 1e3 * np.reshape([each.seconds for each in found], (-1, 6)).T


def alarms(idle: int, pressed: int, profile: str) -> dict[str, np.ndarray]:
    """Numbers of frames, of those with false contacts, with missed ones, and withheld."""
    touched = states("textbook-8x8")
    layout, nothing = touched.layout, untouched(touched.layout.electrodes)
    pipeline = make_pipeline(layout, profile)
    tally = {"idle": np.zeros(4, int), "pressed": np.zeros(4, int)}

    def count(kind, frames, truths):
        for each in judged(pipeline, Trial(kind, layout, np.array(frames), truths)):
            told = each.score is not None
            wrong = told and each.score.ghosts + each.score.doubled + each.score.weak > 0
            tally[kind] += [1, wrong, told and each.score.missed > 0, not told]

    for first in range(0, idle, SAME):
        wrong = Wiring(Channels(gain=Rms(0.02, first), offset=Rms(0.003, first)))
        wiring = wrong if first % (2 * SAME) else Wiring()
        numbers = range(first, min(first + SAME, idle))
        frames = [readings(nothing, wiring, (1, number)) for number in numbers]
        count("idle", frames, [[]] * len(frames))
    for first in range(0, pressed, SAME):
        which = first // SAME % len(touched.seen)
        seen, numbers = potentials(touched.seen[which]), range(first, min(first + SAME, pressed))
        frames = [readings(nothing, seed=(2, first))]
        frames += [readings(seen, seed=(3, number)) for number in numbers]
        count("pressed", frames, [None] + [touched.truths[which]] * len(numbers))
    return tally


def main() -> None:
    asked = options(
        __doc__,
        profiles=(["accurate"], None, PROFILES),
        states=(24, "of each case, at most"),
        idle=(0, "frames, for alarms"),
        pressed=(0, "frames, for alarms"),
    )
    if asked.idle or asked.pressed:
        table = Table("", "frames", "with false contacts", "with missed ones", "withheld")
        for kind, counts in alarms(asked.idle, asked.pressed, asked.profiles[0]).items():
            table.add(kind, *map(str, counts))
        return
    table = Table("case", "profile", *(f"{kind}, ms: median / p95" for kind in KINDS))
    for case, given in CASES.items():
        for profile in asked.profiles:
            found = times(*given, profile, asked.states)
            table.add(case, profile, *(spread(found[part].ravel()) for part in KINDS.values()))


if __name__ == "__main__":
    main()

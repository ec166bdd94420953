"""How often frames show a contact that is none, and how often good frames are withheld.

    scripts/setup python3 benchmark/idle_frames.py [--idle FRAMES] [--pressed FRAMES] [--profile P]

Idle frames of 8 x 8 electrodes: an untouched sheet, 1 mV, 12 bits that begin at 0 V; after each 100
another sensor, every other one with offsets of 3 mV rms and gains off by 2 %. Pressed frames: the single contacts of part
`channels` of the benchmark (reference model, perfect channels), each with new noise in one frame after the
other, 100 times, after a frame of the untouched sheet.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tomotactile_ros.bench.sensor.readings import Wiring, potentials, readings, untouched
from tomotactile_ros.bench.sensor.states import states
from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.evaluation.scoring import score_frame
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.settings import PROFILES
from tomotactile_ros.scenes.channels import Channels, Rms

SAME = 100  # frames of one sensor, or of one contact


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--idle", type=int, default=100_000, metavar="FRAMES")
    parser.add_argument("--pressed", type=int, default=12_000, metavar="FRAMES")
    parser.add_argument("--profile", default="accurate", choices=PROFILES)
    asked = parser.parse_args()
    pressed = states("textbook-8x8")
    settings = Settings(asked.profile, noise=NOISE, contact_law=LAW)
    pipeline = Pipeline(pressed.layout, settings)
    grounded = np.arange(pressed.layout.electrodes)
    nothing = untouched(len(grounded))
    tally = {"idle": np.zeros(4, int), "pressed": np.zeros(4, int)}
    for first in range(0, asked.idle, SAME):
        wrong = Channels(gain=Rms(0.02, first), offset=Rms(0.003, first))
        wiring = Wiring(wrong) if first % (2 * SAME) else Wiring()
        for number in range(first, min(first + SAME, asked.idle)):
            result = pipeline.process(readings(nothing, wiring, (1, number)), grounded, DRIVE)
            withheld = result.state != "valid"
            tally["idle"] += [1, bool(result.contacts), 0, withheld]
    for first in range(0, asked.pressed, SAME):
        which = first // SAME % len(pressed.seen)
        touched = potentials(pressed.seen[which])
        pipeline.process(readings(nothing, seed=(2, first)), grounded, DRIVE)
        for number in range(first, min(first + SAME, asked.pressed)):
            result = pipeline.process(readings(touched, seed=(3, number)), grounded, DRIVE)
            withheld = result.state != "valid"
            score = score_frame([] if withheld else result.contacts, pressed.truths[which])
            missed = not withheld and score.missed > 0
            tally["pressed"] += [1, score.ghosts + score.doubled > 0, missed, withheld]
    rows = [(name, *map(str, counts)) for name, counts in tally.items()]
    heads = "frames", "with false contacts", "with missed ones", "withheld"
    print(*markdown(("", *heads), rows), sep="\n")


if __name__ == "__main__":
    main()

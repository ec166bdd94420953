"""Sensors that nobody tuned on: ghosts, misses, places and forces of touches on random ones.

Each number is a sensor of its own: rows and columns (3 to 10), spacing (6 to 80 mm), sheet resistance
(0.3 to 300 kilohm), electrodes, drive voltage, gains (ideal or off by 2 %), sheet (even, or uneven by
10 or 20 %), and one to three contacts of 0.12 to 0.4 spacings, which rest or begin within the second
frame. Frames are made by finite elements, every row at its own time; nothing is learned, and the
reconstruction is told the noise, the contact law and a typical radius.

    scripts/setup python3 benchmark/random_sensors.py [--first 0] [--count 40] [--profile accurate]

A ghost is a contact of 0.02 N or more that is farther than 0.4 spacings from every true one, or a second one
at the same.
"""

from dataclasses import replace
from time import process_time

import numpy as np

import tomotactile_ros as tt
from tomotactile_ros.bench.program import options, spread
from tomotactile_ros.commands.reconstruct import every_frame
from tomotactile_ros.evaluation.scoring import score_frame
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.channels import Channels
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import Adc, Noise, Scene
from tomotactile_ros.scenes.sheet_field import SheetVariation
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

FRAMES = 4
REACH = 0.4  # spacings: a contact further from a true one is another
NOISE, BITS = 3e-4, 12  # of the drive voltage; of the converter


class Sensor:
    """The sensor and the scene of one number."""

    def __init__(self, number: int):
        draw = np.random.default_rng(number)
        rows, columns = int(draw.integers(3, 11)), int(draw.integers(3, 11))
        pitch = 10 ** draw.uniform(-2.2, -1.1)
        width = (columns - 1) * pitch + 2 * draw.uniform(0, 0.5) * pitch
        height = (rows - 1) * pitch * draw.uniform(0.7, 1.2) + pitch * draw.uniform(0, 1)
        radius = pitch * draw.uniform(0.05, 0.2)
        resistance = 10 ** draw.uniform(2.5, 5.5)
        self.layout = equal_grid(rows, columns, (width, height), radius, resistance)
        drive = float(draw.choice([1.0, 3.3, 5.0]))
        self.pitch = min(width / (columns - 1), height / (rows - 1))
        count = int(draw.integers(1, 4))
        law = ContactLaw(1 / resistance * (0.025 / pitch) ** 2, 1.0)
        contacts = self._contacts(draw, count, np.array([width, height]))
        self.period = rows * columns * ROW_PERIOD
        begins = int(draw.integers(0, 3)) > 0
        starts = [self.period * draw.uniform(1, 2) if begins else 0.0 for _ in contacts]
        contacts = [replace(c, start=start) for c, start in zip(contacts, starts)]
        gains, uneven = float(draw.choice([0, 0, 0.02])), float(draw.choice([0, 0.1, 0.2]))
        defects = Defects()
        if gains:
            off = gains * draw.standard_normal(rows * columns)
            defects = Defects(channels=Channels(gain=tuple(1 + off)))
        if uneven:
            variation = SheetVariation(uneven, max(width, height) / 4, number)
            defects = replace(defects, sheet_variation=variation)
        noise, adc = Noise(rms=drive * NOISE), Adc(bits=BITS, range=drive)
        name = f"random {number}"
        self.scene = Scene(name, drive, tuple(contacts), law, noise, adc, defects)
        self.text = (
            f"{number:3} {rows} x {columns}, {1e3 * pitch:2.0f} mm, {resistance / 1e3:5.1f} kohm, "
            f"gains {gains:.0%}, uneven {uneven:3.0%}, {count} {'begin' if begins else 'rest '}"
        )

    def _contacts(self, draw, count, size):
        half = size / 2 - 0.3 * self.pitch
        found: list[Contact] = []
        for _ in range(200):
            if len(found) == count:
                break
            center = draw.uniform(-half, half)
            apart = [np.hypot(*(center - np.array(other.center))) for other in found]
            if min(apart, default=np.inf) > 2.2 * self.pitch:
                radius = self.pitch * draw.uniform(0.12, 0.4)
                pressure = 2e4 * 10 ** draw.uniform(-0.5, 0.5)
                found.append(Contact("disc", tuple(center), radius=radius, pressure=pressure))
        return found


def main():
    asked = options(__doc__, first=(0, "number of the first sensor"), count=40, profile="accurate")
    scores, withheld, places, times = [], 0, [], []
    for number in range(asked.first, asked.first + asked.count):
        sensor, said = Sensor(number), []
        simulator = Simulator(sensor.layout, sensor.scene, model="fem")
        settings = tt.Settings(
            asked.profile,
            noise=sensor.scene.noise.rms,
            contact_law=sensor.scene.contact_law,
            contact_radius=0.25 * sensor.pitch,
        )
        pipeline = tt.Pipeline(sensor.layout, settings)
        frames = (simulator.measure(i * sensor.period, i) for i in range(FRAMES))
        for result, took, holds in every_frame(pipeline, frames, process_time):
            times.append(1e3 * took)
            if result.reason:
                withheld += 1
                said.append("withheld")
                continue
            truth = sensor.scene.truth(holds)
            score = score_frame(result.contacts, truth, reach=REACH * sensor.pitch)
            scores.append(score)
            places += (score.place / sensor.pitch).tolist()
            wrong = {"ghosts": score.ghosts + score.doubled, "missed": score.missed}
            words = "".join(f" {number} {what}" for what, number in wrong.items() if number)
            said.append(f"{len(result.contacts)}/{score.true}{words}")
        print(f"{sensor.text} | {', '.join(said)}", flush=True)
    forces = 100 * np.concatenate([score.force for score in scores])
    print(
        f"\n{len(times)} frames of {asked.count} sensors, {asked.profile}: "
        f"{sum(score.ghosts + score.doubled for score in scores)} ghosts, "
        f"{sum(score.missed for score in scores)} missed, {withheld} withheld; median / p95: place "
        f"{spread(places, 3)} spacings, force {spread(forces)} %, time {spread(times, 0)} ms of processor"
    )


if __name__ == "__main__":
    main()

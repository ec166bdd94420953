#!/usr/bin/env python3
"""Learn the gains of a sensor from touches of unknown force, then its forces from two known ones.

    python3 examples/learn_and_calibrate.py

`recorded` stands for your own recordings (`tomotactile record`); the commands `tomotactile learn`
and `tomotactile calibrate` do the same with files.
"""

import argparse

import numpy as np

import tomotactile_ros as tt

DRIVE = 3.3  # V, of the driving layer
NOISE = 0.001  # V rms, of a reading
FOOT = 0.008  # m, radius of the foot that presses with known force
LAW = tt.ContactLaw(1e-4, 1.0)  # S/m² and Pa: what is to be found


def recorded(layout: tt.Layout, place: tuple[float, float], force: float) -> list[tt.Frame]:
    """Four frames: a foot presses at `place` (m) with `force` (N); channels differ by 3 %."""
    foot = tt.Contact(shape="disc", center=place, radius=FOOT, force=force)
    channels = tt.Defects(channels=tt.Channels(gain=tt.Rms(0.03, seed=5)))
    scene = tt.Scene("foot", DRIVE, (foot,), LAW, tt.Noise(NOISE), defects=channels)
    simulator = tt.Simulator(layout, scene, row_period=0.0)
    return [simulator.measure(0.0, sequence) for sequence in range(4)]


def main() -> None:
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    layout = tt.load_layout("equal-4x4")

    print("simulating 12 touches and learning from them takes some seconds", flush=True)
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.08, 0.08, (12, 2))  # m; nobody tells them to `learn`, nor the forces
    touches = [frame for p in places for frame in recorded(layout, tuple(p), rng.uniform(1, 4))]
    learned = tt.learn(layout, touches, noise=NOISE, radius=FOOT)
    gains = learned.state["gain"]
    print(f"gains from {gains.min():.3f} to {gains.max():.3f}")

    forces = (1.0, 4.0)  # N
    presses = [recorded(layout, (0.03, 0.02), force) for force in forces]
    sensor = learned.state
    found = [tt.measure_conductance(layout, p, sensor=sensor, foot_radius=FOOT) for p in presses]
    fit = tt.fit_contact_law(forces, *zip(*found))
    print(f"law: {fit.law.coefficient:.3g} S/m² at 1 Pa, exponent {fit.law.exponent:.3f}")

    settings = tt.Settings("balanced", noise=NOISE, contact_law=fit.law, contact_radius=FOOT)
    pipeline = tt.Pipeline(layout, settings, sensor=sensor)
    frame = recorded(layout, (-0.05, 0.04), 2.5)[0]
    for contact in pipeline.process(frame).contacts:
        place = f"x {1e3 * contact.x:.1f} mm, y {1e3 * contact.y:.1f} mm"
        print(f"2.5 N at x -50.0 mm, y 40.0 mm is seen as {contact.force:.2f} N at {place}")


if __name__ == "__main__":
    try:
        main()
    except tt.InputError as error:
        raise SystemExit(f"learn_and_calibrate: {error}") from None

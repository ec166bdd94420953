#!/usr/bin/env python3
"""Simulate a sensor, reconstruct one frame, compare with the truth and draw it.

python3 examples/simulate_and_plot.py --out pressure.png
"""

import argparse

import tomotactile_ros as tt


def line(label: str, x: float, y: float, force: float | None) -> str:
    """A contact as text; scenes of bare conductors have no forces."""
    newtons = "" if force is None else f"  force {force:5.2f} N"
    return f"{label:5}  x {1e3 * x:6.1f} mm  y {1e3 * y:6.1f} mm{newtons}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layout", default="equal-8x8", help="a layout file or a shipped one")
    parser.add_argument("--scene", default="default", help="a scene file or a shipped one")
    parser.add_argument("--time", type=float, default=0.0, help="s, into the scene")
    parser.add_argument("--profile", default="balanced", help="see README, Choosing a profile")
    parser.add_argument("--out", default="pressure.png", help="picture to write")
    args = parser.parse_args()

    layout, scene = tt.load_layout(args.layout), tt.load_scene(args.scene)
    simulator = tt.Simulator(layout, scene)  # finite elements
    # The reconstruction must know the contact law: without it forces are not known.
    settings = tt.Settings(args.profile, contact_law=scene.contact_law)
    pipeline = tt.Pipeline(layout, settings)

    frame = simulator.measure(
        args.time
    )  # row l of its voltages was read while grounded[l] was grounded
    result = pipeline.process(frame)
    if result.state != "valid":
        print(f"no contacts are reported: {result.reason}")
    for contact in result.contacts:
        force = contact.force if scene.contact_law else None
        print(line("found", contact.x, contact.y, force))
    truth = scene.truth(args.time)
    for contact in truth:
        print(line("true", contact["x"], contact["y"], contact["force"]))
    tt.plot(result, layout, truth, f"{args.scene} on {layout.name}").savefig(args.out)
    print(f"{args.out} written")


if __name__ == "__main__":
    try:
        main()
    except tt.InputError as error:
        raise SystemExit(f"simulate_and_plot: {error}") from None

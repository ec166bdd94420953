"""`tomotactile calibrate`: the contact law from presses of known force."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

import numpy as np

from tomotactile_ros.devices.recording import load_recording
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.learning.file import load_sensor
from tomotactile_ros.reconstruction.calibration import (
    Fit,
    fit_contact_law,
    measure_conductance,
    save_calibration,
)
from tomotactile_ros.reconstruction.mistakes import refuse_mistakes
from tomotactile_ros.reconstruction.settings import Settings
from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError, complaints_at
from tomotactile_ros.support.files import YAML, check_out, check_picture
from tomotactile_ros.view.calibration import save_fit

_FAR_OFF = 0.05  # of a force: what a radius that frames do not show may make of it, unsaid
HELP = "fit the contact law to presses of known force"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "presses",
        nargs="+",
        metavar="FRAMES=FORCE",
        help="frames (.npz or rosbag2) of one contact, and its force in N; without '=' the true force in the file",
    )
    parser.add_argument("--layout", required=True, help="layout file or name of an installed one")
    parser.add_argument(
        "--out", required=True, help="file to write (.yaml), parameters of the node"
    )
    parser.add_argument("--topic", help="topic, for a bag of several sensors")
    parser.add_argument(
        "--exponent",
        type=float,
        help="exponent m of the contact law, if it is known (default: fitted)",
    )
    parser.add_argument("--sensor", help="file of 'learn': what is known about this sensor")
    parser.add_argument(
        "--foot-radius", type=float, help="radius of the round foot that pressed, m"
    )
    parser.add_argument("--picture", help="picture (.png) of the fit")


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    check_out(args.out, *YAML)
    if args.picture:
        check_picture(args.picture)
    sensor = load_sensor(args.sensor, layout) if args.sensor else None
    forces, conductances, areas, seen = [], [], [], []
    for press in args.presses:
        path, force = _split(press)
        recorded = load_recording(path, layout, topic=args.topic)
        force = _true_force(path, recorded.truth) if force is None else force
        conductance, area = _measure(path, layout, recorded, sensor, args.foot_radius)
        print(
            f"{path}: {plain(force)} N, {plain(1e6 * conductance, 4)} uS over {plain(1e6 * area)} mm^2"
        )
        forces.append(force)
        conductances.append(conductance)
        areas.append(area)
        if args.foot_radius:  # frames alone, as they are reconstructed
            seen.append(_measure(path, layout, recorded, sensor, None))
    fit = fit_contact_law(forces, conductances, areas, args.exponent)
    save_calibration(args.out, fit)
    print(
        f"{args.out}: g = {fit.law.coefficient:.4g} S/m^2 (p / Pa)^{fit.law.exponent:.4g}, {_told(fit)}"
    )
    off = [fit.law.pressure(c / a) * a / force - 1 for (c, a), force in zip(seen, forces)]
    if off and abs(np.mean(off)) > _FAR_OFF:
        print(
            f"  reconstructed without that foot's radius, which frames hardly show, forces of these presses are "
            f"{np.mean(off):+.0%} off: set contact_radius (--contact-radius) to what presses"
        )
    if args.picture:
        save_fit(args.picture, fit.law, forces, conductances, areas)
        print(f"{args.picture} written")


def _told(fit: Fit) -> str:
    """How far a law is off the presses that it was fitted to; with one press there is nothing to
    compare it with."""
    if fit.presses == 1:
        return "from one press: how well it fits others is not known"
    return f"forces within {fit.error:.1%} rms of {fit.presses} presses"


def _measure(path, layout, recorded, sensor, foot_radius):
    frames = recorded.voltages, recorded.grounded, recorded.drive_voltage
    with complaints_at(f"{path}: "):
        refuse_mistakes(layout, *frames, Settings().noise)
        return measure_conductance(layout, *frames, sensor, foot_radius)


def _split(press):
    path, mark, force = press.rpartition("=")
    if not mark:
        return press, None
    try:
        return path, checks.positive(float(force), press, "force in N")
    except ValueError:
        raise InputError(f"{press}: {force!r} is not a force in N, write FRAMES.npz=2.5") from None


def _true_force(path, truth):
    forces = [contact["force"] for frame in truth or [] for contact in frame]
    if not forces or None in forces or max(forces) - min(forces) > 1e-9:
        raise InputError(f"{path}: does not say which single force pressed; write {path}=FORCE")
    return forces[0]

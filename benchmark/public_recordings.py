"""Reciprocity, gains and drift of public recordings of electrical impedance tomography.

    scripts/setup python3 benchmark/public_recordings.py [--structuring FOLDER] [--tank FILE ...]

They are other hardware than this sensor's (currents between two electrodes, voltages between two
others), and nothing of them is in the repository; fetch them first:

--structuring  a clone of https://github.com/DSHardman/InfoStructuring (its folder
               MembraneTests/Data): a hydrogel with 8 electrodes, amplitudes at 10 kHz, 62 hours
--tank         ref.mat and data*.mat of the Kuopio Tomography Challenge 2023
               (https://zenodo.org/records/8252370): a tank with 32 electrodes
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from tomotactile_ros.bench.four_terminal import Recording, contradiction, from_differences
from tomotactile_ros.support.errors import InputError


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--structuring", type=Path, metavar="FOLDER")
    parser.add_argument("--tank", type=Path, nargs="+", metavar="FILE", default=[])
    args = parser.parse_args()
    if not args.structuring and not args.tank:
        parser.error("--structuring or --tank: which recordings?")
    recordings = [membrane(args.structuring / "MembraneTests/Data")] if args.structuring else []
    for each in [*recordings, *map(tank, args.tank)]:
        print(f"{each.name}: {len(each.values)} frames")
        for name, value in contradiction(each).items():
            print(
                f"    {name}: {value}"
                if name == "equations"
                else f"    {name}: {100 * value:.1f} %"
            )


def membrane(folder: Path) -> Recording:
    """The hydrogel: rows of `electrodes` are two that carry the current, two that are read."""
    electrodes = read(folder / "electrodes.mat", "electrodes")[0].tolist()
    (responses,) = read(folder / "membraneEnvironment.mat", "responses")
    pairs = [((a, b), (c, d)) for a, b, c, d in electrodes]
    return Recording("membrane, 10 kHz", pairs, responses[:, : len(pairs)])


def tank(path: Path) -> Recording:
    """One state of the tank; the challenge names the same things otherwise in its reference."""
    ends = "ref" if "ref" in path.stem else ""
    currents, sensed, volts = read(path, f"Inj{ends}", "Mpat", f"Uel{ends}")
    patterns = currents.shape[1]
    return from_differences(f"tank, {path.stem}", currents, sensed, volts.reshape(patterns, -1).T)


def read(path: Path, *names: str) -> list[np.ndarray]:
    try:
        content = loadmat(path, variable_names=names)
    except (OSError, ValueError, MatReadError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    missing = [name for name in names if name not in content]
    if missing:
        raise InputError(f"{path}: {', '.join(missing)}: is missing")
    return [content[name] for name in names]


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"public_recordings: {error}")

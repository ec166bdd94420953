"""The frozen set: what the estimator makes of the same frames before and after a change, frame by frame.

Frames are those of the parts of `tomotactile bench --parts`, from a model that does not reconstruct
them; every frame counts, the slowest and the worst most.

    OMP_NUM_THREADS=1 python benchmark/frozen.py --out before.json [--step 6] [--parts channels crowd]
    OMP_NUM_THREADS=1 python benchmark/frozen.py --out after.json --against before.json

Prints a line for each case: ghosts (doubled ones too), missed, withheld; places (mm) and forces (%)
by median and worst; the share of true places within their ellipses of 95 %; chi-squared per reading;
processor time (ms) by median and worst, and with --against the same of before below it where any of
them is another.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from tomotactile_ros.bench.sensor.parts import PARTS
from tomotactile_ros.bench.sensor.trial import Trial
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.evaluation.scoring import score_frame
from tomotactile_ros.reconstruction import Pipeline, Settings

COLUMNS = [
    *("frames", "ghosts", "missed", "withheld", "place", "worst"),
    *("force", "worst", "covered", "misfit", "time", "worst"),
]


def measured(trial: Trial) -> dict[str, list[float]]:
    """What `accurate` makes of every frame of a trial at rest."""
    pipeline = Pipeline(trial.layout, Settings("accurate", noise=NOISE, contact_law=LAW))
    grounded = np.arange(trial.layout.electrodes)
    kept: dict[str, list[float]] = {
        key: [] for key in ("ghosts", "missed", "place", "force", "covered", "misfit", "time")
    }
    for frame, truth in zip(trial.frames, trial.truths, strict=True):
        begun = time.process_time()
        result = pipeline.process(frame, grounded, DRIVE, row_period=trial.row_period)
        taken = time.process_time() - begun
        if truth is None:
            continue
        kept["time"].append(1e3 * taken)
        if result.state != "valid":
            continue
        score = score_frame(result.contacts, truth)
        kept["ghosts"].append(score.ghosts + score.doubled)
        kept["missed"].append(score.missed)
        kept["misfit"].append(result.misfit)
        kept["place"] += (1e3 * score.place).tolist()
        kept["force"] += (100 * score.force).tolist()
        kept["covered"] += score.place_covered.tolist()
    return kept


def figures(kept: dict[str, list[float]]) -> list[float]:
    """`COLUMNS` of what was measured of one case or of several together."""

    def of(key: str, how) -> float:
        return float(how(kept[key])) if kept[key] else float("nan")

    frames = len(kept["time"])
    return [
        frames,
        sum(kept["ghosts"]),
        sum(kept["missed"]),
        frames - len(kept["misfit"]),
        *(of(key, how) for key in ("place", "force") for how in (np.median, max)),
        100 * of("covered", np.mean),
        of("misfit", np.median),
        *(of("time", how) for how in (np.median, max)),
    ]


def line(name: str, row: list[float]) -> str:
    counts = "".join(f"{value:9.0f}" for value in row[:4])
    return f"{name[:40]:40s}{counts}" + "".join(f"{value:9.2f}" for value in row[4:])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--step", type=int, default=6, help="every so manieth press")
    parser.add_argument("--only", default="", help="cases with this in their names")
    parser.add_argument("--out", type=Path, help="JSON with every frame")
    parser.add_argument("--against", type=Path, help="the same of before")
    given = parser.parse_args()
    before = json.loads(given.against.read_text()) if given.against else {}
    found: dict[str, dict[str, list[float]]] = {}
    print(f"{'':40s}" + "".join(f"{name:>9s}" for name in COLUMNS))
    for part in given.parts:
        for trial in PARTS[part](given.step):
            name = f"{part}: {trial.case}"
            if trial.row_period or given.only not in name:
                continue
            found[name] = measured(trial)
            print(line(name, figures(found[name])), flush=True)
            if name in before:
                print(line("  before", figures(before[name])), flush=True)
            if given.out:
                given.out.write_text(json.dumps(found))
    for title, of in (
        ("all", found),
        ("before", {name: before[name] for name in found if name in before}),
    ):
        if of:
            keys = next(iter(of.values()))
            every = {key: [each for kept in of.values() for each in kept[key]] for key in keys}
            print(line(title, figures(every)))


if __name__ == "__main__":
    main()

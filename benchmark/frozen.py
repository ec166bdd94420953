"""The frozen set: what the estimator makes of the same frames before and after a change.

Frames are those of the parts of `tomotactile bench --parts`, from a model that does not reconstruct
them; every frame counts, the slowest and the worst most.

    python benchmark/frozen.py --out before.json [--step 6] [--parts channels crowd]
    python benchmark/frozen.py --out after.json --against before.json

Prints a line for each case: ghosts (doubled ones too), missed, withheld; places (mm) and forces (%)
by median and worst; the share of true places within their ellipses of 95 %; chi-squared per reading;
processor time (ms) by median and worst, and with --against the same of before below it.
"""

import json
from pathlib import Path

import numpy as np

from tomotactile_ros.bench.program import options
from tomotactile_ros.bench.sensor.parts import PARTS
from tomotactile_ros.bench.sensor.trial import Judged, judged
from tomotactile_ros.bench.trials import make_pipeline

COLUMNS = [
    *("frames", "ghosts", "missed", "withheld", "place", "worst"),
    *("force", "worst", "covered", "misfit", "time", "worst"),
]
BOTH = np.median, np.max


def figures(frames: list[Judged]) -> list[float]:
    """`COLUMNS` of frames of one case or of several together."""
    told = [each for each in frames if each.score is not None]
    scores = [each.score for each in told]

    def of(values, *how) -> list[float]:
        values = np.hstack(values) if values else np.empty(0)
        return [float(each(values)) if len(values) else float("nan") for each in how]

    return [
        len(frames),
        sum(score.ghosts + score.doubled for score in scores),
        sum(score.missed for score in scores),
        len(frames) - len(told),
        *of([1e3 * score.place for score in scores], *BOTH),
        *of([100 * score.force for score in scores], *BOTH),
        *of([100 * score.place_covered for score in scores], np.mean),
        *of([each.result.misfit for each in told], np.median),
        *of([1e3 * each.seconds for each in frames], *BOTH),
    ]


def line(name: str, row: list[float]) -> str:
    counts = "".join(f"{value:9.0f}" for value in row[:4])
    return f"{name[:40]:40s}{counts}" + "".join(f"{value:9.2f}" for value in row[4:])


def main() -> None:
    given = options(
        __doc__,
        parts=(list(PARTS), None, PARTS),
        step=(6, "every so manieth press"),
        out=(Path, "JSON with every line"),
        against=(Path, "the same of before"),
    )
    before = json.loads(given.against.read_text()) if given.against else {}
    found: dict[str, list[float]] = {}
    every: list[Judged] = []

    def tell(name: str, frames: list[Judged]) -> None:
        found[name] = figures(frames)
        print(line(name, found[name]), flush=True)
        if name in before:
            print(line("  before", before[name]), flush=True)
        if given.out:
            given.out.write_text(json.dumps(found))

    print(f"{'':40s}" + "".join(f"{name:>9s}" for name in COLUMNS))
    for part in given.parts:
        for trial in PARTS[part](given.step):
            if not trial.row_period:
                frames = list(judged(make_pipeline(trial.layout), trial))
                tell(f"{part}: {trial.case}", frames)
                every += frames
    tell("all", every)


if __name__ == "__main__":
    main()

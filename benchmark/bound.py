"""Place errors of single contacts beside the Cramer-Rao bound of the same contacts.

    scripts/setup python3 benchmark/bound.py [--profiles accurate ...]

Presses of one contact of parts `channels`, `sheets` and `layouts` of the benchmark (frames of the
reference model, 1 mV, 12 bits, nothing learned). The bound is that of the estimator's own forward model at
the true place, radius and conductance, with sheet and channels unknown as it expects them before any
frame (Fisher information with priors; Van Trees 1968): root of the trace of the covariance of x and y.
An efficient estimate has a median error of 0.83 times that (a normal distribution in the plane). What the
bound leaves out is what the model errs, a sheet that is more uneven than expected, and the contact's
outline on the rim of sheet and electrodes.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tomotactile_ros.bench.sensor import parts
from tomotactile_ros.bench.sensor.trial import Trial
from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.estimation.arrangement import resting
from tomotactile_ros.estimation.equations import Linear
from tomotactile_ros.estimation.estimator import Estimator
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Prediction
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.touch import CONDUCTANCE, Touches, patches_for
from tomotactile_ros.evaluation.scoring import score_frame
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction import Pipeline, Settings

PARTS = "channels", "sheets", "layouts"
_DISC = np.array([[True] * 4 + [False] * 2])


class Bounds:
    """Of contacts on an even sheet of one layout."""

    def __init__(self, layout: Layout):
        used = tuple(range(layout.electrodes))
        settings = Settings(noise=NOISE)
        estimator = Estimator(layout, noise=NOISE, law=LAW, radius=settings.contact_radius)
        self._operator, self._prior = estimator.sensor_of(used, DRIVE)

    def place(self, truth: dict) -> float:
        """m, of a true contact."""
        operator, radius = self._operator, truth["radius"]
        form = np.array([[truth["x"], truth["y"], 0.0, np.log(radius), 0.0, 0.0]])
        across = (patches_for(radius, operator.pitch),)
        touches = Touches(operator, form, across, np.zeros(operator.modes))
        form[0, CONDUCTANCE] = -np.log(1 / truth["conductance"] + touches.mean[0])
        unknowns = resting(operator, self._prior).with_contacts(form, across, _DISC)
        grounded = np.arange(operator.count)
        exact = Prediction(operator, unknowns, grounded, touches)
        weights = np.full(exact.readings.shape, (DRIVE / NOISE) ** 2)
        np.fill_diagonal(weights, 0.0)
        fit = Fit(operator, unknowns, Rows(exact.readings, weights, grounded), self._prior, exact)
        return float(np.sqrt(np.trace(Linear(fit).covariance()[:2, :2])))


def judged(trial: Trial, pipeline: Pipeline, bounds: Bounds):
    """(N,) errors and bounds, m, of its presses, ghosts, and presses that are withheld or missed."""
    errors, best, ghosts, lost = [], [], 0, 0
    for frame, truth in zip(trial.frames, trial.truths, strict=True):
        result = pipeline.process(frame, np.arange(trial.layout.electrodes), DRIVE)
        if truth is None:
            continue
        score = score_frame(result.contacts, truth) if result.state == "valid" else None
        if score is None or score.missed:
            lost += 1
            continue
        ghosts += score.ghosts + score.doubled
        errors.append(float(score.place[0]))
        best.append(bounds.place(truth[0]))
    return np.array(errors), np.array(best), ghosts, lost


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--profiles", nargs="+", default=["accurate"], metavar="PROFILE")
    asked = parser.parse_args()
    rows = []
    for part in PARTS:
        for trial in parts.PARTS[part](1):
            bounds = Bounds(trial.layout)
            for profile in asked.profiles:
                pipeline = Pipeline(trial.layout, Settings(profile, noise=NOISE, contact_law=LAW))
                errors, best, ghosts, lost = judged(trial, pipeline, bounds)
                ratio = np.sqrt(np.mean(errors**2) / np.mean(best**2))
                figures = [1e3 * np.median(errors), 1e3 * np.median(best)]
                figures += [np.median(errors) / np.median(best), ratio]
                cells = [f"{each:.3f}" for each in figures[:2]] + [f"{x:.1f}" for x in figures[2:]]
                rows.append((trial.case, profile, str(ghosts), str(lost), *cells))
    heads = (
        "case",
        "profile",
        "ghosts",
        "missed, withheld",
        "place mm: median",
        "bound mm: median",
    )
    print(*markdown((*heads, "ratio of medians", "of rms"), rows), sep="\n")


if __name__ == "__main__":
    main()

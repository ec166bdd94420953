"""An optimization from its values to its files, as the command line and the ROS node both do it.

`job_of` checks everything and reads the start; `stages` works; `write` writes the layout and the
picture and says in lines what came of it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tomotactile_ros.evaluation.point_spread import LEAST_REGULARIZATION, MOST_CELLS
from tomotactile_ros.evaluation.posterior import MEMORY, SEPARATION, Conditions
from tomotactile_ros.layouts.arrangements import MAX_SPREAD
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.optimizer.constraints import doubts_of
from tomotactile_ros.optimizer.explore import FEWEST, answer, explore
from tomotactile_ros.optimizer.free import SPACING
from tomotactile_ros.optimizer.options import (
    EXPLORE,
    MOST_PROCESSES,
    SCAN,
    command_of,
    named,
    refuse_unknown,
    request_of,
    start_of,
    task_of,
)
from tomotactile_ros.optimizer.request import METHODS
from tomotactile_ros.optimizer.scan import FEW, Chooser, scans, spread
from tomotactile_ros.optimizer.step import ratio
from tomotactile_ros.optimizer.work import Work
from tomotactile_ros.support import checks, memory
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import YAML, check_out, check_picture


@dataclass(frozen=True, eq=False)
class Stage:
    """How far a job is.

    done : of `Job.total`
    note : how it stands, a few words
    hwhm_map : (H, W) HWHM by contact position of the layout under way, m; None: there is none
    """

    done: int
    note: str
    hwhm_map: np.ndarray | None = None


class Job:
    """What all have in common.

    Parameters
    ----------
    values : of `options.OPTIONS`, by name; None where nobody gave one
    mark : before names in complaints: `--` for options of a command line
    """

    label = ""  # of the progress
    total = 1  # stages, that of the start not counted

    def __init__(self, values: Mapping[str, Any], mark: str):
        self.values, self.mark = values, mark
        self.work = Work()  # whoever leaves `stages` stops it
        self._found: list = []  # stage by stage
        self.start: Layout = start_of(values, mark)
        self.out = Path(values["out"])
        self.report = Path(values["report"] or self.out.with_suffix(".png"))
        self.name = self.out.stem
        check_out(values["out"], *YAML)
        check_picture(self.report)
        replace(self.start, name=self.name)  # refuses a name that the layout cannot have

    def stages(self) -> Iterator[Stage]:
        """Work; may be left at any time."""
        raise NotImplementedError

    @property
    def has_result(self) -> bool:
        """Whether there is something to write."""
        return len(self._found) == self.total

    def write(self) -> Iterator[str]:
        """Write layout and picture; lines that say what came of it."""
        raise NotImplementedError


class Move(Job):
    """Electrodes moved by one of the methods."""

    def __init__(self, values: Mapping[str, Any], mark: str):
        super().__init__(values, mark)
        self.request = request_of(self.start, values["method"], values)
        self.label, self.total = self.request.method, self.request.total
        processes = values["workers"] or os.cpu_count() or 1
        if self.label == "touch" and not values["backend"]:
            busy = min(processes, max(self.request.total_starts, 2))  # two look at the start
            electrodes = self.start.electrodes
            memory.check(busy * MEMORY * electrodes, f"{busy} processes at {electrodes} electrodes")
        kept = self.out.with_suffix(".search")
        self.work = Work(processes, values["backend"], kept, values["resume"])
        self._ended = False

    def stages(self) -> Iterator[Stage]:
        for step in self.request.steps_of(self.work):
            self._found.append(step)
            yield Stage(step.iteration, _note(step), step.quality.hwhm_map)
        self._ended = True

    @property
    def has_result(self) -> bool:
        return len(self._found) > 1

    def write(self) -> Iterator[str]:
        from tomotactile_ros.optimizer.report import save_report
        from tomotactile_ros.optimizer.touch_report import save_touch_report

        history, request = self._found, self.request
        best = [step for step in history if step.best][-1]
        command = command_of(request.method, self.values)
        result = request.result(self.name, history, best, command=command)
        result.save(self.out)
        done = history[-1].iteration
        if done < request.total:
            yield f"ended after {done} of {request.total} steps; the best so far is kept"
        if done < request.total and not self._ended:
            yield f"{self.mark}resume, with the same options, goes on"
        else:
            self.work.forget()
        title = f"{self.start.name} -> {self.name}, method {request.method}"
        save = save_report if best.posterior is None else save_touch_report
        save(self.report, history, best, title, request.keep_out)
        yield from _summary(history[0], best)
        spacing = SPACING * result.radius if self.values["spacing"] is None else 0.0
        method = METHODS[0] if request.method == "equalize" else ""
        yield from doubts_of(result, spacing, method, self.mark)
        yield f"{self.out}, {self.report}: step {best.iteration} of {history[-1].iteration}"


class Choose(Job):
    """Scans of fewer rows, of which the last that was asked for is written."""

    label = "ground conditions"

    def __init__(self, values: Mapping[str, Any], mark: str):
        super().__init__(values, mark)
        least = LEAST_REGULARIZATION
        checks.positive(values["regularization"], f"{mark}regularization", "number", least)
        checks.integer(values["resolution"], f"{mark}resolution", 2, MOST_CELLS)
        self._counts = self._numbers()
        for count in self._counts:
            checks.integer(count, f"{mark}conditions", 1, self.start.electrodes)
        self.total = len(self._counts)

    def stages(self) -> Iterator[Stage]:
        self._chooser = Chooser(self.start)
        how = {key: self.values[key] for key in ("regularization", "resolution")}
        for scan in scans(self.start, self._counts, self._chooser, **how):
            self._found.append(scan)
            place = 1e6 * scan.metrics["place"]["mean"]
            note = f"{len(scan.grounded)} rows, place {place:.0f} um"
            yield Stage(len(self._found), note, scan.quality.hwhm_map)

    def write(self) -> Iterator[str]:
        from tomotactile_ros.optimizer.report import save_scans

        layout, found, chooser = self.start, self._found, self._chooser
        yield "conditions  speed  place/um  worst tenth/um  force/%  mean HWHM/mm  position error/mm"
        for each in found:
            place, force = each.metrics["place"], each.metrics["force"]
            images = each.quality.metrics
            yield (
                f"{len(each.grounded):10d} {each.speed:6.2f} {1e6 * place['mean']:9.1f} "
                f"{1e6 * place['worst_tenth']:15.1f} {100 * force['mean']:8.2f} "
                f"{1e3 * images['hwhm']['mean']:13.2f} "
                f"{1e3 * images['position_error']['mean']:18.2f}"
            )
        asked = self.values["conditions"] or self.values["frame_time"] is not None
        scan = found[-1 if asked else 0]
        taken = scan.grounded
        if len(taken) < layout.electrodes:
            yield (
                f"{len(taken)} rows: {1e6 * scan.metrics['place']['mean']:.1f} um, and no choice of as many "
                f"is expected below {1e6 * chooser.least(len(taken)):.1f} um"
            )
        rows = min(FEW, len(taken))
        in_turn, order = (1e3 * chooser.after(list(each)) for each in (np.sort(taken), taken))
        yield (
            f"place error expected from any {rows} successive rows: {order:.2f} mm, {in_turn:.2f} mm with these "
            "electrodes in turn"
        )
        grounding = {str(len(each.grounded)): each.grounded.tolist() for each in found}
        replace(
            layout,
            name=self.name,
            scan=tuple(taken.tolist()),
            provenance=layout.provenance | {"grounding": grounding},
        ).save(self.out)
        save_scans(self.report, found)
        yield f"{self.out}: scan of {len(taken)} rows; provenance.grounding has the others; {self.report}"

    def _numbers(self):
        """Numbers of rows to compare."""
        values, mark, count = self.values, self.mark, self.start.electrodes
        name = named("frame_time", mark)
        if values["frame_time"] is None:
            return values["conditions"] or [
                count >> k for k in range(max(count.bit_length() - 2, 1))
            ]
        if values["conditions"]:
            raise InputError(f"{name}: says how many rows there are, as {mark}conditions does")
        time, period = values["frame_time"], values["row_period"]
        checks.positive(time, name, "time in s")
        checks.positive(period, named("row_period", mark), "time in s")
        rows = min(int(time / period + 1e-9), count)
        if rows < 1:
            raise InputError(f"{name}: {time:g} s is less than one row takes, {period:g} s")
        return [rows]


class Explore(Job):
    """Numbers of electrodes and rows compared, and the fewest that do written."""

    label = "numbers of electrodes"

    def __init__(self, values: Mapping[str, Any], mark: str):
        for count in values[EXPLORE]:
            checks.integer(count, f"{mark}explore", FEWEST, MAX_SPREAD)
        if not values["layout"] and not values["rows"]:  # of the start the sheet alone counts
            values = {**values, "electrodes": values[EXPLORE][0]}
        super().__init__(values, mark)
        if values["place"] is not None:
            checks.length(values["place"], f"{mark}place")
        if values["frame_time"] is not None:
            checks.positive(values["frame_time"], named("frame_time", mark), "time in s")
        self.total = len(values[EXPLORE])

    def stages(self) -> Iterator[Stage]:
        values, start = self.values, self.start
        given = {"noise": values["noise"], "radius": values["contact_radius"]}
        conditions = Conditions(**{key: each for key, each in given.items() if each is not None})
        sheet = start.outline, values[EXPLORE], start.radius, start.sheet_resistance
        for choices in explore(*sheet, values["row_period"], conditions):
            self._found.append(choices)
            whole = choices[-1]
            note = f"{whole.layout.electrodes} electrodes, place {1e6 * whole.place:.0f} um"
            yield Stage(len(self._found), note)

    def write(self) -> Iterator[str]:
        from tomotactile_ros.optimizer.touch_report import save_exploration

        place, frame_time = self.values["place"], self.values["frame_time"]
        every = [each for choices in self._found for each in choices]
        yield "electrodes  rows  frame/ms  place/um  worst tenth/um  force/%"
        for choice in every:
            yield (
                f"{choice.layout.electrodes:10d} {len(choice.rows):5d} {1e3 * choice.frame_time:9.3g} "
                f"{1e6 * choice.place:9.1f} {1e6 * choice.worst_tenth:15.1f} {100 * choice.force:8.2f}"
            )
        limit = "" if frame_time is None else f" within {1e3 * frame_time:g} ms"
        wanted = f"{1e3 * place:g} mm in the worst tenth{limit}"
        best = answer(every, place, frame_time)
        save_exploration(self.report, self._found, place, frame_time, best)
        if best is None:
            raise InputError(
                f"{self.mark}explore: none of these numbers of electrodes is expected to reach {wanted}; "
                f"{self.report} shows what they come to"
            )
        scan = best.rows if len(best.rows) < best.layout.electrodes else ()
        order = tuple(spread(best.layout.positions, scan)) if scan else ()
        replace(best.layout, name=self.name, scan=order, surface=self.start.surface).save(self.out)
        yield (
            f"{self.out}, {self.report}: {best.layout.electrodes} electrodes, {len(best.rows)} rows are "
            f"the fewest that are expected to reach {wanted}"
        )


def job_of(values: Mapping[str, Any], mark: str = "") -> Job:
    """What is to be done with `values`; InputError, with `mark` before names, for what cannot
    be."""
    task = task_of(values)
    refuse_unknown(task, values, mark)
    if values["workers"] is not None and values["backend"] is not None:
        raise InputError(f"{mark}workers: {mark}backend has its own, give only one")
    if values["workers"] is not None:
        checks.integer(values["workers"], f"{mark}workers", 1, MOST_PROCESSES)
    return {EXPLORE: Explore, SCAN: Choose}.get(task, Move)(values, mark)


def _note(step):
    if step.posterior is not None:
        place = step.posterior.metrics["place"]
        return (
            f"place {1e6 * place['mean']:.0f} um, worst tenth {1e6 * place['worst_tenth']:.0f} um, "
            f"score {step.score:.3f}"
        )
    hwhm = step.metrics["hwhm"]
    return (
        f"HWHM {1e3 * hwhm['mean']:.1f} mm, worst tenth {1e3 * hwhm['worst_tenth']:.1f} mm, "
        f"position error {1e3 * step.metrics['position_error']['mean']:.1f} mm"
    )


def _summary(start, best):
    if best.posterior is not None:
        yield from _expected(start.posterior, best.posterior)
        if best is start:
            yield "no step was better: the layout to start from is as good"
        yield "images of eq. 1, which this method does not optimize:"
    for label, group, key in (
        ("mean HWHM", "hwhm", "mean"),
        ("HWHM of the worst tenth", "hwhm", "worst_tenth"),
        ("HWHM of the worst region", "hwhm", "worst_region"),
        ("mean position error", "position_error", "mean"),
    ):
        before, after = start.metrics[group][key], best.metrics[group][key]
        yield f"{label:26} {1e3 * before:7.2f} -> {1e3 * after:7.2f} mm  x {ratio(before, after):.3f}"


def _expected(before, after):
    """What is expected of contacts, at places that the search did not see."""
    room = "" if len(after.pairs) else ", none of which has room"
    yield f"expected of contacts, pairs {plain(1e3 * after.conditions.apart)} mm apart{room}:"
    for label, group, key, scale, unit in (
        ("mean place error", "place", "mean", 1e6, "um"),
        ("place, worst tenth", "place", "worst_tenth", 1e6, "um"),
        ("mean force error", "force", "mean", 100, "%"),
        ("mean d' of pairs", "separation", "mean", 1, ""),
    ):
        if not before.metrics[group]:
            continue
        old, new = (scale * each.metrics[group][key] for each in (before, after))
        yield f"{label:26} {old:7.2f} -> {new:7.2f} {unit:2}  x {ratio(old, new):.3f}"
    better = ratio(before.score, after.score)
    yield f"{'both place errors and pairs':47}  x {better:.3f} (1: the start is as good); {SEPARATION}"

"""One frame in, one result out: checks, tare, channels, image, contacts, pressure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from tomotactile_ros import memory
from tomotactile_ros.errors import InputError
from tomotactile_ros.estimation.estimator import Estimator, State
from tomotactile_ros.grid import Grid
from tomotactile_ros.layout import Layout
from tomotactile_ros.reconstruction.channels import (
    broken_channels,
    dead_channels,
    is_doubtful,
    is_doubtful_subset,
    swapped_channels,
)
from tomotactile_ros.reconstruction.completion import read_incomplete, read_rows
from tomotactile_ros.reconstruction.estimate import Strength, contacts_and_pressure, disc_cells
from tomotactile_ros.reconstruction.frames import check_drive_voltage, is_idle, ordered
from tomotactile_ros.reconstruction.images import ImageMaker
from tomotactile_ros.reconstruction.linear import LinearImage
from tomotactile_ros.reconstruction.model import Model
from tomotactile_ros.reconstruction.profiles import MEASURED, choose, median_times, trial_frame
from tomotactile_ros.reconstruction.rows import scanned_rows
from tomotactile_ros.reconstruction.settings import ContactEstimate, Result, Settings

JOINT = "joint"  # the profile whose contacts are fitted to the readings, not read from an image
_EXPLAINED = (
    5e-3  # of the readings' sum of squares that an image of wide contacts may leave: 7 % of each
)
_KEPT = 8  # regularised inverses for patterns of missing readings


class Pipeline:
    """Reconstruction for one layout.

    Attributes
    ----------
    layout, settings, grid : what it was made for
    profile : the profile in use
    report : one line for the log
    """

    def __init__(self, layout: Layout, settings: Settings, *, model: Model | None = None):
        self.layout, self.settings = layout, settings
        if max(settings.excluded, default=0) >= layout.electrodes:
            raise InputError(
                f"excluded: electrode {max(settings.excluded)} does not exist, "
                f"{layout.name} has 0 to {layout.electrodes - 1}"
            )
        _check_memory(layout.electrodes, settings.resolution)
        self.grid = Grid.for_outline(layout.outline, settings.resolution)
        self.profile = settings.profile
        self._model = model or Model(layout, self.grid, settings.model, settings.noise)
        self._excluded = np.zeros(layout.electrodes, bool)
        self._excluded[list(settings.excluded)] = True
        left = int(np.count_nonzero(~self._excluded))
        if left < 2:
            raise InputError(f"excluded: {left} of {self._excluded.size} electrodes left, need 2")
        self._left_out = self._excluded  # in the last frame
        self._linear: dict[bytes, LinearImage] = {}
        self._baseline: np.ndarray | None = None
        if settings.regularization is not None:
            self._linear_for(np.empty(0, int))
        self._model.local(np.flatnonzero(~self._excluded))
        self.report = f"profile {self.profile}"
        if settings.profile == "auto":
            self.profile, self.report = self._measure_profiles()
        kind = "accurate" if self.profile == JOINT else self.profile
        self._make_image = ImageMaker(kind, self._model, settings.contact_radius)
        self._estimator, self._state = None, State()
        if self.profile == JOINT and settings.regularization is None:
            self._estimator = self._make_estimator()

    def _make_estimator(self) -> Estimator:
        settings = self.settings
        return Estimator(
            self.layout,
            noise=settings.noise,
            law=settings.contact_law,
            radius=settings.contact_radius,
            model=settings.model,
            excluded=settings.excluded,
        )

    def with_settings(self, settings: Settings) -> Pipeline:
        """The same layout with other settings; keeps the tare and what else can be kept."""
        keys = ("resolution", "model", "noise")
        same = all(getattr(settings, key) == getattr(self.settings, key) for key in keys)
        other = Pipeline(self.layout, settings, model=self._model if same else None)
        other._baseline = self._baseline
        return other

    def tare(self, frames: Iterable[tuple[np.ndarray, np.ndarray]]) -> None:
        """Take the mean of untouched `frames`, pairs (voltages, grounded), off all that follow."""
        stack = np.array([ordered(self.layout, *frame) for frame in frames])
        if not len(stack):
            raise InputError("tare: needs at least one frame")
        valid = np.isfinite(stack)
        total = np.where(valid, stack, 0.0).sum(axis=0)
        self._baseline = total / np.maximum(np.count_nonzero(valid, axis=0), 1)
        self._forget()

    def untare(self) -> None:
        """Forget the tare."""
        self._baseline = None
        self._forget()

    def _forget(self) -> None:
        """Start the next frame from scratch."""
        self._make_image.forget()
        self._state.forget()

    def process(self, voltages, grounded, drive_voltage: float) -> Result:
        """Reconstruct one frame.

        Parameters
        ----------
        voltages : (L, E) V; NaN where there is no valid reading
        grounded : (L,) grounded electrode of each row, any subset in any order
        drive_voltage : V

        Raises InputError where the frame does not fit the layout.
        """
        drive_voltage = check_drive_voltage(drive_voltage)
        if self._estimator is not None:
            return self._estimated(voltages, grounded, drive_voltage)
        return self._imaged(voltages, grounded, drive_voltage)

    def _estimated(self, voltages, grounded, drive_voltage) -> Result:
        """What the estimator says; wide contacts as the image shows them, if that explains the readings."""
        estimate = self._estimate(voltages, grounded, drive_voltage)
        if estimate.state != "valid":
            estimate = self._without_contradicting(estimate, voltages, grounded, drive_voltage)
        bad = np.zeros(self.layout.electrodes, bool)
        bad[list(estimate.left_out)] = True
        if estimate.state != "valid":
            return self._wide(voltages, grounded, drive_voltage) or self._withheld(estimate, bad)
        idle = not estimate.contacts
        contacts = [_reported(each) for each in estimate.contacts]
        pressure = np.zeros(len(self.grid.pixels))
        conductance = np.zeros_like(pressure)
        for each in estimate.parts:
            pixels, covered = disc_cells(np.array([each.x, each.y]), each.radius, self.grid)
            covered = covered / covered.sum()
            pressure[pixels] += each.force * covered / self.grid.cell_area
            conductance[pixels] += each.conductance * covered
        typical = self._model.local(np.flatnonzero(~bad)).typical_impedance
        potential = drive_voltage * np.minimum(conductance * typical, 1.0)
        return Result(
            self.grid.fill(potential),
            self.grid.fill(pressure),
            contacts,
            _numbers(bad),
            idle,
            0.0,
            misfit=estimate.misfit,
            faults=estimate.left_out,
        )

    def _without_contradicting(self, estimate, voltages, grounded, drive_voltage):
        """The estimate without channels whose couplings no sheet has, swapped wires for example, if that explains more."""
        bad = self._read(voltages, grounded, drive_voltage)[1]
        bad[list(estimate.left_out)] = False
        if not bad.any():
            return estimate
        kept = np.array(voltages, float)
        kept[:, bad] = np.nan
        kept[bad[np.asarray(grounded)]] = np.nan
        again = self._estimate(kept, grounded, drive_voltage)
        if again.state != "valid":
            return estimate
        again.left_out.update(dict.fromkeys(_numbers(bad), "its couplings contradict all others"))
        return again

    def _wide(self, voltages, grounded, drive_voltage) -> Result | None:
        """What the image shows of contacts that no few discs explain; None where it does not explain the readings either."""
        frame, bad, local, measured = self._read(voltages, grounded, drive_voltage)
        if measured is None or bad.any() or np.isnan(frame[~np.eye(len(frame), dtype=bool)]).any():
            return None
        image = self._make_image(local, measured)
        if image.exact is None or not (image.exact > 0).any():
            return None
        left = frame / drive_voltage - local.meter.sheet.readings(image.exact)
        np.fill_diagonal(left, 0.0)
        np.fill_diagonal(frame, 0.0)
        if (left**2).sum() > _EXPLAINED * ((frame / drive_voltage) ** 2).sum():
            return None
        return self._imaged(voltages, grounded, drive_voltage)

    def _estimate(self, voltages, grounded, drive_voltage):
        frame = ordered(self.layout, voltages, grounded)
        if self._baseline is not None:
            frame = frame - self._baseline
        rows = np.asarray(grounded, int)
        return self._estimator.estimate(frame[rows], rows, drive_voltage, self._state)

    def _withheld(self, estimate, bad) -> Result:
        unknown = self.grid.fill(np.full(len(self.grid.pixels), np.nan))
        return Result(
            unknown,
            unknown.copy(),
            [],
            _numbers(bad),
            False,
            0.0,
            state=estimate.state,
            reason=estimate.reason,
            misfit=estimate.misfit,
            faults=estimate.left_out,
        )

    def _imaged(self, voltages, grounded, drive_voltage) -> Result:
        """The image, and contacts from its blobs."""
        frame, bad, local, measured = self._read(voltages, grounded, drive_voltage)
        if measured is None:
            self._make_image.forget()
            return self._idle(bad)
        if not np.array_equal(bad, self._left_out):
            self._make_image.forget()
            self._left_out = bad
        if self.settings.regularization is None:
            image = self._make_image(local, measured)
            level = local.regularization(local.level(measured))
            potential = drive_voltage * np.minimum(image.values * local.typical_impedance, 1.0)
        else:
            frame[bad] = np.nan
            frame[:, bad] = np.nan
            potential = self._one_step(frame)
            image = self._make_image.described(local, measured, potential)
            level = self.settings.regularization
        contacts, pressure = contacts_and_pressure(
            image.blobs, image.values, image.strengths, self.settings.contact_law, self.grid
        )
        return Result(
            self.grid.fill(potential),
            self.grid.fill(pressure),
            contacts,
            _numbers(bad),
            False,
            level,
        )

    def strengths(self, voltages, grounded, drive_voltage: float) -> list[Strength]:
        """How strongly each contact of a frame conducts, strongest first; arguments as for `process`."""
        drive_voltage = check_drive_voltage(drive_voltage)
        if self._estimator is not None:
            estimate = self._estimate(voltages, grounded, drive_voltage)
            found = [
                Strength(np.array([each.x, each.y]), each.conductance, each.area, True)
                for each in estimate.contacts
            ]
            return sorted(found, key=lambda strength: -strength.conductance)
        _, _, local, measured = self._read(voltages, grounded, drive_voltage)
        found = [] if measured is None else self._make_image(local, measured).strengths
        return sorted(found, key=lambda strength: -strength.conductance)

    def _read(self, voltages, grounded, drive_voltage):
        """Ordered frame (E, E), channels left out (E,), `LocalImage`, `Grounded`; None for both if idle."""
        frame = ordered(self.layout, voltages, grounded)
        if self._baseline is not None:
            frame -= self._baseline
        bad = self._excluded.copy()
        missing = np.isnan(frame)
        if np.count_nonzero(missing) > len(frame):
            bad |= dead_channels(~missing)
        if is_idle(frame, missing, bad, self.settings.threshold * self.settings.noise):
            return frame, bad, None, None
        return frame, bad, *self._measure(frame, bad, drive_voltage)

    def _measure_profiles(self):
        """The profile to use, and a line for the log."""
        trial = trial_frame(self._model.transfer, self.layout.sheet_resistance, self.settings.noise)
        grounded, works = np.arange(self.layout.electrodes), {}
        for profile in MEASURED:
            settings = replace(self.settings, profile=profile)
            other = Pipeline(self.layout, settings, model=self._model)
            works[profile] = partial(other._process_anew, trial, grounded, 3.3)
        return choose(median_times(works), self.settings.deadline)

    def _process_anew(self, *frame):
        self._forget()
        return self.process(*frame)

    def _measure(self, frame, bad, drive_voltage):
        """`LocalImage` and `Grounded` of the good channels; broken ones are added to `bad` (E,)."""
        used = np.flatnonzero(~bad)
        for attempt in range(2):
            if len(used) < 2:
                return None, None
            local = self._model.local(used)
            part = frame if len(used) == len(frame) else frame[np.ix_(used, used)]
            if self.profile == "fast":
                part = part.astype(np.float32)
            if np.count_nonzero(np.isnan(part)) > len(used):
                measured, doubtful = self._measure_rows(local, part, drive_voltage)
                doubtful = doubtful and attempt == 0
            else:
                measured = local.meter.read(part, drive_voltage)
                doubtful = attempt == 0 and is_doubtful(
                    local.meter, part, measured, self.settings.noise
                )
            if doubtful:
                broken = broken_channels(part, drive_voltage, self.settings.noise)
                if not broken.any() and measured is not None:
                    broken = swapped_channels(local.meter, part, drive_voltage, measured)
                if broken.any():
                    bad[used[broken]] = True
                    used = used[~broken]
                    continue
            if measured is None:
                measured = read_incomplete(local.meter, local, part, drive_voltage)
            return local, measured

    def _measure_rows(self, local, part, drive_voltage):
        """`Grounded` of whole rows, None where single readings are missing; whether it is doubtful."""
        scanned = scanned_rows(part)
        if scanned is None:
            return None, True
        measured = read_rows(local, part, scanned, drive_voltage, self.profile != "fast")
        if measured.couplings is None:
            return measured, True
        return measured, is_doubtful_subset(part[scanned], measured, self.settings.noise)

    def _idle(self, bad) -> Result:
        zero = self.grid.fill(np.zeros(len(self.grid.pixels)))
        level = self.settings.regularization
        return Result(zero, zero.copy(), [], _numbers(bad), True, 0.0 if level is None else level)

    def _one_step(self, frame):
        """(K,) image of eq. 1, V, of an ordered frame (E, E)."""
        valid = np.isfinite(frame)
        missing = ~valid
        np.fill_diagonal(missing, False)
        linear = self._linear_for(np.flatnonzero(missing))
        return linear.image(np.where(valid, frame, 0.0).ravel()).astype(float)

    def _linear_for(self, missing) -> LinearImage:
        key = missing.tobytes()
        if key not in self._linear:
            if len(self._linear) >= _KEPT:
                self._linear.pop(next(iter(self._linear)))
            level = self.settings.regularization
            self._linear[key] = LinearImage(self._model.basis(level), level, missing)
        return self._linear[key]


def _check_memory(electrodes: int, resolution: int) -> None:
    """Measured: 18 arrays of electrodes x cells and 100 of electrodes x electrodes."""
    needed = 8.0 * electrodes * (18.0 * resolution**2 + 100.0 * electrodes)
    memory.check(needed, f"layout: {electrodes} electrodes at resolution {resolution}")


def _reported(contact) -> ContactEstimate:
    """The estimator's contact as a result shows it."""
    return ContactEstimate(
        contact.x,
        contact.y,
        contact.force,
        contact.pressure,
        contact.area,
        contact.radius,
        contact.covariance,
        contact.force_std,
        contact.probability,
    )


def _numbers(bad) -> tuple[int, ...]:
    return tuple(np.flatnonzero(bad).tolist())

"""One frame in, one result out: checks, tare, image, contacts, pressure."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tomotactile_ros.errors import InputError
from tomotactile_ros.grid import Grid
from tomotactile_ros.layout import Layout
from tomotactile_ros.reconstruction.basis import FrameBasis
from tomotactile_ros.reconstruction.contacts import find_blobs
from tomotactile_ros.reconstruction.linear import LinearImage
from tomotactile_ros.reconstruction.settings import ContactEstimate, Result, Settings
from tomotactile_ros.reconstruction.strength import contact_conductance
from tomotactile_ros.sheet import make_sheet

_LEAST_READINGS = 8  # valid readings that a frame needs to be more than idle
_FLOOR = 0.4  # of the image's maximum; what is below is no contact
_PROMINENCE = 0.2
_CELL_RADIUS = 0.447  # of the disc with the mean log distance of a square to itself, in sides


class Pipeline:
    """Reconstruction for one layout.

    Attributes
    ----------
    layout, settings, grid : what it was made for
    profile : the profile in use
    report : one line for the log
    """

    def __init__(self, layout: Layout, settings: Settings, *, _shared=None):
        self.layout, self.settings = layout, settings
        if max(settings.excluded, default=0) >= layout.electrodes:
            raise InputError(
                f"excluded: electrode {max(settings.excluded)} does not exist, "
                f"{layout.name} has 0 to {layout.electrodes - 1}"
            )
        self.grid = Grid.for_outline(layout.outline, settings.resolution)
        self.profile = "fast" if settings.profile == "auto" else settings.profile
        if _shared is None:
            sheet = make_sheet(layout, settings.model)
            radius = _CELL_RADIUS * np.sqrt(self.grid.cell_area)
            transfer = sheet.transfer(self.grid.pixels, radius)
            _shared = sheet, transfer, FrameBasis(transfer)
        self._sheet, self._transfer, self._basis = self._shared = _shared
        self.regularization = 1000.0 if settings.regularization is None else settings.regularization
        self._linear: dict[bytes, LinearImage] = {}
        self._baseline: np.ndarray | None = None
        self.report = f"profile {self.profile}, regularization {self.regularization:g}"

    def with_settings(self, settings: Settings) -> Pipeline:
        """The same layout with other settings; keeps the tare and what else can be kept."""
        same = (settings.resolution, settings.model) == (
            self.settings.resolution,
            self.settings.model,
        )
        other = Pipeline(self.layout, settings, _shared=self._shared if same else None)
        other._baseline = self._baseline
        return other

    def tare(self, frames: Iterable[tuple[np.ndarray, np.ndarray]]) -> None:
        """Take the mean of untouched `frames`, pairs (voltages, grounded), off all that follow."""
        full = [self._ordered(*self._checked(*frame)) for frame in frames]
        if not full:
            raise InputError("tare: needs at least one frame")
        stack = np.array(full)
        valid = np.isfinite(stack)
        total = np.where(valid, stack, 0.0).sum(axis=0)
        self._baseline = total / np.maximum(valid.sum(axis=0), 1)

    def untare(self) -> None:
        """Forget the tare."""
        self._baseline = None

    def process(self, voltages, grounded, drive_voltage: float) -> Result:
        """Reconstruct one frame.

        Parameters
        ----------
        voltages : (L, E) V; NaN where there is no valid reading
        grounded : (L,) grounded electrode of each row, any subset in any order
        drive_voltage : V

        Raises InputError where the frame does not fit the layout.
        """
        voltages, grounded = self._checked(voltages, grounded)
        if not (np.isfinite(drive_voltage) and drive_voltage > 0):
            raise InputError(f"drive_voltage: {drive_voltage!r} is not a positive voltage in V")
        frame = self._ordered(voltages, grounded)
        if self._baseline is not None:
            frame = frame - self._baseline
        frame[:, list(self.settings.excluded)] = np.nan
        valid = np.isfinite(frame)
        excluded = self._excluded(valid, grounded)
        if self._is_idle(frame, valid):
            return self._idle(excluded)
        missing = np.flatnonzero(~valid & ~np.eye(len(frame), dtype=bool))
        linear = self._linear_for(missing)
        potential = linear.image(np.where(valid, frame, 0).ravel().astype(np.float32))
        image = self.grid.fill(potential.astype(float), outside=0.0)
        pressure, contacts = self._contacts(image, frame, drive_voltage)
        outside = ~self.grid.inside
        image[outside] = np.nan
        pressure[outside] = np.nan
        return Result(image, pressure, contacts, excluded, False, self.regularization)

    def _checked(self, voltages, grounded):
        electrodes = self.layout.electrodes
        voltages = np.asarray(voltages)
        grounded = np.asarray(grounded)
        if voltages.ndim != 2 or voltages.shape[1] != electrodes:
            raise InputError(
                f"voltages: shape {voltages.shape} does not fit {self.layout.name}, "
                f"it needs (rows, {electrodes})"
            )
        if grounded.shape != (len(voltages),):
            raise InputError(
                f"grounded: shape {grounded.shape}, one electrode for each of the "
                f"{len(voltages)} rows is needed"
            )
        grounded = grounded.astype(int)
        if len(grounded) and not (0 <= grounded.min() and grounded.max() < electrodes):
            raise InputError(f"grounded: electrodes of {self.layout.name} are 0 to {electrodes - 1}")
        if len(np.unique(grounded)) < len(grounded):
            raise InputError("grounded: an electrode is named twice")
        return voltages, grounded

    def _ordered(self, voltages, grounded):
        """(E, E) frame with row l for ground condition l; NaN where nothing valid was read."""
        frame = np.full((self.layout.electrodes,) * 2, np.nan)
        frame[grounded] = voltages
        frame[np.abs(frame) > 1e3] = np.nan
        np.fill_diagonal(frame, np.nan)
        return frame

    def _excluded(self, valid, grounded):
        read = valid[grounded].any(axis=0)
        if len(grounded) == 1:
            read[grounded] = True
        return tuple(int(e) for e in np.flatnonzero(~read))

    def _is_idle(self, frame, valid) -> bool:
        if np.count_nonzero(valid) < _LEAST_READINGS:
            return True
        read = valid.any(axis=0)
        sums = np.where(valid, frame, 0.0).sum(axis=0)[read]
        means = sums / np.count_nonzero(valid, axis=0)[read]
        return np.median(means) < self.settings.threshold * self.settings.noise

    def _idle(self, excluded) -> Result:
        zero = self.grid.fill(np.zeros(len(self.grid.pixels)))
        return Result(zero, zero.copy(), [], excluded, True, self.regularization)

    def _linear_for(self, missing) -> LinearImage:
        key = missing.tobytes()
        if key not in self._linear:
            if len(self._linear) >= 8:
                self._linear.pop(next(iter(self._linear)))
            self._linear[key] = LinearImage(self._basis, self.regularization, missing)
        return self._linear[key]

    def _contacts(self, image, frame, drive_voltage):
        """(H, W) pressure and the contacts of a potential image (0 outside)."""
        pressure = np.zeros(image.shape)
        top = image.max()
        if not top > 0:
            return pressure, []
        blobs = find_blobs(image, self.grid, _FLOOR * top, _PROMINENCE)
        radius = np.full(len(blobs), self.settings.contact_radius)
        transfer = self._sheet.transfer(np.array([blob.position for blob in blobs]), radius)
        rows = np.flatnonzero(np.isfinite(frame).any(axis=1))
        conductance = contact_conductance(transfer, frame[rows], rows, drive_voltage)
        area = np.pi * radius**2
        peaks = self.settings.contact_law.pressure(conductance / area)
        contacts = []
        for blob, peak, size, reach in zip(blobs, peaks, area, radius):
            shape = image.ravel()[blob.pixels]
            force = peak * size
            pressure.ravel()[blob.pixels] = force * shape / (shape.sum() * self.grid.cell_area)
            x, y = blob.position
            contacts.append(
                ContactEstimate(
                    float(x),
                    float(y),
                    float(force),
                    float(peak),
                    float(blob.area),
                    float(np.sqrt(blob.area / np.pi)),
                )
            )
        return pressure, sorted(contacts, key=lambda contact: -contact.force)



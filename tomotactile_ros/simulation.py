"""Frames of a scene on a layout, with all the defects that the scene names.

Rows are taken one after another, each of the sheet as it is at its own time. Physics first
(`sheet`), then the measurement in the order in which hardware does it: wiring, what a row keeps of
the one before, noise and hum on the wire, gain, offset and drift of the amplifier, stuck channels,
conversion, dead channels. What a scene does not name costs nothing. The same scene, seed, time and
sequence number give the same frame on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tomotactile_ros.frame import Frame
from tomotactile_ros.layouts.layout import Layout, check_layout
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import resistance_of
from tomotactile_ros.scenes.touches import Touches
from tomotactile_ros.sheet import MODELS, make_sheet
from tomotactile_ros.sheet.contact_points import Patches, contact_points
from tomotactile_ros.sheet.merge import Track
from tomotactile_ros.sheet.moving_rows import moving_rows
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError, complaints_at

ROW_PERIOD = 1e-3  # s for one ground condition, the switching of Kojima et al. 2023 (1 kHz)
_ELEMENTS = 80  # along the longer side: 0.3 % of the drive voltage, see docs/model.md
_PATCHES = 60  # along the longer side, for the patches of wide contacts
_ACROSS = 4, 24  # of them to the width of the smallest and of the widest contact
_WIDEST = 1.5  # longer sides: patches of wider contacts are coarser than electrodes are apart
_TINY = 1e-6  # keeps counts of patches from rounding either way
_HORIZON = 60.0  # s of motion that are solved ahead
MOST_ELECTRODES = 1024  # as are reconstructed; the work grows faster than with their square
MOST_PATCHES = 4000  # that touch at the same time: a frame is a dense system of so many unknowns


class Simulator:
    """A sensor with `layout` under `scene`.

    Parameters
    ----------
    layout, scene : what to simulate
    model : `fem` by default, so that data and images never share a model; or of `sheet.MODELS`
    h : element size of the mesh, m
    row_period : s from one row to the next; 0 for frames that are taken all at once
    order : electrodes that are grounded, row after row, in any order and as often as one likes;
        that of the layout's scan without it

    Raises InputError where the scene does not fit the layout or the model cannot do what it names.
    """

    def __init__(
        self,
        layout: Layout,
        scene: Scene,
        model: str = "fem",
        *,
        h: float | None = None,
        row_period: float = ROW_PERIOD,
        order: Sequence[int] | None = None,
    ):
        check_layout(layout)
        checks.instance(scene, "scene", Scene, "load_scene reads one from its file")
        if model not in MODELS:
            raise InputError(f"model: {model!r} is none of {', '.join(MODELS)}")
        if layout.electrodes > MOST_ELECTRODES:
            raise InputError(
                f"layout: {layout.name} has {layout.electrodes} electrodes, at most "
                f"{MOST_ELECTRODES} are simulated"
            )
        scene.check(layout)
        self.layout, self.scene = layout, scene
        self.row_period = checks.not_negative(row_period, "row_period", "time in s")
        self.grounded = (
            layout.grounded if order is None else checks.order(order, "order", layout.electrodes)
        )
        longest = max(layout.outline.size)
        self.sheet = self._make_sheet(model, h or longest / _ELEMENTS)
        self._step = longest / _PATCHES
        for i, contact in enumerate(scene.contacts):
            if contact.width > _WIDEST * longest:
                raise InputError(
                    f"scene {scene.name}: contacts[{i}]: {contact.width:g} m wide on a sheet of "
                    f"{longest:g} m, at most {_WIDEST:g} times the sheet is simulated"
                )
        self._across = [patches_across(contact, longest) for contact in scene.contacts]
        self.live: Touches | None = None  # what presses from outside, beside the scene's contacts
        self.sheet.prepare(self._paths())
        self._set_wiring()
        self._kept: tuple[list, np.ndarray] | None = None
        self._check_patches([now for each in scene.contacts if (now := each.at(0.0)) is not None])

    def _set_wiring(self):
        """What hangs on each electrode: its wire, its channel, what lies between it and ground."""
        defects, electrodes = self.scene.defects, self.layout.electrodes
        self._wire = np.arange(electrodes)  # electrode that each channel is connected with
        for first, second in defects.swapped:
            self._wire[[first, second]] = self._wire[[second, first]]
        self._channels = defects.channels.of(electrodes)
        self._to_ground = np.full(electrodes, float(defects.switch_resistance))
        if self._channels.ground_resistance is not None:
            self._to_ground += self._channels.ground_resistance
        self._to_ground[self._channels.open] = np.inf

    def _make_sheet(self, model, h):
        """The sheet as the scene has it; tears are as wide as half an element at least."""
        uneven, width = self.scene.defects.sheet, h / 2
        with complaints_at(f"scene {self.scene.name}: "):
            made = self.scene.defects.made(self.layout)
        return make_sheet(
            made,
            model,
            resistance=resistance_of(made, uneven, self.scene.defects.sheet_variation, width),
            anisotropy=uneven.anisotropy,
            lines=uneven.rims(width),
            h=h,
        )

    def sheet_factor(self, t: float) -> float:
        """Sheet resistance at the time `t` (s), in parts of what it is without temperature."""
        temperature = self.scene.defects.sheet.temperature
        return 1.0 if temperature is None else float(temperature.factor(t))

    @property
    def model(self) -> str:
        """Name of the model that makes the frames."""
        return self.sheet.model

    def measure(self, t: float, sequence: int = 0) -> Frame:
        """The frame that starts at `t` (s), with its times; see `frame`."""
        voltages = self.frame(t, sequence)
        drive = self.scene.drive_voltage
        return Frame(voltages, self.grounded, sequence, float(t), drive, self.row_period)

    def frame(self, t: float, sequence: int = 0) -> np.ndarray:
        """(L, E) voltages, V, of the frame that starts at `t` (s); NaN: no valid reading.

        Row i shows the sheet at `t + i * row_period`. `sequence` numbers the frame: it chooses the
        noise.
        """
        return self._measure(t, self.grounded, self.grounded[-1], sequence)

    def scanned(
        self, row_period: float, order: Sequence[int] | np.ndarray, t: float, sequence: int
    ) -> np.ndarray:
        """`frame` of an `order` of the scan and a `row_period`, s, that hold from now on."""
        self.row_period, self.grounded = row_period, np.asarray(order)
        return self.frame(t, sequence)

    def row(
        self, t: float, electrode: int, sequence: int = 0, before: int | None = None
    ) -> np.ndarray:
        """(E,) voltages, V, of a single row that is taken at `t` (s) with `electrode` grounded.

        Parameters
        ----------
        sequence : number of the row, chooses its noise
        before : the electrode that was grounded one row period earlier, for scenes whose channels
            do not settle; the one in front of `electrode` in the scan without it
        """
        grounded = checks.order([electrode], "order", self.layout.electrodes)
        if before is None:
            place = np.flatnonzero(self.grounded == electrode)
            before = self.grounded[place[0] - 1] if len(place) else electrode
        return self._measure(t, grounded, before, sequence)[0]

    def rows(self, t: float, first: int, last: int, sequence: int = 0) -> np.ndarray:
        """(last - first, E) voltages, V, of these rows of the frame that starts at `t` (s).

        As of `frame`, but for the noise, which is another one for other rows.
        """
        grounded = self.grounded[first:last]
        before = self.grounded[first - 1]
        return self._measure(t + first * self.row_period, grounded, before, sequence, first)

    def ideal_frame(self, t: float) -> np.ndarray:
        """(L, E) voltages before anything is wrong with their measurement."""
        rows = self._rows(t + self.row_period * np.arange(len(self.grounded)), self.grounded)
        if not self.scene.own_reading:
            rows[np.arange(len(rows)), self.grounded] = np.nan
        return rows

    def _measure(self, t, grounded, before, *number):
        """(L, E) readings of rows from `t` on; `before` was grounded in the row before them.

        `number` chooses the noise.
        """
        defects, scene, channels = self.scene.defects, self.scene, self._channels
        times = t + self.row_period * np.arange(len(grounded))
        if channels.settling is None:
            voltages = self._rows(times, self._wire[grounded])
        else:
            scan = self._wire[np.concatenate([[before], grounded])]
            voltages = self._rows(np.concatenate([[t - self.row_period], times]), scan)
        if defects.swapped:
            voltages = voltages[:, self._wire]
        if channels.settling is not None:
            voltages = channels.settled(voltages)
        if not scene.own_reading:
            voltages[np.arange(len(grounded)), grounded] = np.nan
        if scene.noise is not None and scene.noise.rms > 0:
            random = np.random.default_rng([scene.noise.seed, *number])
            voltages += scene.noise.rms * random.standard_normal(voltages.shape)
        if defects.hum is not None:
            hum = defects.hum.amplitude * np.sin(2 * np.pi * defects.hum.frequency * times)
            voltages += hum[:, None]
        channels.amplify(voltages)
        if defects.drift is not None:
            drift = defects.drift
            phases = 2 * np.pi * np.random.default_rng(drift.seed).random(voltages.shape[1])
            voltages += drift.amplitude * np.sin(2 * np.pi * times[:, None] / drift.period + phases)
        channels.stick(voltages)
        if scene.adc is not None:
            voltages = convert(voltages, scene.adc.bits, scene.adc.range)
        voltages[:, list(defects.dead)] = np.nan
        return voltages

    def _rows(self, times, grounded):
        """(L, E) potentials of all electrodes at `times` (L,), each with its own one grounded."""
        if not self._changes(times.min(), times.max()):
            return self._resting(times[0])[grounded]
        tracks = self._tracks(times)
        factors = np.array([self.sheet_factor(t) for t in times])
        columns = [factors[:, None]]
        for track in tracks:
            there = track.there[:, None]
            columns += [there, *(np.where(there, x, 0) for x in (track.centers, track.conductance))]
        state = np.concatenate(columns, axis=1)
        begins = np.append(True, (state[1:] != state[:-1]).any(axis=1))
        ends = np.append(begins[1:], True)
        out = np.empty((len(times), self.layout.electrodes))
        for first, last in zip(np.flatnonzero(begins & ~ends), np.flatnonzero(ends & ~begins)):
            same = slice(first, last + 1)
            out[same] = self._resting(times[first])[grounded[same]]
        alone = np.flatnonzero(begins & ends)
        if len(alone):
            out[alone] = moving_rows(
                self.sheet,
                [track.states(alone) for track in tracks],
                grounded[alone],
                self.scene.drive_voltage,
                self._to_ground[grounded[alone]] / factors[alone],
            )
        return out

    def _resting(self, t):
        """(E, E) potentials, each electrode grounded in turn while all is as at `t` (s); kept."""
        factor = self.sheet_factor(t)
        touching, state = [], [factor]
        for contact in (*self.scene.contacts, *self._live(t)):
            now = contact.at(t)
            if now is not None:
                touching.append(now)
                state.append((contact, *now.center, now.felt))
        if self._kept is None or state != self._kept[0]:
            self._check_patches(touching)
            voltages = frame(
                *contact_points(self.sheet, [self._contact(now, factor) for now in touching]),
                self.scene.drive_voltage,
                switch_resistance=self._to_ground / factor,
                own_reading=True,
            )
            self._kept = state, voltages
        return self._kept[1]

    def _changes(self, first: float, last: float) -> bool:
        """Whether anything on the sheet may change between two times, s, both included."""
        return (
            self.live is not None
            or self.scene.defects.sheet.temperature is not None
            or any(contact.changes(first, last) for contact in self.scene.contacts)
        )

    def _live(self, t: float) -> tuple[Contact, ...]:
        """What presses from outside at the time `t` (s)."""
        return () if self.live is None else self.live.at(t)

    def _contact(self, contact: Contact, factor: float) -> tuple[Patches, np.ndarray]:
        """What `contact_points` takes of a contact as it is now.

        Voltages are ratios of resistances: where that of the sheet is `factor` times what it was,
        contacts (and wires) act as if theirs was divided by it.
        """
        across = patches_across(contact, max(self.layout.outline.size))
        return contact.patches(across), factor * contact.conductance(self.scene.contact_law, across)

    def _check_patches(self, touching: list[Contact]) -> None:
        """Refuse more contacts at the same time than can be solved in seconds."""
        longest = max(self.layout.outline.size)
        count = sum(len(each.patches(patches_across(each, longest))[1]) for each in touching)
        if count > MOST_PATCHES:
            raise InputError(
                f"scene {self.scene.name}: contacts: {len(touching)} at the same time, in {count} "
                f"patches, at most {MOST_PATCHES} patches are simulated"
            )

    def _tracks(self, times: np.ndarray) -> list[Track]:
        """All contacts at `times` (T,), s."""
        law, longest = self.scene.contact_law, max(self.layout.outline.size)
        factors = np.array([self.sheet_factor(t) for t in times])[:, None]
        live = [self._live(t) for t in times]
        moments = [(contact, *contact.during(times)) for contact in self.scene.contacts]
        for contact in dict.fromkeys(each for now in live for each in now):
            there = np.array([contact in now for now in live])
            moments.append((contact, there, *contact.during(times)[1:]))
        tracks = []
        for contact, there, centers, felt in moments:
            across = patches_across(contact, longest)
            conductance = factors * contact.conductance(law, across, felt[:, None])
            tracks.append(Track(contact.patches_about_center(across), centers, conductance, there))
        return tracks

    def _paths(self):
        """(Q, 2) points over which contacts move, within `_HORIZON` s and two sheet lengths."""
        reach = 2 * max(self.layout.outline.size)
        paths = [np.empty((0, 2))]
        for contact, across in zip(self.scene.contacts, self._across):
            steps = contact.shifts(self._step / 3, _HORIZON, reach)
            points = contact.patches(across)[0]
            paths.append((points + steps[:, None]).reshape(-1, 2))
        return np.concatenate(paths)


def patches_across(contact: Contact, longest: float) -> int:
    """Patches to the width of a contact on a sheet whose longer side is `longest` (m)."""
    count = math.ceil(contact.width / longest * _PATCHES - _TINY)
    return min(max(count, _ACROSS[0]), _ACROSS[1])


def convert(voltages: np.ndarray, bits: int, full_scale: float) -> np.ndarray:
    """Voltages as a converter with 2^bits steps from 0 to `full_scale` (V) returns them."""
    step = full_scale / 2**bits
    return np.clip(np.round(voltages / step), 0, 2**bits - 1) * step

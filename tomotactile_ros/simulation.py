"""Frames of a scene on a layout, with everything that the scene says is wrong.

Physics first (`sheet`), then the measurement in the order in which hardware does it: wiring, noise
and hum on the wire, drift of the amplifier, conversion, dead channels. What a scene does not name
costs nothing. The same scene, seed, time and sequence number give the same frame on every machine.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.contact import Contact
from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import Layout
from tomotactile_ros.scene import Scene
from tomotactile_ros.sheet import MODELS, make_sheet
from tomotactile_ros.sheet.contacts import contact_points
from tomotactile_ros.sheet.frames import frame
from tomotactile_ros.sheet_field import resistance_of

ROW_PERIOD = 1e-3  # s for one ground condition, the switching of Kojima et al. 2023 (1 kHz)
_ELEMENTS = 80  # along the longer side: 0.3 % of the drive voltage, see docs/model.md
_PATCHES = 60  # along the longer side, for the patches of wide contacts
_ACROSS = 4, 24  # of them to the width of the smallest and of the widest contact
_TINY = 1e-6  # keeps counts of patches from rounding either way
_HORIZON = 60.0  # s of motion that are solved ahead


class Simulator:
    """A sensor with `layout` under `scene`.

    Parameters
    ----------
    layout, scene : what to simulate
    model : `fem` by default, so that data and images never share a model; or of `sheet.MODELS`
    h : element size of the mesh, m

    Raises InputError where the scene does not fit the layout or the model cannot do what it names.
    """

    def __init__(self, layout: Layout, scene: Scene, model: str = "fem", *, h: float | None = None):
        if model not in MODELS:
            raise InputError(f"model: {model!r} is none of {', '.join(MODELS)}")
        scene.check(layout)
        self.layout, self.scene = layout, scene
        self.grounded = np.arange(layout.electrodes)
        self.row_period = ROW_PERIOD
        longest = max(layout.outline.size)
        self.sheet = self._make_sheet(model, h or longest / _ELEMENTS)
        self._step = longest / _PATCHES
        self._across = [patches_across(contact, longest) for contact in scene.contacts]
        self.sheet.prepare(self._paths())
        self._last: tuple[list, float, np.ndarray] | None = None

    def _make_sheet(self, model, h):
        """The sheet as the scene has it; tears are as wide as half an element at least."""
        uneven, width = self.scene.defects.sheet, h / 2
        return make_sheet(
            self.layout,
            model,
            resistance=resistance_of(
                self.layout, uneven, self.scene.defects.sheet_variation, width
            ),
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

    def frame(self, t: float, sequence: int = 0) -> np.ndarray:
        """(L, E) voltages, V, of the frame that starts at `t` (s); NaN: no valid reading.

        `sequence` numbers the frame: it chooses the noise.
        """
        voltages = self.ideal_frame(t).copy()
        defects, scene = self.scene.defects, self.scene
        for first, second in defects.swapped:
            voltages[[first, second]] = voltages[[second, first]]
            voltages[:, [first, second]] = voltages[:, [second, first]]
        times = t + self.row_period * np.arange(len(self.grounded))
        if scene.noise is not None and scene.noise.rms > 0:
            random = np.random.default_rng([scene.noise.seed, sequence])
            voltages += scene.noise.rms * random.standard_normal(voltages.shape)
        if defects.hum is not None:
            hum = defects.hum.amplitude * np.sin(2 * np.pi * defects.hum.frequency * times)
            voltages += hum[:, None]
        if defects.drift is not None:
            drift = defects.drift
            phases = 2 * np.pi * np.random.default_rng(drift.seed).random(voltages.shape[1])
            voltages += drift.amplitude * np.sin(2 * np.pi * times[:, None] / drift.period + phases)
        if scene.adc is not None:
            voltages = convert(voltages, scene.adc.bits, scene.adc.range)
        voltages[:, list(defects.dead)] = np.nan
        return voltages

    def ideal_frame(self, t: float) -> np.ndarray:
        """(L, E) voltages before anything is wrong with their measurement."""
        factor = self.sheet_factor(t)
        now = [contact.at(t) for contact in self.scene.contacts]
        if self._last is None or factor != self._last[1] or not _same(now, self._last[0]):
            self._last = now, factor, self._solve(now, factor)
        return self._last[2]

    def _solve(self, contacts, factor):
        """Voltages are ratios of resistances: a warmer sheet is like better contacts and wires."""
        present = [
            (contact.patches(across), self._conductance(contact))
            for contact, across in zip(contacts, self._across)
            if contact is not None
        ]
        transfer, resistance = contact_points(self.sheet, present)
        return frame(
            transfer,
            resistance / factor,
            self.scene.drive_voltage,
            switch_resistance=self.scene.defects.switch_resistance / factor,
        )

    def _paths(self):
        """(Q, 2) points over which contacts move, within `_HORIZON` s and two sheet lengths."""
        reach = 2 * max(self.layout.outline.size)
        paths = [np.empty((0, 2))]
        for contact, across in zip(self.scene.contacts, self._across):
            speed = np.linalg.norm(contact.velocity)
            if speed > 0:
                way = min(reach, speed * min(_HORIZON, contact.end - contact.start))
                distance = np.arange(0, way, self._step / 3)
                steps = distance[:, None] * (contact.velocity / speed)
                points = contact.patches(across)[0]
                paths.append((points + steps[:, None]).reshape(-1, 2))
        return np.concatenate(paths)

    def _conductance(self, contact) -> float:
        if self.scene.contact_law is None or contact.pressure is None:
            return np.inf
        return float(self.scene.contact_law.conductance(contact.pressure))


def patches_across(contact: Contact, longest: float) -> int:
    """Patches to the width of a contact on a sheet whose longer side is `longest` (m)."""
    width = np.ptp(contact.vertices, axis=0).max()
    return int(np.clip(np.ceil(width / longest * _PATCHES - _TINY), *_ACROSS))


def _same(first, second) -> bool:
    return len(first) == len(second) and all(a is b for a, b in zip(first, second))


def convert(voltages: np.ndarray, bits: int, full_scale: float) -> np.ndarray:
    """Voltages as a converter with 2^bits steps from 0 to `full_scale` (V) returns them."""
    step = full_scale / 2**bits
    return np.clip(np.round(voltages / step), 0, 2**bits - 1) * step

"""The frames on which everything is scored: from finite elements, noise and conversion included.

The reconstruction uses another model of the sheet (the closed form on rectangles) and never sees
this one. Every random number has a seed: the same layout and size give the same frames.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Defects, Noise
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.simulation import Simulator

LAW = ContactLaw(coefficient=1.0e-4, exponent=1.0)
DRIVE = 3.3  # V
NOISE = 0.001  # V
BITS = 12
PRESSURE = 30000.0  # Pa
RADIUS = 0.025  # of a contact, in parts of the longer side: 5 mm on 200 mm
MARGIN = 0.06  # that contacts keep from the rim, in parts of each side
SEPARATIONS = (0.075, 0.1, 0.125, 0.15, 0.175, 0.2, 0.25, 0.3, 0.4)  # in parts of the longer side


@dataclass(frozen=True)
class Size:
    """How much is measured: `side`^2 places of single contacts, pairs for each separation."""

    side: int
    pairs: int


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames (N, E, E), V, and for each the true positions (n, 2), m, and forces (n,), N."""

    frames: np.ndarray
    positions: list[np.ndarray]
    forces: list[np.ndarray]

    def __len__(self) -> int:
        return len(self.frames)

    def part(self, chosen) -> Recording:
        """The frames with the numbers `chosen`."""
        chosen = np.arange(len(self))[chosen]
        return Recording(
            self.frames[chosen],
            [self.positions[i] for i in chosen],
            [self.forces[i] for i in chosen],
        )


@dataclass(frozen=True, eq=False)
class Trials:
    """Recordings of one layout.

    singles     one contact, 1 mV of noise and a 12-bit converter
    pairs       two contacts for each of `separations` (S,), m: (S * n) frames in this order
    worn, worn_pairs  the same contacts on the sensor of the scene `worn-sensor`
    """

    layout: Layout
    singles: Recording
    pairs: Recording
    worn: Recording
    worn_pairs: Recording
    separations: np.ndarray

    def of(self, sensor: str) -> tuple[Recording, Recording]:
        """Single contacts and pairs on one of `accuracy.SENSORS`."""
        worn = sensor == "worn"
        return (self.worn, self.worn_pairs) if worn else (self.singles, self.pairs)


def make_trials(layout: Layout, size: Size, seed: int = 6) -> Trials:
    """Simulate all frames of `layout`."""
    random = np.random.default_rng(seed)
    places = _places(layout, size.side, random)
    separations = np.array(SEPARATIONS) * max(layout.outline.size)
    pairs = [_pair(layout, apart, random) for apart in separations for _ in range(size.pairs)]
    singles = [place[None] for place in places]
    clean = record(layout, make_scene(), [*singles, *pairs])
    worn = record(layout, worn_scene(), [*singles, *pairs])
    ones, twos = slice(len(singles)), slice(len(singles), None)
    return Trials(
        layout,
        singles=clean.part(ones),
        pairs=clean.part(twos),
        worn=worn.part(ones),
        worn_pairs=worn.part(twos),
        separations=separations,
    )


def record(
    layout: Layout, scene: Scene, places: list[np.ndarray], pressure: float = PRESSURE, h=None
) -> Recording:
    """One frame for each set of contact positions (n, 2), each with its own noise.

    `pressure` of every contact, Pa; `h`: element size, m, the simulator's own without it.
    """
    radius = RADIUS * max(layout.outline.size)
    contacts = [
        Contact("disc", center=where, radius=radius, pressure=pressure, start=i, end=i + 1)
        for i, points in enumerate(places)
        for where in points
    ]
    simulator = Simulator(layout, replace(scene, contacts=tuple(contacts)), h=h)
    frames = np.array([simulator.frame(i + 0.5, i) for i in range(len(places))])
    force = pressure * np.pi * radius**2
    return Recording(frames, list(places), [np.full(len(points), force) for points in places])


def make_scene(
    contacts: Iterable[Contact] = (), seed: int = 1, defects: Defects | None = None
) -> Scene:
    """The measurement of a good microcontroller."""
    noise, adc = Noise(NOISE, seed), Adc(BITS, DRIVE)
    return Scene("trials", DRIVE, tuple(contacts), LAW, noise, adc, defects or Defects())


def worn_scene() -> Scene:
    """The same on the sensor of the scene `worn-sensor`."""
    return make_scene(defects=load_scene("worn-sensor").defects)


def make_pipeline(
    layout: Layout, profile: str = "accurate", sensor: SensorState | None = None, **settings: Any
) -> Pipeline:
    """Told the noise and the contact law, unless `settings` say otherwise."""
    told: dict[str, Any] = {"noise": NOISE, "contact_law": LAW} | settings
    return Pipeline(layout, Settings(profile, **told), sensor=sensor)


def _places(layout, side, random):
    """(n, 2) a jittered lattice inside the margin."""
    low, size = np.array(layout.outline.bounds[:2]), np.array(layout.outline.size)
    cell = (np.indices((side, side)).reshape(2, -1).T + random.random((side**2, 2))) / side
    points = low + size * (MARGIN + (1 - 2 * MARGIN) * cell)
    return points[_fits(layout, points)]


def _pair(layout, apart, random):
    """(2, 2) two places `apart` m from each other, inside the margin."""
    low, size = np.array(layout.outline.bounds[:2]), np.array(layout.outline.size)
    while True:
        angle = 2 * np.pi * random.random()
        half = apart / 2 * np.array([np.cos(angle), np.sin(angle)])
        points = low + size * random.random(2) + np.array([half, -half])
        if _fits(layout, points).all():
            return points


def _fits(layout, points):
    outline = layout.outline
    far = outline.rim_distance(points) >= 0.999 * MARGIN * min(outline.size)
    return outline.contains(points) & far

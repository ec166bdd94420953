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
    """Frames (N, E, E), V, and what is true of each: x, y, m, and force, N, of all contacts."""

    frames: np.ndarray
    truths: list[list[dict]]


@dataclass(frozen=True, eq=False)
class Trials:
    """Recordings of one layout.

    of           single contacts and pairs, by sensor: `textbook` with 1 mV of noise and a 12-bit
                 converter, `worn` that of the scene `worn-sensor`
    separations  (S,) m, of the pairs: (S * n) frames in this order
    """

    layout: Layout
    of: dict[str, tuple[Recording, Recording]]
    separations: np.ndarray

    @property
    def singles(self) -> Recording:
        """On the sensor of the textbook."""
        return self.of["textbook"][0]


def make_trials(layout: Layout, size: Size) -> Trials:
    """Simulate all frames of `layout`."""
    random = np.random.default_rng(6)
    singles = [place[None] for place in _places(layout, size.side, random)]
    separations = np.array(SEPARATIONS) * max(layout.outline.size)
    pairs = [_pair(layout, apart, random) for apart in separations for _ in range(size.pairs)]
    of = {}
    for sensor, scene in {"textbook": make_scene(), "worn": worn_scene()}.items():
        every = record(layout, scene, [*singles, *pairs])
        ones, twos = slice(len(singles)), slice(len(singles), None)
        one, two = (Recording(every.frames[part], every.truths[part]) for part in (ones, twos))
        of[sensor] = one, two
    return Trials(layout, of, separations)


def record(layout: Layout, scene: Scene, places: list[np.ndarray]) -> Recording:
    """One frame for each set of contact positions (n, 2), m, each with its own noise."""
    radius = RADIUS * max(layout.outline.size)
    contacts = [
        Contact("disc", center=where, radius=radius, pressure=PRESSURE, start=i, end=i + 1)
        for i, points in enumerate(places)
        for where in points
    ]
    simulator = Simulator(layout, replace(scene, contacts=tuple(contacts)))
    frames = np.array([simulator.frame(i + 0.5, i) for i in range(len(places))])
    force = PRESSURE * np.pi * radius**2
    return Recording(
        frames, [[{"x": x, "y": y, "force": force} for x, y in points] for points in places]
    )


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
    return layout.outline.holds(points, 0.999 * MARGIN * min(layout.outline.size))

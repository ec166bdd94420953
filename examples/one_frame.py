#!/usr/bin/env python3
"""One frame, worked from readings to a contact; docs/estimation.md says why.

    python3 examples/one_frame.py --out one_frame.png

The frame is that of the scene `press`, 2 N on a foot of 8 mm radius, on 16 electrodes. Each step
prints its numbers. `tomotactile_ros.estimation` goes the same way with more unknowns.
"""

import argparse

import numpy as np

import tomotactile_ros as tt
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.reconstruction.grounded import GroundedSheet
from tomotactile_ros.sheet import make_sheet

DRIVE, NOISE = 3.3, 1e-3  # V
THRESHOLD = 51.5  # of chi-squared: one false contact in 1e7 frames, 4 unknowns at one of 576 places
ACROSS = 6  # patches to the width of a contact


class Sheet:
    """The untouched sheet, and its readings under one round contact."""

    def __init__(self, layout: tt.Layout):
        self._model = make_sheet(layout, "closed_form")
        self._grounded = self.at(np.zeros((1, 2)), 1e-3)
        self.untouched = self._grounded.admittance  # Y0, S

    def at(self, points: np.ndarray, radius: float) -> GroundedSheet:
        """The sheet with patches of `radius`, m, at `points` (K, 2), m."""
        return GroundedSheet(self._model.transfer(points, radius))

    def cut(self, contact: np.ndarray) -> tuple[GroundedSheet, np.ndarray]:
        """The sheet with a disc in patches, and the conductance of each, S.

        `contact` is x, y, m, ln c and ln a: the radius a, m, and what the whole contact conducts to the
        electrodes, S, its own 1/g and the mean D of the way there: 1/c = 1/g + D. Readings tell c
        and hardly a, so that both are found independently; g and a are not.
        """
        side = 2 * np.exp(contact[3]) / ACROSS
        steps = side * (np.arange(ACROSS) - (ACROSS - 1) / 2)
        places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        places = places[np.hypot(*places.T) < np.exp(contact[3])] + contact[:2]
        sheet = self.at(places, 0.447 * side)  # a disc with the mean logarithm of a square
        way = sheet.among(np.arange(len(places))).mean()
        own = max(np.exp(-contact[2]) - way, 1e-3 * way)
        return sheet, np.full(len(places), 1 / own / len(places))

    def readings(self, contact: np.ndarray) -> np.ndarray:
        """(E, E) v / V0 under a contact."""
        sheet, conductances = self.cut(contact)
        return ungrounded(sheet.readings(conductances))


def ungrounded(ratio: np.ndarray) -> np.ndarray:
    """The same; NaN where the electrode itself is grounded, which nobody reads."""
    return np.where(np.eye(len(ratio), dtype=bool), np.nan, ratio)


def symmetric(ratio: np.ndarray) -> tuple[np.ndarray, float]:
    """Z (E, E) but for a factor, and what its two halves contradict each other by, in parts of the noise.

    rho_ln = Z_ln / Z_ll and Z is symmetric: ln rho_ln - ln rho_nl = d_n - d_l with d = ln Z_ll.
    """
    rho = np.where(np.isnan(ratio), 1.0, 1 - ratio)
    l, n = np.triu_indices(len(rho), 1)
    noise = NOISE / DRIVE * np.hypot(1 / rho[l, n], 1 / rho[n, l])
    design = np.zeros((len(l), len(rho)))
    design[np.arange(len(l)), n], design[np.arange(len(l)), l] = 1 / noise, -1 / noise
    wanted = np.log(rho[l, n] / rho[n, l]) / noise
    d = np.linalg.lstsq(design, wanted, rcond=None)[0]
    left = wanted - design @ d
    scaled = rho * np.exp(d)[:, None]
    return (scaled + scaled.T) / 2, float(left @ left / (len(l) - len(rho) + 1))


def currents(impedance: np.ndarray, untouched: np.ndarray) -> np.ndarray:
    """(E,) S: what electrode n would draw per volt if all were grounded at once.

    The factor of Y = Z^-1 is that of couplings which the contact leaves as they are.
    """
    admittance = np.linalg.inv(impedance)
    near = untouched < 0.3 * untouched.min()  # neighbours; couplings are negative
    admittance *= np.median(untouched[near] / admittance[near])
    return admittance.sum(axis=1)


def fit(sheet: Sheet, ratio: np.ndarray, contact: np.ndarray, steps: int = 3):
    """Gauss-Newton: contact, its covariance, residuals and derivatives in parts of the noise."""
    seen, scale = np.isfinite(ratio), NOISE / DRIVE

    def misfit(c):
        return (ratio - sheet.readings(c))[seen] / scale

    for step in range(steps + 1):
        left = misfit(contact)
        nudges = np.diag([1e-5, 1e-5, 1e-3, 1e-3])
        slopes = np.column_stack(
            [(misfit(contact + d) - misfit(contact - d)) / (2 * d.max()) for d in nudges]
        )
        print(
            f"   step {step}: x {1e3 * contact[0]:6.2f} mm  y {1e3 * contact[1]:6.2f} mm  "
            f"c {1e6 * np.exp(contact[2]):6.1f} uS  radius {1e3 * np.exp(contact[3]):5.2f} mm  "
            f"chi^2 {left @ left / len(left):8.2f} per reading"
        )
        if step < steps:
            change = -np.linalg.lstsq(slopes, left, rcond=None)[0]
            contact = contact + change * min(1.0, 0.5 / np.abs(change[2:]).max())
    return contact, np.linalg.inv(slopes.T @ slopes), left, slopes


def another(sheet: Sheet, ratio, contact, left, slopes, places: np.ndarray) -> np.ndarray:
    """(K,) by which chi-squared would fall, to first order, with one more contact at each place."""
    impedance, _ = symmetric(sheet.readings(contact))
    admittance, seen, gains = np.linalg.inv(impedance), np.isfinite(ratio), []

    def of(matrix):
        inverse = np.linalg.inv(matrix)
        return (1 - inverse / inverse.diagonal()[:, None])[seen] / (NOISE / DRIVE)

    for h in sheet.at(places, 1e-3).share.T:
        change = of(admittance + 1e-6 * admittance.max() * np.outer(h, h)) - of(admittance)
        own = change - slopes @ np.linalg.lstsq(slopes, change, rcond=None)[0]
        gains.append(max(own @ left, 0.0) ** 2 / (own @ own))  # a contact conducts, or it is none
    return np.array(gains)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", default="one_frame.png", help="picture to write")
    args = parser.parse_args()
    layout, scene = tt.load_layout("equal-4x4"), tt.load_scene("press")
    sheet, law = Sheet(layout), scene.contact_law
    ratio = ungrounded(tt.Simulator(layout, scene).frame(0.0) / DRIVE)  # from finite elements

    print(f"1. readings: {np.isfinite(ratio).sum()}, {DRIVE * np.nanmin(ratio):.3f} to "
          f"{DRIVE * np.nanmax(ratio):.3f} V; highest at electrode {np.nanmean(ratio, axis=0).argmax()}")  # fmt: skip
    impedance, contradiction = symmetric(ratio)
    print(f"2. reciprocity: chi^2 {contradiction:.2f} per equation: one state of one sheet")
    drawn = currents(impedance, sheet.untouched)
    start = drawn @ layout.positions / drawn.sum()
    print(f"3. all grounded: {1e6 * drawn.sum():.1f} uS in all, {1e6 * drawn.max():.1f} uS at electrode "
          f"{drawn.argmax()}; their centre is at x {1e3 * start[0]:.1f} mm, y {1e3 * start[1]:.1f} mm")  # fmt: skip
    print("4. fit to the readings themselves, from a radius of 5 mm:")
    first = np.array([*start, np.log(drawn.sum()), np.log(5e-3)])
    contact, covariance, left, slopes = fit(sheet, ratio, first)
    grid = Grid.for_outline(layout.outline, 24)
    gains = another(sheet, ratio, contact, left, slopes, grid.pixels)
    nothing = np.nansum((ratio / (NOISE / DRIVE)) ** 2)
    print(f"5. evidence: chi^2 is {nothing:.2g} without it, {left @ left:.0f} with it; one more would gain "
          f"{gains.max():.0f}, and needs {THRESHOLD}: there is one contact")  # fmt: skip
    x, y, force, radius = (
        *contact[:2],
        sheet.cut(contact)[1].sum() / law.coefficient,
        np.exp(contact[3]),
    )
    spread = np.sqrt(np.diag(covariance))
    print(f"6. report: x {1e3 * x:.2f} +- {1e3 * spread[0]:.2f} mm, y {1e3 * y:.2f} +- {1e3 * spread[1]:.2f} mm, "
          f"{force:.3f} +- {force * spread[2]:.3f} N, radius {1e3 * radius:.1f} +- {1e3 * radius * spread[3]:.1f} mm "
          "(true: 30, 20 mm, 2 N, 8 mm)")  # fmt: skip
    draw(layout, ratio, drawn, gains, grid, contact).savefig(args.out, dpi=90)
    print(f"{args.out} written")


def draw(layout, ratio, drawn, gains, grid, contact):
    """Readings; currents with all electrodes grounded; what one more contact would gain."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.4), layout="constrained")
    first, second, third = figure.subplots(1, 3)
    image = first.imshow(DRIVE * ratio, cmap="viridis")
    first.set(title="1. readings / V", xlabel="electrode read", ylabel="electrode grounded")
    figure.colorbar(image, ax=first, shrink=0.8)
    x, y = 1e3 * layout.positions.T
    spots = second.scatter(
        x, y, s=80, c=1e6 * drawn, cmap="viridis", edgecolors="0.4", clip_on=False, zorder=3
    )
    second.set_title("3. currents, all grounded / (µA/V)", pad=12)
    second.set(aspect="equal")
    figure.colorbar(spots, ax=second, shrink=0.8)
    extent = 1e3 * np.array(layout.outline.bounds)[[0, 2, 1, 3]]
    image = third.imshow(grid.fill(gains), extent=extent, cmap="viridis")
    third.set(title="5. what one more contact would gain")
    figure.colorbar(image, ax=third, shrink=0.8)
    for axes in (second, third):
        axes.plot(*(1e3 * contact[:2]), "x", color="red", markersize=10, markeredgewidth=2)
        axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="x / mm", ylabel="y / mm")
    return figure


if __name__ == "__main__":
    try:
        main()
    except tt.InputError as error:
        raise SystemExit(f"one_frame: {error}") from None

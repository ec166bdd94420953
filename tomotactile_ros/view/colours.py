"""Pictures of a pressure image: colours, enlarging, electrodes and contacts drawn in.

Pixels follow the image convention: row 0 is the +y edge. The colour map is viridis, whose lightness
rises evenly with the value, so that equal differences of pressure look equal.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.support.checks import plain
from tomotactile_ros.view.contact_lines import stand_for_all

OUTSIDE = (60, 60, 60)  # cells outside the outline
LEAST_PRESSURE, LEAST_CONDUCTANCE = 1000.0, 0.1  # Pa, S/m²: noise alone is not blown up beyond
_WHITE = (255, 255, 255)
_RED = (255, 64, 64)
_DASHES = 12  # of a broken ring
_BAR_WIDTH = 0.24  # of the height of the picture beside which the scale stands


@lru_cache(maxsize=1)
def palette() -> np.ndarray:
    """(256, 3) uint8 colours from nothing to full scale."""
    from matplotlib import colormaps

    return np.round(255 * colormaps["viridis"](np.arange(256))[:, :3]).astype(np.uint8)


class SteadyScale:
    """Full scale of a live picture: 1, 2 or 5 times a power of ten, at least `least`, Pa.

    It grows at once with a higher peak, and falls when peaks have been lower for `hold` s: colours
    keep their meaning while forces play.
    """

    def __init__(self, least: float, hold: float = 5.0):
        self._least, self._hold = least, hold
        self._scale, self._highest, self._since = least, 0.0, -np.inf

    def __call__(self, peak: float, now: float) -> float:
        """Scale for an image with this peak (Pa) at the time `now` (s)."""
        self._highest = max(self._highest, peak)
        if self._highest > self._scale or now - self._since > self._hold:
            self._scale = max(self._least, round_up(self._highest))
            self._highest, self._since = peak, now
        return self._scale


def round_up(value: float) -> float:
    """The least of 1, 2 and 5 times a power of ten that is not below the value; 0 for none."""
    if not value > 0:
        return 0.0
    power = 10.0 ** np.floor(np.log10(value) + 1e-12)
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9)))


def colour(pressure: np.ndarray, scale: float) -> np.ndarray:
    """(H, W, 3) uint8 colours of an (H, W) image, Pa; ``scale`` and more is the brightest."""
    outside = np.isnan(pressure)
    level = np.clip(np.where(outside, 0.0, pressure) * (255.0 / scale), 0.0, 255.0)
    rgb = palette()[np.rint(level).astype(np.uint8)]
    rgb[outside] = OUTSIDE
    return rgb


def named(value: float, calibrated: bool) -> str:
    """A pressure, Pa, or without a contact law a conductance, S/m², as people say it."""
    return f"{plain(value / 1e3)} kPa" if calibrated else f"{plain(value)} S/m²"


@lru_cache(maxsize=8)
def scale_bar(height: int, scale: float) -> np.ndarray:
    """(H, W, 3) uint8 picture of the colours from 0 to `scale`, Pa, with their values in kPa."""
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    width = max(1, round(_BAR_WIDTH * height))
    figure = Figure((width / 100, height / 100), dpi=100, facecolor="#" + bytes(OUTSIDE).hex())
    canvas = FigureCanvasAgg(figure)
    size = 0.045 * height * 0.72  # of letters, points
    bar = figure.add_axes((0.12, 0.08, 0.2, 0.84))
    levels = ScalarMappable(Normalize(0.0, scale / 1e3), colormaps["viridis"])
    figure.colorbar(levels, cax=bar, ticks=[0.0, scale / 2e3, scale / 1e3], format="%.3g")
    bar.tick_params(labelsize=size, colors="white", length=0.2 * size, pad=0.2 * size)
    bar.set_title("kPa", fontsize=size, color="white", loc="left", pad=0.4 * size)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


class Overlay:
    """Draws electrodes and contacts into an enlarged picture.

    Parameters
    ----------
    grid : cells of the pressure image.
    zoom : pixels per cell and direction.
    positions : (E, 2) electrodes, m.
    radius : of the electrodes, m.
    """

    def __init__(self, grid: Grid, zoom: int, positions: np.ndarray, radius: float):
        self._zoom = zoom
        xmin, _, _, ymax = grid.outline.bounds
        dx, dy = (side / zoom for side in grid.cell_size)
        self._x = xmin + (np.arange(grid.width * zoom) + 0.5) * dx
        self._y = ymax - (np.arange(grid.height * zoom) + 0.5) * dy
        self._stroke = max(dx, dy)
        self._electrodes = np.zeros((len(self._y), len(self._x)), dtype=bool)
        for x, y in positions:
            self._electrodes |= self._distance(x, y) < max(radius, self._stroke)

    def draw(
        self,
        rgb: np.ndarray,
        contacts: Sequence,
        electrodes: bool = True,
        complete: bool = True,
    ) -> np.ndarray:
        """The (H, W, 3) picture enlarged, with electrodes as white dots, contacts as red rings, a broken
        one where not all was tried (`complete`) and it stands for all."""
        picture = rgb.repeat(self._zoom, axis=0).repeat(self._zoom, axis=1)
        if electrodes:
            picture[self._electrodes] = _WHITE
        for contact in contacts:
            self._draw_ring(picture, contact, stand_for_all(contacts, complete))
        return picture

    def _draw_ring(self, picture: np.ndarray, contact, broken: bool) -> None:
        """Draw a contact; only the pixels around it are looked at."""
        reach = contact.radius + self._stroke
        columns = slice(*np.searchsorted(self._x, (contact.x - reach, contact.x + reach)))
        rows = slice(*np.searchsorted(-self._y, (-contact.y - reach, -contact.y + reach)))
        right, up = self._x[columns] - contact.x, (self._y[rows] - contact.y)[:, None]
        drawn = np.abs(np.hypot(right, up) - contact.radius) < self._stroke
        if broken:
            drawn &= np.arctan2(up, right) * (_DASHES / np.pi) % 2 < 1
        picture[rows, columns][drawn] = _RED

    def _distance(self, x: float, y: float) -> np.ndarray:
        return np.hypot(self._x - x, (self._y - y)[:, None])

"""A pressure image as text: two rows of cells in each line, in 24-bit colour (ANSI escapes).

Upper half blocks carry the upper cell in the foreground and the lower one in the background colour,
so that cells are about square. Row 0, the +y edge, is the top line.
"""

import numpy as np

from tomotactile_ros.view.colours import OUTSIDE, colour

HALF_BLOCK = "▀"
_RESET = "\x1b[0m"
_MARGIN = 5  # characters for the y axis


def picture(
    pressure: np.ndarray,
    bounds: tuple[float, float, float, float],
    scale: float,
    columns: int,
    lines: int,
    electrodes: np.ndarray | None = None,
    calibrated: bool = True,
) -> list[str]:
    """Lines of text that show an image with its axes in mm and its colours in kPa.

    Parameters
    ----------
    pressure : (H, W) Pa, NaN outside the outline; any unit where it is not calibrated.
    bounds : xmin, ymin, xmax, ymax of the image, m.
    scale : pressure of the brightest colour, Pa.
    columns, lines : room on the terminal; larger images are shown coarser.
    electrodes : (E, 2) positions to mark with lighter cells, m.
    calibrated : whether pressures are known; otherwise colours are parts of the full scale.
    """
    room = max(8, columns - _MARGIN - 14), 2 * max(4, lines - 2)
    small, factor = _coarser(pressure, room)
    rgb = colour(small, scale)
    if electrodes is not None:
        _mark(rgb, _cells_of(electrodes, bounds, pressure.shape) // factor)
    if len(rgb) % 2:
        rgb = np.vstack([rgb, np.full_like(rgb[:1], OUTSIDE)])
    blocks = [_blocks(*pair) for pair in rgb.reshape(-1, 2, *rgb.shape[1:])]
    heights = bounds[3], 0.5 * (bounds[1] + bounds[3]), bounds[1]
    labels = _spread([_millimetres(y) for y in heights], len(blocks))
    levels = ["100 %", "50 %", "0"]
    if calibrated:
        levels = [f"{p / 1e3:.3g} kPa" for p in (scale, scale / 2, 0.0)]
    keys = _spread(levels, len(blocks))
    shades = colour(np.linspace(scale, 0.0, 2 * len(blocks))[:, None], scale)
    bar = [_blocks(*pair) * 2 for pair in shades.reshape(-1, 2, 1, 3)]
    text = [
        f"{label:>{_MARGIN - 1}} {block}{_RESET} {colours}{_RESET} {key}"
        for label, block, colours, key in zip(labels, blocks, bar, keys, strict=True)
    ]
    return [*text, _x_axis(bounds, rgb.shape[1])]


def _cells_of(points: np.ndarray, bounds: tuple, shape: tuple[int, int]) -> np.ndarray:
    """(E, 2) row and column of the cell under each of (E, 2) points, m."""
    xmin, ymin, xmax, ymax = bounds
    part = np.column_stack(
        [(ymax - points[:, 1]) / (ymax - ymin), (points[:, 0] - xmin) / (xmax - xmin)]
    )
    return np.clip((part * shape).astype(int), 0, np.array(shape) - 1)


def _mark(rgb: np.ndarray, cells: np.ndarray) -> None:
    """Lighten cells (E, 2) half way to white: what they show stays visible."""
    rows, columns = np.unique(cells, axis=0).T
    rgb[rows, columns] = rgb[rows, columns] // 2 + 128


def _coarser(image: np.ndarray, room: tuple[int, int]) -> tuple[np.ndarray, int]:
    """The image with the peak of blocks of cells, so that at most (columns, rows) remain; their
    side."""
    height, width = image.shape
    factor = max(-(-width // room[0]), -(-height // room[1]))
    if factor <= 1:
        return image, 1
    padding = ((0, -height % factor), (0, -width % factor))
    padded = np.pad(image, padding, constant_values=np.nan)
    shape = padded.shape[0] // factor, factor, padded.shape[1] // factor, factor
    blocks = np.where(np.isnan(padded), -np.inf, padded).reshape(shape).max(axis=(1, 3))
    return np.where(np.isinf(blocks), np.nan, blocks), factor


def _blocks(upper: np.ndarray, lower: np.ndarray) -> str:
    """Half blocks of (W, 3) colours."""
    return "".join(
        f"\x1b[38;2;{u[0]};{u[1]};{u[2]};48;2;{v[0]};{v[1]};{v[2]}m{HALF_BLOCK}"
        for u, v in zip(upper.tolist(), lower.tolist(), strict=True)
    )


def _spread(words: list[str], lines: int) -> list[str]:
    """Words at the first, middle and last of so many lines; where these are fewer than three, without
    the middle, and of one line at the first."""
    first, middle, last = words
    spread = [""] * lines
    if lines > 2:
        spread[(lines - 1) // 2] = middle
    spread[-1] = last
    spread[0] = first
    return spread


def _x_axis(bounds: tuple[float, float, float, float], width: int) -> str:
    left, right = _millimetres(bounds[0]), _millimetres(bounds[2])
    middle = _millimetres(0.5 * (bounds[0] + bounds[2]))
    gap = max(1, (width - len(middle)) // 2 - len(left))
    line = left + " " * gap + middle
    return " " * _MARGIN + line + " " * max(1, width - len(line) - len(right)) + right + " mm"


def _millimetres(length: float) -> str:
    return f"{round(1e3 * length):+d}" if round(1e3 * length) else "0"

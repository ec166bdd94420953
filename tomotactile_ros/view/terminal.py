"""A pressure image as text: two rows of cells in each line, in 24-bit colour (ANSI escapes).

Upper half blocks carry the upper cell in the foreground and the lower one in the background colour,
so that cells are about square. Row 0, the +y edge, is the top line.
"""

from collections.abc import Callable, Sequence

import numpy as np

from tomotactile_ros.view.colours import OUTSIDE, colour, named

HALF_BLOCK = "▀"
_RESET = "\x1b[0m"
_MARGIN = 5  # characters for the y axis
_WHITE, _BLACK, _RED = (255, 255, 255), (0, 0, 0), (255, 64, 64)
_BRIGHT = 384  # red + green + blue of a colour on which black is easier to read than white


def picture(
    pressure: np.ndarray,
    bounds: tuple[float, float, float, float],
    scale: float,
    columns: int,
    lines: int,
    electrodes: np.ndarray | None = None,
    calibrated: bool = True,
    trails: Sequence[np.ndarray] = (),
    names: Sequence[tuple[np.ndarray, str]] = (),
) -> list[str]:
    """Lines of text that show an image with its axes in mm and its colours in kPa or S/m².

    Parameters
    ----------
    pressure : (H, W) Pa, NaN outside the outline; S/m² where it is not calibrated.
    bounds : xmin, ymin, xmax, ymax of the image, m.
    scale : value of the brightest colour.
    columns, lines : room on the terminal; larger images are shown coarser.
    electrodes : (E, 2) positions to mark with lighter cells, m.
    calibrated : whether pressures are known; otherwise colours are conductances.
    trails : (M, 2) m each, drawn as reddish lines of cells.
    names : places (2,), m, and words to write there.
    """
    room = max(8, columns - _MARGIN - 14), 2 * max(4, lines - 2)
    small, factor = _coarser(pressure, room)
    rgb = colour(small, scale)

    def cells(points):
        return _cells_of(points, bounds, pressure.shape) // factor

    if electrodes is not None:
        _mix(rgb, cells(electrodes), _WHITE)
    for trail in trails:
        _mix(rgb, cells(_dense(trail, bounds, rgb.shape)), _RED)
    if len(rgb) % 2:
        rgb = np.vstack([rgb, np.full_like(rgb[:1], OUTSIDE)])
    words = _written(names, cells, rgb.shape[1])
    pairs = enumerate(_lines_of(rgb))
    blocks = [_blocks(upper, lower, words.get(k, {})) for k, (upper, lower) in pairs]
    heights = bounds[3], 0.5 * (bounds[1] + bounds[3]), bounds[1]
    labels = _spread([_millimetres(y) for y in heights], len(blocks))
    keys = _spread([named(p, calibrated) for p in (scale, scale / 2, 0.0)], len(blocks))
    shades = colour(np.linspace(scale, 0.0, 2 * len(blocks))[:, None], scale)
    bar = [_blocks(upper, lower, {}) * 2 for upper, lower in _lines_of(shades)]
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


def _mix(rgb: np.ndarray, cells: np.ndarray, shade: tuple[int, int, int]) -> None:
    """Bring cells (E, 2) half way to a colour: what they show stays visible."""
    rows, columns = np.unique(cells, axis=0).T
    rgb[rows, columns] = rgb[rows, columns] // 2 + ((np.array(shade) + 1) // 2).astype(np.uint8)


def _dense(line: np.ndarray, bounds: tuple, shape: tuple) -> np.ndarray:
    """A line (M, 2) with points in every cell that it crosses."""
    cell = min((bounds[2] - bounds[0]) / shape[1], (bounds[3] - bounds[1]) / shape[0])
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-12))])
    fine = np.linspace(0.0, way[-1], 2 + int(2 * way[-1] / cell))
    return np.column_stack([np.interp(fine, way, line[:, axis]) for axis in (0, 1)])


def _written(names: Sequence[tuple[np.ndarray, str]], cells: Callable, width: int) -> dict:
    """{line: {column: character}} of words, each begun at its place, as far as they fit."""
    written: dict[int, dict[int, str]] = {}
    for place, word in names:
        row, column = cells(np.reshape(place, (1, 2)))[0]
        first = max(0, min(int(column), width - len(word)))
        line = written.setdefault(int(row) // 2, {})
        line.update({first + i: letter for i, letter in enumerate(word) if first + i < width})
    return written


def _lines_of(rgb: np.ndarray) -> np.ndarray:
    """(L, 2, W, 3): the two rows of cells of each line."""
    return rgb.reshape(-1, 2, *rgb.shape[1:])


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


def _blocks(upper: np.ndarray, lower: np.ndarray, words: dict[int, str]) -> str:
    """Half blocks of (W, 3) colours, and letters in the columns that have one."""
    text = ""
    for column, (u, v) in enumerate(zip(upper.tolist(), lower.tolist(), strict=True)):
        shown = HALF_BLOCK
        if letter := words.get(column):
            v = [(a + b) // 2 for a, b in zip(u, v, strict=True)]
            u, shown = _BLACK if sum(v) > _BRIGHT else _WHITE, letter
        text += f"\x1b[38;2;{u[0]};{u[1]};{u[2]};48;2;{v[0]};{v[1]};{v[2]}m{shown}"
    return text


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

"""Checks of single values, shared by everything that is built from user input.

Each takes the value, the key it came from and what it should be, and returns it in a plain type or
raises :class:`InputError` with a line like ``radius: -0.1 is not a positive length in m``.
"""

import math
from numbers import Integral, Real
from typing import Any

import numpy as np

from tomotactile_ros.support.errors import InputError

SHORTEST, LONGEST = 1e-9, 1e6  # m
LARGEST = 1e30  # of any quantity: products of a few such numbers, or of their inverses, stay finite


def show(value: object, width: int = 40) -> str:
    """A short one-line text of any value, for error messages."""
    if isinstance(value, np.generic):
        value = value.item()
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python agrees to print
        text = "a huge number"
    text = " ".join(text[: 10 * width].split())
    return text if len(text) <= width else text[: width - 1] + "…"


def instance(value: object, key: str, kind: type, hint: str = "") -> None:
    """An object of this class; `hint` says how one is made."""
    if not isinstance(value, kind):
        raise InputError(f"{key}: {show(value)} is no {kind.__name__}{hint and ': ' + hint}")


def plain(value: float, digits: int = 3) -> str:
    """A number of so many digits as a person writes it: 410, 12000, 0.00003. What is beyond a millionth or
    a million million has a power of ten."""
    text = f"{value:.{digits}g}"
    if "e" not in text or not 1e-6 <= abs(value) < 1e12:
        return text
    return np.format_float_positional(float(text), trim="-")


def at_least(deviation: float) -> str:
    """What stands before a force: of a bare conductor, whose deviation is infinite, a bound is all that is known."""
    return "at least " if math.isinf(deviation) else ""


def size(count: float) -> str:
    """An amount of bytes as a person says it: 3 bytes, 40 kB, 1.5 GB."""
    for unit, least in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= least:
            return f"{plain(count / least)} {unit}"
    return f"{count:.0f} bytes"


def number(value: object, key: str, kind: str) -> float:
    """A finite number, at most `LARGEST` either way."""
    result = math.nan
    if isinstance(value, Real) and not isinstance(value, (bool, np.bool_)):
        try:
            result = float(value)
        except OverflowError:
            result = math.inf
    if not math.isfinite(result):
        raise InputError(f"{key}: {show(value)} is not a finite {kind}")
    if abs(result) > LARGEST:
        raise InputError(f"{key}: {show(value)} is too large, at most {LARGEST:g} works")
    return result


def positive(
    value: object, key: str, kind: str, least: float = 1 / LARGEST, most: float = LARGEST
) -> float:
    """A finite number above 0, from ``least`` to ``most``."""
    result = number(value, key, kind)
    if result <= 0:
        raise InputError(f"{key}: {show(value)} is not a positive {kind}")
    if not least <= result <= most:
        raise InputError(f"{key}: {show(value)} is no {kind} from {least:g} to {most:g}")
    return result


def length(value: object, key: str) -> float:
    """A length in m, not so small or large that areas and squares of it lose their meaning."""
    return positive(value, key, "length in m", SHORTEST, LONGEST)


def not_negative(value: object, key: str, kind: str) -> float:
    """A finite number, 0 or above."""
    result = number(value, key, kind)
    if result < 0:
        raise InputError(f"{key}: {show(value)} is negative, it must be 0 or a positive {kind}")
    return result


def integer(value: object, key: str, least: int, most: int) -> int:
    """A whole number from ``least`` to ``most``."""
    if isinstance(value, Integral) and not isinstance(value, (bool, np.bool_)):
        whole = int(value)
        if least <= whole <= most:
            return whole
    raise InputError(f"{key}: {show(value)} is not a whole number from {least} to {most}")


def points(value: object, key: str, least: int = 1) -> np.ndarray:
    """(N, 2) read-only float64 array of coordinates in m, N >= ``least``."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"{key}: {show(value)} is not a list of points [x, y] in m")
    bad = np.flatnonzero(~(np.abs(array) <= LONGEST).all(axis=1))
    if len(bad):
        raise InputError(
            f"{key}[{bad[0]}]: {show(array[bad[0]].tolist())} is not a point [x, y], "
            f"finite and at most {LONGEST:g} m from the origin"
        )
    if len(array) < least:
        raise InputError(f"{key}: {len(array)} points given, at least {least} are needed")
    array.setflags(write=False)
    return array


def pair(value: Any, key: str, kind: str) -> tuple[float, float]:
    """Two finite numbers."""
    try:
        first, second = value
    except (TypeError, ValueError):
        raise InputError(f"{key}: {show(value)} is not a pair of numbers, {kind}") from None
    return number(first, f"{key}[0]", kind), number(second, f"{key}[1]", kind)


def order(value: object, key: str, electrodes: int) -> np.ndarray:
    """Electrodes that are grounded in turn: any of them, as often as one likes, at least one."""
    found = np.asarray(value)
    if found.ndim != 1 or not found.size or found.dtype.kind not in "iu":
        raise InputError(f"{key}: {show(value)} is not a list of electrodes")
    if found.min() < 0 or found.max() >= electrodes:
        wrong = found.min() if found.min() < 0 else found.max()
        raise InputError(
            f"{key}: electrode {wrong} does not exist, there are 0 to {electrodes - 1}"
        )
    return found.astype(np.intp)

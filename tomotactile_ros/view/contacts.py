"""Contacts as lines for people, beside the truth where it is known."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment


def pair(contacts: Sequence, truth: Sequence[dict]) -> list[int | None]:
    """For each contact the index of its true one; nearest in sum, None where there are fewer."""
    found = np.array([(c.x, c.y) for c in contacts]).reshape(-1, 2)
    true = np.array([(t["x"], t["y"]) for t in truth]).reshape(-1, 2)
    distance = np.linalg.norm(found[:, None] - true, axis=-1)
    partner: list[int | None] = [None] * len(contacts)
    for i, j in zip(*linear_sum_assignment(distance), strict=True):
        partner[int(i)] = int(j)
    return partner


def contact_lines(contacts: Sequence, truth: Sequence[dict] | None = None) -> list[str]:
    """One line for each contact (x, y in m, force in N, pressure in Pa), and each one missed.

    Parameters
    ----------
    contacts : strongest first.
    truth : what `Scene.truth` says, or None where it is not known.
    """
    if truth is None:
        return [_line(i, c) for i, c in enumerate(contacts, 1)] or ["no contact"]
    partner = pair(contacts, truth)
    lines = [
        _line(i, contact) + ("  nothing is there" if j is None else _compare(contact, truth[j]))
        for i, (contact, j) in enumerate(zip(contacts, partner, strict=True), 1)
    ]
    lines += [_missed(true) for j, true in enumerate(truth) if j not in partner]
    return lines or ["no contact"]


def _line(number: int, contact) -> str:
    return (
        f"contact {number}: ({1e3 * contact.x:+6.1f}, {1e3 * contact.y:+6.1f}) mm  "
        f"{contact.force:5.2f} N  peak {contact.pressure / 1e3:5.1f} kPa"
    )


def _compare(contact, true: dict) -> str:
    distance = np.hypot(contact.x - true["x"], contact.y - true["y"])
    return f"  off by {1e3 * distance:4.1f} mm{_strength(true)}"


def _missed(true: dict) -> str:
    return f"not found: ({1e3 * true['x']:+6.1f}, {1e3 * true['y']:+6.1f}) mm{_strength(true)}"


def _strength(true: dict) -> str:
    """Nothing for a bare conductor."""
    if true["force"] is None:
        return ""
    return f", true {true['force']:.2f} N {true['pressure'] / 1e3:.1f} kPa"

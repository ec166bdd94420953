"""Contacts as lines for people, beside the truth where it is known."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from tomotactile_ros.support.checks import at_least

_ROUGH = 0.5  # of a force: with a larger deviation it is an estimate of its size


def pair(contacts: Sequence, truth: Sequence[dict]) -> list[int | None]:
    """For each contact the index of its true one; nearest in sum, None where there are fewer."""
    found = np.array([(c.x, c.y) for c in contacts]).reshape(-1, 2)
    true = np.array([(t["x"], t["y"]) for t in truth]).reshape(-1, 2)
    distance = np.linalg.norm(found[:, None] - true, axis=-1)
    partner: list[int | None] = [None] * len(contacts)
    for i, j in zip(*linear_sum_assignment(distance), strict=True):
        partner[int(i)] = int(j)
    return partner


def contact_lines(
    contacts: Sequence,
    truth: Sequence[dict] | None = None,
    calibrated: bool = True,
    width: int = 200,
    complete: bool = True,
) -> list[str]:
    """One line for each contact (x, y in m, force in N, pressure in Pa), and each one missed.

    Parameters
    ----------
    contacts : strongest first.
    truth : what `Scene.truth` says, or None where it is not known.
    calibrated : whether a contact law gives forces; without one there are places only.
    width : characters that fit; what does not is left out, never cut.
    complete : whether all was tried; else one contact may stand for all, of which none is told from the others.
    """
    if stand_for_all(contacts, complete):
        about = contacts[0]
        parts = [f"something presses about {_place(about.x, about.y)}"]
        return [fitting([*parts, f"  about {about.force:5.2f} N" if calibrated else ""], width)]
    partner = pair(contacts, truth or ())
    lines = []
    for number, contact, j in zip(numbers_of(contacts), contacts, partner, strict=True):
        parts = [f"contact {number}: {_place(contact.x, contact.y)}"]
        if calibrated:
            rough = "about " if contact.force_std > _ROUGH * contact.force else ""
            about = at_least(contact.force_std) or rough
            parts += [f"  {about}{contact.force:5.2f} N", f"  {contact.pressure / 1e3:5.1f} kPa"]
        if truth is not None:
            parts += ["  nothing is there"] if j is None else _compare(contact, truth[j])
        lines.append(fitting(parts, width))
    for j, true in enumerate(truth or ()):
        if j not in partner:
            parts = [f"not found: {_place(true['x'], true['y'])}", *_strength(true)]
            lines.append(fitting(parts, width))
    return lines or ["no contact"]


def other_line(alternative: Sequence | None) -> list[str]:
    """What may be there as well, in one line; none where nothing else is nearly as likely."""
    if alternative is None:
        return []
    places = ", ".join(_place(each.x, each.y) for each in alternative)
    return [f"or, nearly as likely: {places or 'no contact'}"]


def stand_for_all(contacts: Sequence, complete: bool) -> bool:
    """Whether there is only one contact that stands for all of a frame that was cut."""
    return not complete and len(contacts) == 1 and not contacts[0].id


def numbers_of(contacts: Sequence, complete: bool = True) -> list[int]:
    """What people call contacts: their ids, or ranks where nobody follows them; 0 of one that stands
    for all."""
    if stand_for_all(contacts, complete):
        return [0]
    return [contact.id or rank for rank, contact in enumerate(contacts, 1)]


def withheld_line(reason: str) -> str:
    """What is said in place of contacts that are withheld."""
    return f"contacts are withheld: {reason}"


def fault_lines(faults: Mapping[int, str]) -> list[str]:
    """One line for each electrode that is left out."""
    return [f"electrode {electrode} left out: {why}" for electrode, why in sorted(faults.items())]


def fitting(parts: Sequence[str], width: int) -> str:
    """As many of the parts as fit, the first one cut between words if even that does not."""
    text = parts[0]
    while len(text) > width and " " in text:
        text = text.rpartition(" ")[0]
    for part in parts[1:]:
        if len(text + part) > width:
            break
        text += part
    return text


def _place(x: float, y: float) -> str:
    return f"({1e3 * x:+6.1f}, {1e3 * y:+6.1f}) mm"


def _compare(contact, true: dict) -> list[str]:
    distance = np.hypot(contact.x - true["x"], contact.y - true["y"])
    return [f"  off by {1e3 * distance:4.1f} mm", *_strength(true)]


def _strength(true: dict) -> list[str]:
    """Nothing for a bare conductor."""
    if true["force"] is None:
        return []
    return [f", true {true['force']:.2f} N", f" {true['pressure'] / 1e3:.1f} kPa"]

"""Contacts that come from outside while a scene is simulated: what pressed when, from any thread.

A message of touches replaces all that were there. It holds for `HOLD` seconds: who presses on has
to say so again, and a publisher that has died does not press for ever.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.support.errors import InputError, complaints_at

HOLD = 0.5  # s
MOST = 64  # touches at a time
_KEPT = 1024  # messages: those of a frame are asked for when it is over


@dataclass(frozen=True)
class Touch:
    """A disc about (``x``, ``y``), m, with ``radius``, m, that presses evenly with ``force``, N."""

    x: float
    y: float
    force: float
    radius: float


class Touches:
    """What pressed on the sheet of ``layout``, and when."""

    def __init__(self, layout: Layout):
        self._layout = layout
        self._lock = threading.Lock()
        self._made: dict[Touch, Contact] = {}
        self._spans: deque[tuple[float, float, tuple[Contact, ...]]] = deque(maxlen=_KEPT)

    def press(self, touches: Sequence[Touch], t: float) -> list[str]:
        """From the time ``t`` (s) on these touches are there, and no others.

        Touches that do not go are left out; a line about each is returned. One without force is
        none. A touch like one of the last message is the very same contact.
        """
        made, contacts, complaints = {}, [], []
        for i, touch in enumerate(touches[:MOST]):
            if touch.force == 0:
                continue
            try:
                made[touch] = self._made.get(touch) or self._contact(touch, i)
                contacts.append(made[touch])
            except InputError as error:
                complaints.append(str(error))
        if len(touches) > MOST:
            complaints.append(f"touches: {len(touches)} of them, only the first {MOST} are taken")
        with self._lock:
            self._made = made
            if self._spans:
                since, until, before = self._spans[-1]
                self._spans[-1] = since, min(until, t), before
            self._spans.append((t, t + HOLD, tuple(contacts)))
        return complaints

    def clear(self) -> None:
        """Forget everything: time begins anew."""
        with self._lock:
            self._spans.clear()

    def at(self, t: float) -> tuple[Contact, ...]:
        """What presses at the time ``t`` (s)."""
        with self._lock:
            for since, until, contacts in reversed(self._spans):
                if since <= t:
                    return contacts if t < until else ()
        return ()

    def _contact(self, touch: Touch, number: int) -> Contact:
        with complaints_at(f"touches[{number}]: "):
            contact = Contact("disc", (touch.x, touch.y), radius=touch.radius, force=touch.force)
            outline = self._layout.outline
            if contact.radius > max(outline.size) / 2:
                raise InputError(f"radius: {contact.radius:g} m is wider than the sheet")
            if not outline.contains(contact.center[None], contact.radius)[0]:
                x, y = contact.center
                raise InputError(f"position: ({x:g}, {y:g}) m is off the sheet")
            return contact

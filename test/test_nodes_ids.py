"""Ids over DDS: a second in which nothing is estimated ends no contact."""

import os
import signal
import time
from functools import partial

import pytest

pytest.importorskip("rclpy")

from tomotactile_ros.msg import ContactArray
from tomotactile_ros.nodes.conversions import stamp_of

STOPPED = 0.6, 1.2  # s: less than rows are waited for before contacts come from frames, and more


def test_ids_outlast_an_estimator_that_is_stopped(probe, start):
    """Two discs move slowly; the process that estimates is held for a second."""
    given = {"scene": "default", "delivery": "rows", "profile": "accurate"}
    _, estimator = (start(name, given) for name in ("driver", "reconstruction"))
    heard = probe.listen(ContactArray, "contacts", 500)

    def both(since=0.0):
        """Ids of the first message after that which has both."""
        for message in heard:
            if stamp_of(message.header) > since and len(message.contacts) == 2:
                return {contact.id for contact in message.contacts}
        return set()

    probe.until(lambda: both(), "two contacts")
    first = both()
    for stopped in STOPPED:
        os.kill(estimator.pid, signal.SIGSTOP)
        time.sleep(stopped)
        os.kill(estimator.pid, signal.SIGCONT)
        ready = partial(both, time.time() + 0.5)
        probe.until(ready, "two contacts of half a second later")
    ids = [{c.id for c in m.contacts} for m in heard if m.state == ContactArray.VALID]
    assert set().union(*ids[ids.index(first) :]) == first
    # where something touched already when rows began, contacts are those of frames until one has told
    assert not any("already touched" in message.reason for message in heard)
    last = [m for m in heard if m.contacts][-1]
    assert min(contact.age for contact in last.contacts) > sum(STOPPED)

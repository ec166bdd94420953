"""Single rows of a sheet whose contacts change from row to row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.sheet.contacts import Patches, contact_points
from tomotactile_ros.sheet.frames import frame
from tomotactile_ros.sheet.transfer import Sheet


def moving_rows(
    sheet: Sheet,
    touching: Sequence[Sequence[tuple[Patches, ArrayLike]]],
    grounded: np.ndarray,
    drive_voltage: float,
    to_ground: np.ndarray,
) -> np.ndarray:
    """(L, E) potentials, V, of rows that are each taken of another state of the contacts.

    Parameters
    ----------
    touching : for each row what `contact_points` takes
    grounded : (L,) electrode that is grounded in each row
    to_ground : (E,) resistance between each electrode and ground, ohm; infinite: never grounded
    """
    rows = [
        frame(
            *contact_points(sheet, contacts),
            drive_voltage,
            grounded=[ground],
            switch_resistance=to_ground,
            own_reading=True,
        )[0]
        for contacts, ground in zip(touching, grounded)
    ]
    return np.array(rows)

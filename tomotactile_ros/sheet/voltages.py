"""Voltage frames of a sheet with any number of contacts, their mutual effect exact.

For each ground condition l, contacts C with resistances r_C to the driving layer at V0 obey

    (Z_l(C, C) + R_l + diag(r_C)) I_C = V0 1,        v_n = (Z_l(n, C) + R_l) I_C

with R_l for what lies between electrode l and ground: it lifts the grounded electrode itself to
R_l sum(I_C), and everything on the sheet with it.

`Z_l` differs from the ungrounded `G` by a matrix of rank two, so one factorisation of
`A = G(C, C) + diag(r_C)` serves all l but those under a contact. With `a = A^-1 1`,
`B = A^-1 G(C, E)`, `alpha = sum(a)`, `beta = G(E, C) a` and `gamma = G(E, C) B` the remaining 2 x 2
system is solved by hand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.sheet.transfer import Transfer


def frame(
    transfer: Transfer,
    resistance: ArrayLike,
    drive_voltage: float,
    *,
    grounded: ArrayLike | None = None,
    switch_resistance: ArrayLike = 0.0,
    own_reading: bool = False,
) -> np.ndarray:
    """Voltages of one frame.

    Parameters
    ----------
    transfer : the contacts are all of its K points
    resistance : (K,) contact resistance of each point, ohm; 0 is a bare conductor at the drive
        voltage, infinity is no contact
    grounded : (L,) grounded electrode of each row; all electrodes in turn without it
    switch_resistance : between the grounded electrode and ground, ohm; one for all, or (E,);
        infinite where it is never grounded: its row is at the drive voltage if anything touches
    own_reading : what the grounded electrode itself is at instead of NaN

    Returns
    -------
    (L, E) array, V; NaN where the electrode is the grounded one. 0 V without contact. A bare
    conductor on the very electrode that is grounded is a short circuit: ground wins there.
    """
    electrodes = transfer.electrodes
    to_earth = np.broadcast_to(np.asarray(switch_resistance, float), electrodes)
    grounded = np.arange(electrodes) if grounded is None else np.asarray(grounded, int)
    resistance = np.asarray(resistance, float)
    out = np.zeros((len(grounded), electrodes))
    touching = np.flatnonzero(np.isfinite(resistance))
    contacts = transfer
    if len(touching) < len(resistance):
        contacts, resistance = transfer.at(touching), resistance[touching]
    green = contacts.among(np.arange(len(touching)))
    under_contact = np.zeros(electrodes + 1, bool)  # the last for contacts on no electrode
    under_contact[contacts.electrode_of] = True
    open_wire = np.isinf(to_earth[grounded])
    covered = under_contact[grounded] & ~open_wire
    alone = ~covered & ~open_wire
    if len(touching):
        out[open_wire] = drive_voltage
    if len(touching) and alone.any():
        out[alone] = _rows(
            green + np.diag(resistance),
            contacts.electrode_point,
            transfer.electrode_electrode,
            grounded[alone],
            drive_voltage,
            to_earth[grounded[alone]],
        )
    for row in np.flatnonzero(covered):
        out[row] = _row_under_contact(
            contacts, green, resistance, grounded[row], drive_voltage, to_earth[grounded[row]]
        )
    if not own_reading:
        out[np.arange(len(grounded)), grounded] = np.nan
    return out


def _row_under_contact(
    contacts: Transfer,
    green: np.ndarray,
    resistance: np.ndarray,
    ground: int,
    drive_voltage: float,
    switch_resistance: np.ndarray,
) -> np.ndarray:
    """(E,) with a contact on the grounded electrode, near a short circuit: no cancellation."""
    impedance = contacts.impedance(ground) + switch_resistance
    to_ground = contacts.electrode_point[ground]
    own = contacts.electrode_electrode[ground, ground] + switch_resistance
    system = green - to_ground - to_ground[:, None] + own + np.diag(resistance)
    on_ground = contacts.electrode_of == ground
    kept = np.flatnonzero(~on_ground | (resistance + switch_resistance > 0))
    if not len(kept):
        return np.zeros(contacts.electrodes)
    drive = np.full(len(kept), drive_voltage)
    return impedance[:, kept] @ np.linalg.solve(system[np.ix_(kept, kept)], drive)


def _rows(
    system: np.ndarray,
    coupling: np.ndarray,
    between: np.ndarray,
    grounded: np.ndarray,
    drive_voltage: float,
    switch_resistance: np.ndarray,
) -> np.ndarray:
    """(L, E) for A = `system` (n, n), G(E, C) = `coupling` (E, n) and G(E, E) = `between`."""
    solved = np.linalg.solve(system, np.column_stack([np.ones(len(system)), coupling.T]))
    alpha = solved[:, 0].sum()
    beta = coupling @ solved[:, 0]
    gamma = coupling @ solved[:, 1:]
    open_loop = 1 - beta[grounded]
    back = between[grounded, grounded] + switch_resistance - gamma[grounded, grounded]
    ground_voltage = drive_voltage / (open_loop**2 + alpha * back)
    total = ground_voltage * alpha  # the current through the grounded electrode
    drop = ground_voltage * open_loop  # drive voltage minus the reference potential
    columns = gamma[:, grounded] - between[:, grounded]
    return drop[:, None] * (beta - 1) + total[:, None] * columns.T + drive_voltage

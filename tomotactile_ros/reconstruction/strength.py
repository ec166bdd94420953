"""How strongly each contact conducts, once it is known where the contacts are.

For ground condition l the readings are linear in the currents of the contacts, v_l = Z_l(E, C) I_l. The
currents come from least squares, the potentials from phi_l = Z_l(C, C) I_l, and the conductance from Ohm's
law over all conditions, I_l = g (V0 - phi_l): no bias by the mutual effect of contacts.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.sheet.transfer import Transfer

LARGEST = 1e6  # conductance times sheet impedance: a bare conductor and its noise cannot be told apart


def contact_conductance(
    transfer: Transfer, voltages: np.ndarray, grounded: np.ndarray, drive_voltage: float
) -> np.ndarray:
    """(n,) conductance of each contact, S, finite and not negative.

    Parameters
    ----------
    transfer : its K = n points are the contacts
    voltages : (L, E) V, NaN where there is no reading
    grounded : (L,)
    """
    ee, ep = transfer.electrode_electrode, transfer.electrode_point
    count = len(transfer.points)
    own = np.diagonal(ee)[grounded][:, None, None]
    at_ground = ep[grounded]  # (L, n)
    coupling = ep - at_ground[:, None] - ee[grounded][:, :, None] + own  # (L, E, n)
    valid = np.isfinite(voltages)
    coupling = coupling * valid[:, :, None]
    readings = np.where(valid, voltages, 0.0)
    normal = np.einsum("lei,lej->lij", coupling, coupling)
    right = np.einsum("lei,le->li", coupling, readings)
    ridge = 1e-9 * np.trace(normal, axis1=1, axis2=2).max() + 1e-300
    current = np.linalg.solve(normal + ridge * np.eye(count), right[:, :, None])[:, :, 0]
    current = np.maximum(current, 0.0)
    among = transfer.among(np.arange(count))
    between = among - at_ground[:, :, None] - at_ground[:, None, :] + own
    potential = np.einsum("lij,lj->li", between, current)
    drop = np.clip(drive_voltage - potential, 0.0, drive_voltage)
    least = (1e-3 * drive_voltage) ** 2 * len(drop)
    total = (current * drop).sum(axis=0) / np.maximum((drop**2).sum(axis=0), least)
    return np.clip(total, 0.0, LARGEST)

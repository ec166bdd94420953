"""How strongly each contact conducts, once the image has told where the contacts are.

The currents into the grounded electrodes are shared out over the contacts, y = sum_b c_b h_b with h_b the mean
of H over the contact's part of the image. The contact's own conductance follows from its effective one by
taking off the way to the grounded electrodes, 1 / g = 1 / c - D.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

_BARE = 0.98  # largest part of the way's conductance that c may reach: a bare conductor has 1


def effective_conductances(shares: np.ndarray, currents: np.ndarray) -> np.ndarray:
    """(B,) c >= 0 in S from shares h (n, B) and currents y (n,), S; the total is that of the currents."""
    if shares.shape[1] == 1:
        return np.maximum(currents.sum(), 0.0).reshape(1)
    try:
        found = nnls(shares, currents)[0]
    except RuntimeError:  # not converged
        found = np.maximum(np.linalg.lstsq(shares, currents, rcond=None)[0], 0.0)
    total = found.sum()
    return found * (max(float(currents.sum()), 0.0) / total) if total > 0 else found


def contact_conductances(effective: np.ndarray, impedance: np.ndarray) -> np.ndarray:
    """(B,) g in S, finite: the contact's own conductance from c (S) and D (ohm)."""
    return effective / (1 - np.minimum(effective * impedance, _BARE))

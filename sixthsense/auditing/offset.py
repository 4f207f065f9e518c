"""The time offset between the clocks of an estimate and of the truth, searched where the NEES is least."""

from __future__ import annotations

import numpy as np

from sixthsense.auditing.pairing import Align, Pair, aligned, errors_of, paired
from sixthsense.auditing.poses import AuditError, Frame, Poses

_POSES = 1000
"""of the first search, evenly chosen; the second one uses all"""
_STEPS = 100
"""of the grid on which the least value is bracketed, each side"""


def time_offset_s(estimate: Poses, truth: Poses, limit_s: float, align: Align, frame: Frame) -> float:
    """Seconds to add to the stamps of the estimate, within +- `limit_s`, so that its mean NEES is least.

    The search uses the poses whose stamps lie within the truth for every offset. Raises AuditError if there are none,
    and if the least value lies at the limit.
    """
    from scipy.optimize import minimize_scalar

    limit_ns = round(limit_s * 1e9)
    low, high = truth.stamps_ns[0] + limit_ns, truth.stamps_ns[-1] - limit_ns
    rows = np.flatnonzero((estimate.stamps_ns >= low) & (estimate.stamps_ns <= high))
    if len(rows) < 2:
        raise AuditError(
            f"time offset: found no pose more than {limit_s:g} s within the truth, allowed: a smaller limit"
        )
    some = estimate.part(rows[np.unique(np.linspace(0, len(rows) - 1, _POSES).astype(np.int64))])
    every = estimate.part(rows)

    def cost(offset_s: float, poses: Poses = some) -> float:
        pair: Pair = paired(poses, truth, round(offset_s * 1e9))
        found = errors_of(pair, aligned(pair, align, frame), align, frame)
        return float(np.mean(found.nees))

    grid = np.linspace(-limit_s, limit_s, 2 * _STEPS + 1)
    best = int(np.argmin([cost(offset) for offset in grid]))
    if best in (0, len(grid) - 1):
        raise AuditError(
            f"time offset: found the least NEES at the limit of {limit_s:g} s, allowed: a larger limit, or a robot "
            "that moves"
        )
    bounds = (grid[best - 1], grid[best + 1])
    found = minimize_scalar(cost, bounds=bounds, args=(every,), method="bounded", options={"xatol": 1e-5})
    return float(found.x)

"""The field of view of a laser that its log does not state, from the turns that scans and odometry both see."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan
from sixthsense.logs.clocks import shifts, view

FIELDS_RAD = tuple(math.radians(degrees) for degrees in (180.0, 240.0, 270.0, 360.0))
"""Of lasers in use."""
_LEAST_RAD, _MOST_RAD, _MOST_M = 0.3, 0.8, 0.2  # by which a robot turns and moves between two scans that are compared
_PAIRS, _FEWEST, _LATEST = 300, 10, 50  # pairs that are compared, at most and at least, and scans between the two
_AGREES, _AGREES_RAD = 0.08, 0.01  # of the turn, and beside it, by which wheels and scans differ


def seen_ratio(scans: Sequence[Scan], poses: Array, ratios: Sequence[float]) -> float | None:
    """By which of some ratios the turns that scans see are multiplied to be those of odometry, of poses (N, 3).

    1: the beams lie as stated; 1.5: they span half as much again; negative: they turn the other way round. None where
    the robot turns too seldom, and where most turns agree with none of the ratios.
    """
    pairs = _pairs(poses)
    if len(pairs) < _FEWEST:
        return None
    views = {k: view(scans[k]) for k in np.unique(pairs).tolist()}
    before, after = (np.array([views[k] for k in column]) for column in pairs.T.tolist())
    seen, is_seen = shifts(before, after)
    turns = np.diff(np.unwrap(poses[:, 2])[pairs], axis=1)[:, 0]
    agrees = [np.abs(ratio * seen - turns) < _AGREES * np.abs(turns) + _AGREES_RAD for ratio in ratios]
    votes = [int(np.count_nonzero(is_seen & agree)) for agree in agrees]
    best = int(np.argmax(votes))
    return ratios[best] if 2 * votes[best] > len(pairs) else None


def _pairs(poses: Array) -> NDArray[np.int64]:
    """(P, 2) rows of poses (N, 3) between which the robot turns, nearly on the spot."""
    headings, found = np.unwrap(poses[:, 2]), []
    for first in range(len(poses)):
        rows = slice(first + 1, first + 1 + _LATEST)
        turned = np.abs(headings[rows] - headings[first])
        enough = np.flatnonzero(turned > _LEAST_RAD)
        if len(enough):
            then = int(enough[0])
            if turned[then] < _MOST_RAD and math.dist(poses[first + 1 + then, :2], poses[first, :2]) < _MOST_M:
                found.append((first, first + 1 + then))
    some = np.unique(np.linspace(0, len(found) - 1, min(_PAIRS, len(found))).astype(np.int64))
    return np.array(found, dtype=np.int64).reshape(-1, 2)[some]

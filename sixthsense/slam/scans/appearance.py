"""What a place looks like, whatever pose it is seen from: how often two points of it are so far and so turned apart.

Pairs of surface points are counted by their distance, by the angle between their normals and by those of both normals
with the line from one to the other, as in point pair features (Drost, Ulrich, Navab and Ilic, "Model globally, match
locally", CVPR 2010) and shape distributions (Osada, Funkhouser, Chazelle and Dobkin, ACM TOG 21(4), 2002). A shift or a
turn leaves the counts as they are, and neighbouring poses see much the same pairs.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.core.geometry import Array

_NEAR_M, _NEAR_BINS, _FAR_BINS = 0.75, 16, 8  # width of bins of distance up to 12 m; those beyond are twice as wide
_ANGLES = 3  # bins of the angle between normals, and of both with the line between the points
_ALIKE, _ACROSS = (0.5, 0.87), (0.5, 1.2)  # edges of these: of the cosine, and of the sum of two cosines
_MOST = 250  # points whose pairs are counted
BINS = (_NEAR_BINS + _FAR_BINS) * _ANGLES**2


def appearance(surfaces: Array) -> Array:
    """(BINS,) unit vector of points with normals (N, 4), x, y and the normal's; the product of two is 1 if alike."""
    rows = np.linspace(0, len(surfaces) - 1, min(len(surfaces), _MOST)).astype(np.int64)
    counts = _pair_counts(np.ascontiguousarray(surfaces[rows]))
    return np.asarray(np.sqrt(counts / max(float(counts.sum()), 1.0)))


@numba.njit(cache=True, error_model="numpy")
def _pair_counts(surfaces: Array) -> Array:
    """(BINS,) how many pairs of points there are of each kind; a point without a normal is in none."""
    counts = np.zeros(BINS)
    for i in range(len(surfaces)):
        x, y, nx, ny = surfaces[i]
        if nx == 0.0 and ny == 0.0:
            continue
        for j in range(i):
            mx, my = surfaces[j, 2], surfaces[j, 3]
            if mx == 0.0 and my == 0.0:
                continue
            dx, dy = surfaces[j, 0] - x, surfaces[j, 1] - y
            distance = math.hypot(dx, dy)
            along = (abs(nx * dx + ny * dy) + abs(mx * dx + my * dy)) / max(distance, 1e-9)
            k = int(distance / _NEAR_M)
            if k >= _NEAR_BINS:
                k = min(_NEAR_BINS + (k - _NEAR_BINS) // 2, _NEAR_BINS + _FAR_BINS - 1)
            k = _ANGLES * k + _bin(abs(nx * mx + ny * my), _ALIKE)
            counts[_ANGLES * k + _bin(along, _ACROSS)] += 1.0
    return counts


@numba.njit(cache=True, error_model="numpy")
def _bin(value: float, edges: tuple[float, float]) -> int:
    return int(value >= edges[0]) + int(value >= edges[1])

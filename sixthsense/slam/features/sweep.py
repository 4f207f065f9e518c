"""What the time that a scan took adds to the covariance of its sightings: the odometry that de-skewed it is noisy.

The motion from a beam's time to the scan's stamp is known as badly as odometry is over that lag: a random walk, whose
covariance grows with the lag. All sightings of a scan share that error, and an estimator takes them as independent:
F of them would make the pose look known F times better than it is. So each bears F times its share.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import Kind, Sighting
from sixthsense.core.laser import Scan


def with_sweep(sightings: Sequence[Sighting], scan: Scan) -> tuple[Sighting, ...]:
    """The sightings (robot's frame) of a de-skewed scan with the noise of its sweep; those of an instant unchanged."""
    if scan.sweep is None or not sightings:
        return tuple(sightings)
    cov = len(sightings) * scan.sweep.cov
    directions = scan.bearings
    out = []
    for sighting in sightings:
        x, y = scan.T_robot_laser.inverse() @ _place(sighting)
        ahead = directions[0] + (math.atan2(y, x) - directions[0]) % (2.0 * math.pi)
        lag = float(np.interp(ahead, directions, scan.sweep.lags))
        by_motion = _by_motion(sighting)
        out.append(dataclasses.replace(sighting, cov=sighting.cov + lag * by_motion @ cov @ by_motion.T))
    return tuple(out)


def _place(sighting: Sighting) -> Array:
    """(2,) where it was seen: a point itself, or the middle of what was seen of a wall; robot's frame."""
    if sighting.kind != Kind.WALL:
        return sighting.z
    c, s = math.cos(sighting.z[0]), math.sin(sighting.z[0])
    along = 0.5 * (sighting.extent[0] + sighting.extent[1])
    return np.array([sighting.z[1] * c - along * s, sighting.z[1] * s + along * c])


def _by_motion(sighting: Sighting) -> Array:
    """(2, 3) Jacobian of the sighting by a motion (x, y, theta) of the frame that it is moved into, axes of that."""
    if sighting.kind == Kind.WALL:
        return np.array([[0.0, 0.0, 1.0], [math.cos(sighting.z[0]), math.sin(sighting.z[0]), 0.0]])
    return np.array([[1.0, 0.0, -sighting.z[1]], [0.0, 1.0, sighting.z[0]]])

"""Noise that the duration of a scan adds to its sightings: the odometry that de-skewed it is uncertain.

The motion from a beam's time to the scan's stamp is as uncertain as odometry is over that lag: a random walk, whose
covariance grows with the lag. All sightings of a scan share that error, but an estimator takes them as independent:
with F of them the pose would be overconfident by a factor of F. So the share of each is multiplied by F.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import Kind, Sighting
from sixthsense.core.laser import Scan


def add_sweep_noise(sightings: Sequence[Sighting], scan: Scan) -> tuple[Sighting, ...]:
    """Sightings (robot's frame) with the noise of the scan's sweep; unchanged where the scan was not de-skewed."""
    if scan.sweep is None or not sightings:
        return tuple(sightings)
    cov = len(sightings) * scan.sweep.cov
    bearings = scan.bearings
    out = []
    for sighting in sightings:
        x, y = scan.T_robot_laser.inverse() @ _seen_position(sighting)
        bearing = bearings[0] + (math.atan2(y, x) - bearings[0]) % (2.0 * math.pi)
        lag = float(np.interp(bearing, bearings, scan.sweep.lags))
        by_motion = _motion_jacobian(sighting)
        out.append(dataclasses.replace(sighting, cov=sighting.cov + lag * by_motion @ cov @ by_motion.T))
    return tuple(out)


def _seen_position(sighting: Sighting) -> Array:
    """(2,) position of a point, or the middle of the seen part of a wall; robot's frame."""
    if sighting.kind != Kind.WALL:
        return sighting.z
    c, s = math.cos(sighting.z[0]), math.sin(sighting.z[0])
    along = 0.5 * (sighting.extent[0] + sighting.extent[1])
    return np.array([sighting.z[1] * c - along * s, sighting.z[1] * s + along * c])


def _motion_jacobian(sighting: Sighting) -> Array:
    """(2, 3) Jacobian of the sighting by a motion (x, y, theta) of the robot's frame, in the axes of that frame."""
    if sighting.kind == Kind.WALL:
        return np.array([[0.0, 0.0, 1.0], [math.cos(sighting.z[0]), math.sin(sighting.z[0]), 0.0]])
    return np.array([[1.0, 0.0, -sighting.z[1]], [0.0, 1.0, sighting.z[0]]])

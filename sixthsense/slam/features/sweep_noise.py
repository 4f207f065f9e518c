"""Noise that the duration of a scan adds to its observations: the odometry that de-skewed it is uncertain.

The motion from a beam's time to the scan's stamp is as uncertain as odometry is over that lag: a random walk, whose
covariance grows with the lag. All observations of a scan share that error, but an estimator takes them as independent:
with F of them the pose would be overconfident by a factor of F. So the share of each is multiplied by F.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.laser import Scan


def add_sweep_noise(observations: Sequence[Observation], scan: Scan) -> tuple[Observation, ...]:
    """Observations (robot's frame) with the noise of the scan's sweep; unchanged where the scan was not de-skewed."""
    if scan.sweep is None or not observations:
        return tuple(observations)
    cov = len(observations) * scan.sweep.cov
    bearings = scan.bearings
    out = []
    for observation in observations:
        x, y = scan.T_robot_laser.inverse() @ _seen_position(observation)
        bearing = bearings[0] + (math.atan2(y, x) - bearings[0]) % (2.0 * math.pi)
        lag = float(np.interp(bearing, bearings, scan.sweep.lags))
        by_motion = _motion_jacobian(observation)
        out.append(dataclasses.replace(observation, cov=observation.cov + lag * by_motion @ cov @ by_motion.T))
    return tuple(out)


def _seen_position(observation: Observation) -> Array:
    """(2,) position of a point, or the middle of the seen part of a wall; robot's frame."""
    if observation.kind != Kind.WALL:
        return observation.z
    c, s = math.cos(observation.z[0]), math.sin(observation.z[0])
    along = 0.5 * (observation.extent[0] + observation.extent[1])
    return np.array([observation.z[1] * c - along * s, observation.z[1] * s + along * c])


def _motion_jacobian(observation: Observation) -> Array:
    """(2, 3) Jacobian of the observation by a motion (x, y, theta) of the robot's frame, in the axes of that frame."""
    if observation.kind == Kind.WALL:
        return np.array([[0.0, 0.0, 1.0], [math.cos(observation.z[0]), math.sin(observation.z[0]), 0.0]])
    return np.array([[1.0, 0.0, -observation.z[1]], [0.0, 1.0, observation.z[0]]])

"""Walls in a factor graph: a frame whose origin lies on the wall, x along it and y its normal.

Where along the wall the origin lies means nothing: it is held where the wall was born, and a sighting is stated
at that very place, so that a factor between two frames of GTSAM's will do.
"""

from __future__ import annotations

import math

import numpy as np

from sixthsense.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.landmarks import Sighting

# Sigma along the wall. Loose at birth, the origin's own uncertainty would come in across the wall, times half of each
# angle's residual: GTSAM's logarithm of a motion mixes them.
_AT_BIRTH_M, _LATER_M = 1e-3, 1e3


def birth(pose: Pose, sighting: Sighting) -> Pose:
    """The frame (`T_world_wall`) of a wall that is sighted from `pose`: in the middle of what was seen."""
    alpha = float(sighting.z[0])
    middle = 0.5 * (sighting.extent[0] + sighting.extent[1])
    x, y = rotation(alpha) @ np.array([float(sighting.z[1]), middle])
    return pose @ Pose(x, y, alpha - 0.5 * math.pi)


def measurement(pose: Pose, frame: Pose, sighting: Sighting, at_birth: bool) -> tuple[Pose, Array]:
    """A sighting from `pose` as the motion from there to the wall's `frame`, and its covariance (3, 3), frame's axes.

    The measured line is taken where the frame's origin is expected: there its offset is known by d and, with the lever
    from the robot's foot, by alpha. It is stated as the frame expected and the innovation from there: with the
    measured line's own axes the residual would be off by d times the square of the angle's error.
    """
    expected = pose.inverse() @ frame
    (alpha, d), axes = line(expected)
    lever = float(axes[1, 2])
    turn = wrap_angle(float(sighting.z[0]) - float(alpha))
    offset = float(sighting.z[1]) - float(d) - lever * turn
    # Errors of (x, y, theta) in the frame's axes, of which x is the wall's own business: y = dd - lever * dalpha.
    by_z = np.array([[0.0, 0.0], [-lever, 1.0], [1.0, 0.0]])
    cov = by_z @ sighting.cov @ by_z.T
    cov[0, 0] = (_AT_BIRTH_M if at_birth else _LATER_M) ** 2
    return expected @ Pose(0.0, offset, turn), cov


def line(frame: Pose) -> tuple[Array, Array]:
    """The wall (alpha, d) of a frame, and (2, 3) its errors by those of the frame (x, y, theta), its own axes."""
    alpha = Pose(theta=frame.theta + 0.5 * math.pi).theta
    normal, along = np.array([math.cos(alpha), math.sin(alpha)]), np.array([-math.sin(alpha), math.cos(alpha)])
    mean = np.array([alpha, float(normal @ frame.position)])
    return mean, np.array([[0.0, 0.0, 1.0], [0.0, 1.0, float(along @ frame.position)]])

"""Walls in a factor graph: a frame whose origin lies on the wall, x along it and y its normal.

Where along the wall the origin lies means nothing: it is held where the wall was born. A sighting says how far from the
wall the robot is and how it is turned to it: a factor between two frames of GTSAM's, loose along the wall.
"""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Sighting

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
    """A sighting as where the robot is in the wall's frame, and the root of its information (3, 3), robot's axes.

    There its y is the distance to the wall, and its heading is the angle, whatever the expectation: no linearisation
    enters. Seen from the robot instead, a turn of the wall would shift it by d/2 times the square of the turn. What
    comes in of `pose` and `frame`, as they are expected, is where along the wall the robot is.
    """
    along = (frame.inverse() @ pose).x
    measured = Pose(along, -float(sighting.z[1]), 0.5 * math.pi - float(sighting.z[0]))
    # In the wall's axes the errors of (y, theta) are those of (d, alpha), both with the other sign.
    root = np.zeros((3, 3))
    root[0, 0] = 1.0 / (_AT_BIRTH_M if at_birth else _LATER_M)
    root[1:, 1:] = np.linalg.cholesky(np.linalg.inv(sighting.cov[::-1, ::-1])).T
    root[:, :2] = root[:, :2] @ rotation(measured.theta)  # GTSAM's residual is in the measured pose's own axes
    return measured, root


def lines(frames: Array) -> tuple[Array, Array]:
    """(n, 2) walls (alpha, d) of frames (n, 3), and (n, 2, 3) their errors by those of the frames, in its own axes."""
    alpha = wrap_angle(frames[:, 2] + 0.5 * math.pi)
    c, s = np.cos(alpha), np.sin(alpha)
    axes = np.zeros((len(frames), 2, 3))
    axes[:, 0, 2] = axes[:, 1, 1] = 1.0
    axes[:, 1, 2] = c * frames[:, 1] - s * frames[:, 0]  # the lever along the wall, from the origin's foot
    return np.column_stack([alpha, c * frames[:, 0] + s * frames[:, 1]]), axes

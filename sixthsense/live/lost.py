"""Where a robot is whose odometry has begun anew: searched in the map so far."""

from __future__ import annotations

import dataclasses

import numpy as np

from sixthsense.core.geometry import Pose
from sixthsense.core.source import Tick
from sixthsense.live.joining import Anew
from sixthsense.record.trace import Trace
from sixthsense.slam.relocalization import MOST_DRIVEN_M, Relocalizer

NEAR_M = 0.25
"""A robot that can have driven no farther while it sent nothing is taken to stand where it was."""

_SIGMA_M, _SIGMA_RAD = 0.3, 0.1  # of the place found: so large that the robot counts as carried there


class Search:
    """Takes the ticks of a lost robot until its place is certain; what it sees meanwhile is not mapped.

    Two places need one look alone, since something else says them: where the robot was, and where its odometry would be
    if it had not begun anew.
    """

    def __init__(self, trace: Trace, last: Tick, anew: Anew) -> None:
        """Begin with the map so far; `last` is the newest tick with a scan that the map has."""
        assert trace.grid is not None
        self.anew = anew
        self._T_odom_map = last.odometry @ Pose.from_array(trace.estimates[-1]).inverse()
        T_map_stood = self._T_odom_map.inverse()
        expected = (T_map_stood, T_map_stood @ anew.T_stood_went)
        self._relocalizer = Relocalizer(trace.grid.submap(), trace.config.grid, expected)

    @property
    def is_over(self) -> bool:
        """Whether the robot has driven so far that its place is not in the map."""
        return self._relocalizer.driven_m > MOST_DRIVEN_M

    def take(self, tick: Tick) -> Pose | None:
        """Look at a tick; how its odometry is to be moved to where the robot is, None before that is known."""
        found = None if tick.scan is None else self._relocalizer.take(tick.scan, tick.odometry)
        return None if found is None else self._T_odom_map @ found


def placed(tick: Tick, T: Pose) -> Tick:
    """The tick with its odometry moved by `T` to a place that was found; no wheel has measured the way there.

    Its scan is left out: the next one is not distorted by the step.
    """
    cov = np.diag([_SIGMA_M, _SIGMA_M, _SIGMA_RAD]) ** 2
    return dataclasses.replace(tick, odometry=T @ tick.odometry, scan=None, increment_cov=cov)

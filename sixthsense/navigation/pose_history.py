"""Where the robot has been and how certain its position was there: when to close a loop, and where."""

from __future__ import annotations

import math

import numpy as np

from sixthsense.config import ExploreConfig
from sixthsense.core.geometry import Array, Pose

_WELL_KNOWN = 0.5  # a place is worth a loop closure if sigma there was at most this share of the present one
_NEXT_LOOP_CLOSURE = 1.5  # growth of sigma before another loop closure is tried
_MOST_LOOP_CLOSURE = 4.0  # times `loop_closure_sigma_m`: the most that a loop closure may come to need


class PoseHistory:
    """Positions at the keyframes and their largest standard deviations."""

    def __init__(self, explore: ExploreConfig) -> None:
        """Begin with no position; `explore` sets the threshold of a loop closure."""
        self.sigma_m = 0.0
        """largest standard deviation of the latest position"""
        self._explore = explore
        self._loop_closure_threshold_m = explore.loop_closure_sigma_m
        self._much_less_m = math.inf
        self._rows: list[tuple[float, float, float]] = []

    def add(self, pose: Pose, pose_cov: Array) -> None:
        """Append the pose of a keyframe, with its covariance (3, 3)."""
        self.sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(pose_cov[:2, :2])[-1]), 0.0))
        self._rows.append((pose.x, pose.y, self.sigma_m))

    @property
    def positions(self) -> Array:
        """(N, 2) all positions, world frame, metres."""
        return np.array([row[:2] for row in self._rows])

    @property
    def is_certain(self) -> bool:
        """Whether the position is certain enough to end a loop closure."""
        return self.sigma_m <= _WELL_KNOWN * self._explore.loop_closure_sigma_m

    @property
    def needs_loop_closure(self) -> bool:
        """Whether the position is so uncertain that a loop closure is due."""
        return self._explore.loop_closure and self.sigma_m > self._loop_closure_threshold_m

    @property
    def is_much_less_certain(self) -> bool:
        """Whether the position is much less certain than when a loop closure was last due."""
        return self.sigma_m > self._much_less_m

    def postpone_loop_closure(self) -> None:
        """Require a larger uncertainty for the next loop closure, whatever the present one achieves.

        Far from where it is certain, a robot that comes back by the same way is about as uncertain as before.
        """
        self._much_less_m = _NEXT_LOOP_CLOSURE * self.sigma_m
        self._loop_closure_threshold_m = min(self._much_less_m, _MOST_LOOP_CLOSURE * self._explore.loop_closure_sigma_m)

    def well_known_places(self) -> Array:
        """(K, 2) positions that were much more certain than the present one."""
        places = [(x, y) for x, y, sigma in self._rows if sigma <= _WELL_KNOWN * self.sigma_m]
        return np.array(places).reshape(-1, 2)

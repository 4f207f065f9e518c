"""Where the robot has been and how certain its position was there: when to close a loop, and where."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import ExploreConfig
from sixthsense.core.geometry import Array, Pose

_WELL_KNOWN = 0.5  # a place is worth a loop closure if sigma there was at most this share of the present one
LOOP_CLOSURE_SIGMA_M = 0.1  # a position is uncertain above this: it is two cells of the map, and shifts a wall visibly
LOST_M = LOOP_CLOSURE_SIGMA_M / _WELL_KNOWN**2
"""a robot whose position is less certain, after two loop closures that gave nothing, cannot say what it has explored;
then another is always due"""


class PoseHistory:
    """Positions at the keyframes and the largest standard deviations of those to which a return may help."""

    def __init__(self, explore: ExploreConfig) -> None:
        """Begin with no position; `explore` sets the threshold of a loop closure."""
        self.sigma_m = 0.0
        """largest standard deviation of the latest position"""
        self._explore = explore
        self._loop_closure_threshold_m = LOOP_CLOSURE_SIGMA_M
        self._much_less_m = math.inf
        self._promised_m = math.inf  # sigma at the place that the robot goes back to
        self.way_m = 0.0
        """driven until the latest position"""
        self._rows: list[tuple[float, float, float, float]] = []  # x, y, sigma, and the way driven until there

    def add(self, pose: Pose, pose_cov: Array, sees_walls: bool) -> None:
        """Append the pose of a keyframe, with its covariance (3, 3), and whether any obstacle was within reach there.

        Where there was none, a robot that comes back finds nothing that it knows.
        """
        self.sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(pose_cov[:2, :2])[-1]), 0.0))
        if self._rows:
            self.way_m += math.dist(self._rows[-1][:2], (pose.x, pose.y))
        self._rows.append((pose.x, pose.y, self.sigma_m if sees_walls else math.inf, self.way_m))

    @property
    def is_certain(self) -> bool:
        """Whether the position is certain enough to end a loop closure."""
        return self.sigma_m <= _WELL_KNOWN * LOOP_CLOSURE_SIGMA_M

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
        self._much_less_m = self.sigma_m / _WELL_KNOWN
        self._loop_closure_threshold_m = min(self._much_less_m, LOST_M)

    def well_known_places(self) -> Array:
        """(K, 4) positions with obstacles in reach that were much more certain than the present one.

        With each its sigma and the way driven since then.
        """
        places = [(x, y, s, self.way_m - way) for x, y, s, way in self._rows if s <= _WELL_KNOWN * self.sigma_m]
        return np.array(places).reshape(-1, 4)

    def go_back(self, place: Array) -> None:
        """Record that the robot goes back to one of the `well_known_places`, (4,)."""
        self._promised_m = float(place[2])

    def came_back(self) -> None:
        """Record that going back is over: places known little better than that one count as uncertain as the robot is.

        Else the robot would go back to them again and again.
        """
        least_m = _WELL_KNOWN * self._promised_m
        self._rows = [(x, y, max(s, self.sigma_m) if s >= least_m else s, way) for x, y, s, way in self._rows]

    def are_worth_it(self, places: Array, lengths_m: Array) -> NDArray[np.bool_]:
        """(K,) whether a return to `places` (K, 4) by ways of some lengths (K,) makes the position much more certain.

        The variance grows in proportion to the way. So a robot that has been there and back again is more certain than
        now by as much as the way is shorter than the one that it has driven since it was there.
        """
        _, _, sigma, since_m = places.T
        share = np.minimum(lengths_m / np.maximum(since_m, np.finfo(np.float64).tiny), 1.0)
        return np.asarray(sigma**2 + (self.sigma_m**2 - sigma**2) * share <= (_WELL_KNOWN * self.sigma_m) ** 2)

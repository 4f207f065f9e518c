"""What the smoother keeps beside the solver: what waits to be solved, and its landmarks."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, V, W
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators.isam2_factors import to_pose2
from sixthsense.slam.estimators.isam2_walls import wall_frame


@dataclass(slots=True)
class Unsolved:
    """What the solver does not have yet."""

    graph: gtsam.NonlinearFactorGraph = field(default_factory=gtsam.NonlinearFactorGraph)
    values: gtsam.Values = field(default_factory=gtsam.Values)
    motions: dict[int, tuple[Odometry, int]] = field(default_factory=dict)
    """to each of its poses from the one before, and the place of the factor in `graph`"""
    poses: list[Pose] = field(default_factory=list)
    """of updates since the last solved one, by odometry or by a link"""
    guessed: set[int] = field(default_factory=set)
    """which of them are by a link"""


@dataclass(slots=True)
class Landmarks:
    """Landmarks and their variables in the graph, in the order of the first observation."""

    keys: dict[LandmarkId, int] = field(default_factory=dict)
    is_wall: dict[LandmarkId, bool] = field(default_factory=dict)
    by_tangent: dict[LandmarkId, Array] = field(default_factory=dict)
    """(2, 3) or (2, 2) Jacobian of a landmark by its variable's tangent in GTSAM"""
    stretches: dict[tuple[LandmarkId, int], int] = field(default_factory=dict)
    """keys of the apparent walls: stretches of a wall that is not straight, by its id and the stretch's number"""
    means: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) at the last solution"""
    made: int = 0
    """number of landmarks so far, forgotten ones included"""
    apparent: int = 0
    """number of apparent walls so far, forgotten ones included"""

    def add(self, i: LandmarkId, guess: Pose, observation: Observation, values: gtsam.Values) -> None:
        """Add a landmark that is observed from `guess`, and its initial value to `values`."""
        if observation.is_wall:
            values.insert(self.next_key(i, True), to_pose2(wall_frame(guess, observation)))
        else:
            bearing, distance, _ = observation.bearing_range()
            values.insert(self.next_key(i, False), guess @ (distance * rotation(bearing)[:, 0]))

    def next_key(self, i: LandmarkId, is_wall: bool) -> int:
        """The key of a landmark that is new."""
        self.keys[i], self.is_wall[i] = int(W(self.made) if is_wall else L(self.made)), is_wall
        self.made += 1
        return self.keys[i]

    def next_stretch(self, i: LandmarkId, stretch: int) -> int:
        """The key of a stretch that is new."""
        self.stretches[i, stretch] = key = int(V(self.apparent))
        self.apparent += 1
        return key

    def drop(self, ids: Collection[LandmarkId]) -> None:
        """Remove landmarks."""
        if len(self.means) == len(self.keys):
            self.means = self.means[~np.isin(self.ids(), list(ids))]
        for i in ids:
            del self.keys[i], self.is_wall[i]
        self.stretches = {at: key for at, key in self.stretches.items() if at[0] in self.keys}

    def ids(self) -> NDArray[np.int64]:
        """(n,) of the landmarks."""
        return np.array(list(self.keys), dtype=np.int64)

    def walls(self) -> NDArray[np.bool_]:
        """(n,) which of them are walls."""
        return np.array(list(self.is_wall.values()), dtype=np.bool_)

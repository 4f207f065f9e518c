"""The interface of front ends: what makes measurements for the estimator of a tick's odometry and scan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry
from sixthsense.core.source import Tick
from sixthsense.slam.association.records import Association
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.features import NO_FEATURES, Features

Timed = Callable[[str, Callable[..., Any]], Callable[..., Any]]
"""From the name of a stage and its function to the function that runs in its place."""


@dataclass(frozen=True, slots=True)
class Keyframe:
    """What one keyframe contributed."""

    motion: Odometry
    """since the keyframe before"""
    predicted: Estimate
    """the pose before the update"""
    estimate: Estimate
    """after the update"""
    association: Association = Association()
    """which observation is of which landmark"""
    features: Features = NO_FEATURES
    """walls and landmarks that were extracted from the scan, robot's frame"""


class LoopClosureCounts(NamedTuple):
    """What the search for old places has come to."""

    found: int
    """loop closures that stand"""
    refused: int
    """places that looked right, and were refused: another looked as good, or pairs of scans did not agree"""
    undone: int
    """loop closures taken back, since later scans contradicted them"""


class PoseLinks(NamedTuple):
    """Measured relative poses of keyframes."""

    ends: NDArray[np.int64]
    """(m, 2) keyframes at which each begins and ends"""
    motions: Array
    """(m, 3) pose of the second keyframe in the frame of the first, robot's frames"""
    covs: Array
    """(m, 3, 3) of their errors, axes of the first frame"""


class FrontEnd(Protocol):
    """From ticks to what the estimator is given."""

    @property
    def pose(self) -> Pose:
        """`T_world_robot` at the last tick."""
        ...

    @property
    def since_keyframe(self) -> Pose:
        """Motion since the last keyframe."""
        ...

    @property
    def since_cov(self) -> Array:
        """(3, 3) of that motion's error, axes of the keyframe."""
        ...

    def take(self, tick: Tick, scan: Scan | None, increment: Odometry | None) -> Keyframe | None:
        """Process a tick with its de-skewed scan and the motion since the tick before; its keyframe, if it is one."""
        ...

    @property
    def loop_closure_counts(self) -> LoopClosureCounts | None:
        """What the search for old places has come to so far; None for a front end that does not search."""
        ...

    def links(self) -> PoseLinks | None:
        """The links between keyframes that the estimator has; None for a front end that makes none."""
        ...

    def finish(self) -> Array | None:
        """Predict up to the last tick.

        (S, 3) motion from the last keyframe to each scan, if that is known better now than when the scan was taken.
        """
        ...

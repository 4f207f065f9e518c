"""The interface of front ends: what makes measurements for the estimator of a tick's motion and scan."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config, KeyframeConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry
from sixthsense.core.source import Closure
from sixthsense.slam.association.records import Association
from sixthsense.slam.estimators import Estimate, Estimator
from sixthsense.slam.features import NO_FEATURES, Features

if TYPE_CHECKING:
    from sixthsense.slam.association.associator import Associator
    from sixthsense.slam.estimators.motion_source import Motion

Clock = Callable[[str], AbstractContextManager[object]]
"""Times a stage: `with clock("extract"):`"""


def untimed(stage: str) -> AbstractContextManager[object]:
    """A clock that measures nothing."""
    return nullcontext()


class Evidence(NamedTuple):
    """What a tick brings to a front end."""

    increment: Odometry | None
    """motion since the tick before; None at the first"""
    scan: Scan | None
    """de-skewed; all returns"""
    still: Scan | None
    """the same without the returns of what moves"""
    observations: Mapping[LandmarkId, Observation]
    """of landmarks that the log identifies"""
    closures: Sequence[Closure] | None = None
    """measured motions from the poses of earlier keyframes; None of a log without any"""


@dataclass(frozen=True, slots=True)
class Keyframe:
    """What one keyframe contributed."""

    index: int
    """its row in the trajectory"""
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
    loop_closures: LoopClosureCounts | None = None
    """what the search for old places has come to so far; None for a front end that does not search"""


class LoopClosureCounts(NamedTuple):
    """What the search for old places has come to."""

    found: int
    """loop closures that stand"""
    refused: int
    """places that looked right, and were refused, since another looked as good"""
    undone: int
    """loop closures taken back, since later scans contradicted them"""


class PoseLinks(NamedTuple):
    """Measured relative poses of keyframes."""

    ends: NDArray[np.int64]
    """(m, 2) keyframes at which each begins and ends"""
    motions: Array
    """(m, 3) pose of the second keyframe in the frame of the first, robot's frames"""
    covs: Array
    """(m, 3, 3) of their errors, axes of the second frame"""


class Finished(NamedTuple):
    """What a front end knows after the last tick."""

    estimate: Estimate
    """at the last tick"""
    since_key: Array | None = None
    """(S, 3) motion from the last keyframe to each scan, if that is known better now than when the scan was taken"""
    links: PoseLinks | None = None
    """between keyframes, as the estimator has them; None for a front end that makes none"""
    loop_closures: LoopClosureCounts | None = None
    """what the search for old places has come to; None: no more than at the last keyframe"""


class FrontEndSetup(NamedTuple):
    """What a front end is made with."""

    config: Config
    estimator: Estimator
    """what it measures for; one with links is a `Smoother`"""
    start: Pose
    """`T_world_robot`"""
    associator: Associator
    """which observation is of which landmark"""
    motion: Motion
    """where the increments come from"""
    clock: Clock = untimed
    """times its stages"""


class FrontEnd(Protocol):
    """Makes measurements for the estimator of each tick's motion and scan.

    It is made with a `FrontEndSetup`, and with an object of its `Options`, if it has any.

    1. `take` is called once for each tick, in their order; the first has no increment, and not every one has a scan.
    2. A tick becomes a keyframe by one `predict` of the estimator with the motion since the last one, or in pieces, and
       one `update`, perhaps with no observation. Its `index` counts from 0: the row of the estimator's `trajectory`.
    3. Between keyframes the estimator is not predicted. Links that it is given are of keyframes.
    4. `pose` is that of the last keyframe's estimate and `since`, the motion since then, whose covariance (3, 3), axes
       of the pose, is symmetric and positive semi-definite.
    5. A return is evidence once: in an observation or in links. Their covariances are as large as their errors are.
    6. `finish` predicts the estimator up to the last tick, and returns its estimate there.
    7. The same ticks give the same bits, and arrays of the evidence stay as they are.
    """

    @property
    def pose(self) -> Pose:
        """`T_world_robot` at the last tick."""

    @property
    def since(self) -> Odometry:
        """Motion since the last keyframe, and (3, 3) of its error, axes of `pose`."""

    def take(self, evidence: Evidence) -> Keyframe | None:
        """Process what a tick has brought; its keyframe, if it is one."""

    def finish(self) -> Finished:
        """Predict up to the last tick."""


def is_due(motion: Pose, odometry: Odometry, limits: KeyframeConfig) -> bool:
    """Whether a scan after this `motion` since the last keyframe is far enough to be one; `odometry` since then."""
    is_far = math.hypot(motion.x, motion.y) >= limits.distance_m or abs(motion.theta) >= limits.turn_rad
    return is_far and not odometry.is_standstill()

"""What `Slam` returns: of each tick, and at the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.sensor import Sensor
from sixthsense.core.source import seconds
from sixthsense.core.wheels import Wheels
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.front_end import Keyframe, LoopClosureCounts, PoseLinks
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.moving import NOTHING_MOVES, Moving


@dataclass(frozen=True, slots=True)
class Step:
    """What `Slam.take` made of a tick."""

    stamp_ns: int
    """of the tick"""
    pose: Pose
    """`T_world_robot`: the last estimate, and the odometry since"""
    dead_reckoned: Pose
    """`T_world_robot` by odometry alone"""
    increment: Odometry | None
    """motion since the last tick; None at the first"""
    since: Odometry
    """motion since the last keyframe; without odometry its covariance is that of the guess from the last velocity"""
    scan: Scan | None
    """de-skewed"""
    keyframe: Keyframe | None
    """None where the tick brought no keyframe"""
    grid: Grid
    """the map as it is now; the next keyframe changes it"""
    moving: Moving = NOTHING_MOVES
    """returns of what moves; none where people are not expected"""

    def __repr__(self) -> str:
        x, y, theta = self.pose.x, self.pose.y, self.pose.theta
        what = "keyframe" if self.keyframe is not None else "scan" if self.scan is not None else "odometry"
        return f"<Step at {seconds(self.stamp_ns):.3f} s, {what}: x {x:.3f} m, y {y:.3f} m, theta {theta:.4f} rad>"


@dataclass(frozen=True, slots=True)
class SlamResult:
    """What is known after the last tick."""

    estimate: Estimate
    """at the last tick"""
    joint_cov: Array
    """(3 + 2n, 3 + 2n) of pose and landmarks, world frame"""
    trajectory: Array
    """(K, 3) final pose at each keyframe"""
    landmark_records: Mapping[LandmarkId, Record]
    """observations, kind and extent of each landmark of the estimate"""
    culled: int
    """landmarks removed"""
    walls_merged: int
    """walls merged into duplicates that were observed more often"""
    since_key: Array | None = None
    """(S, 3) motion from the last keyframe to each scan, if it is known better now than when the scan was taken"""
    loop_closures: LoopClosureCounts | None = None
    """of a front end that searches for old places"""
    wheels: ParameterEstimate[Wheels] | None = None
    """the wheels' parameters, if they are estimated"""
    links: PoseLinks | None = None
    """between keyframes, as the estimator has them, of a front end that makes them"""
    sensor: ParameterEstimate[Sensor] | None = None
    """the parameters of the sensor of points, if they are estimated"""

"""Joining scans and odometry, each with stamps of its own: ticks in order, also where one comes without the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, compose
from sixthsense.core.source import Tick
from sixthsense.logs.stamps import passed_s

Stamps = NDArray[np.int64]

GAP_S = 0.5
"""No pose is interpolated in a longer gap of odometry."""
JOLT_M, JOLT_RAD = 0.5, 0.5
"""by which odometry may move at any moment, beside what the robot's speed allows"""
_FASTEST, _FASTEST_RAD = 5.0, 5.0  # m/s and rad/s of a robot on wheels in a building


class Sighting(NamedTuple):
    """A scan with its stamps."""

    stamp_ns: int
    """of its last beam"""
    scan: Scan
    own_s: float
    """stamp that relations refer to: of its header, seconds"""


@dataclass(frozen=True, slots=True)
class Odometry:
    """Poses by the wheels, in order."""

    stamps_ns: Stamps
    """(M,) ascending"""
    poses: Array
    """(M, 3) `T_odom_robot`"""

    def later(self, offset_s: float) -> Odometry:
        """The same poses at stamps that are so much later, s."""
        return replace(self, stamps_ns=self.stamps_ns + round(1e9 * offset_s))

    @property
    def usual_s(self) -> float:
        """Usual time between two poses, s; 0 where no stamp tells any."""
        usual_s = float(np.median(passed_s(self.stamps_ns))) if len(self.poses) > 1 else 0.0
        return usual_s if np.isfinite(usual_s) else 0.0

    def jumps(self) -> NDArray[np.int64]:
        """Rows of the poses that no robot on wheels reaches from the one before in the time that has passed.

        Its driver was started again, or the poses are of a map that was corrected. Where stamps tell no time, no motion
        is a jump.
        """
        passed, steps = passed_s(self.stamps_ns), np.diff(self.poses, axis=0)
        moved_m, turned = np.hypot(steps[:, 0], steps[:, 1]), np.abs(wrap_angle(steps[:, 2]))
        passed[1:] += np.where(steps[:-1].any(axis=1), 0.0, passed[:-1])  # a record may repeat an old pose, late
        is_jump = (moved_m > _FASTEST * passed + JOLT_M) | (turned > _FASTEST_RAD * passed + JOLT_RAD)
        return np.asarray(np.flatnonzero(is_jump) + 1)

    def continued(self) -> Odometry:
        """The odometry that goes on from where it was after each jump: scans tell what the robot did meanwhile."""
        poses = self.poses
        for row in self.jumps().tolist():
            T_before, T_after = (Pose.from_array(poses[k]) for k in (row - 1, row))
            back = (T_before @ T_after.inverse()).array()
            poses = np.concatenate([poses[:row], compose(np.broadcast_to(back, poses[row:].shape), poses[row:])])
        return replace(self, poses=poses)


def pose_at(odometry: Odometry, at_ns: Stamps, longest_s: float = GAP_S) -> Array:
    """(K, 3) `T_odom_robot` at stamps (K,), interpolated as a share of the motion between two poses; NaN where unknown.

    It is unknown a usual period before the first pose and after the last, and in a gap that is longer than `longest_s`,
    unless the robot has stood in it.
    """
    stamps, poses = odometry.stamps_ns, odometry.poses
    usual_ns = 1e9 * odometry.usual_s
    row = np.clip(np.searchsorted(stamps, at_ns, side="right") - 1, 0, max(len(stamps) - 2, 0))
    after = np.minimum(row + 1, len(stamps) - 1)
    gap_ns = np.maximum(stamps[after] - stamps[row], 1)
    share = np.clip((at_ns - stamps[row]) / gap_ns, 0.0, 1.0)
    motion = between(poses[row], poses[after])
    out = np.where((share == 1.0)[:, None], poses[after], compose(poses[row], share[:, None] * motion))
    out[share == 0.0] = poses[row[share == 0.0]]
    is_far = (gap_ns > 1e9 * longest_s) & motion.any(axis=1) & (share > 0.0) & (share < 1.0)
    out[is_far | (stamps[0] - at_ns > usual_ns) | (at_ns - stamps[-1] > usual_ns)] = np.nan
    return np.asarray(out)


def joined(sightings: Sequence[Sighting], odometry: Odometry | None) -> list[Tick]:
    """One tick per scan and per pose, and one for both with the same stamp; at least 1 ns apart, none before 0.

    The odometry of a scan is interpolated at its stamp. Scans before and after all odometry, and in a gap of it, keep
    the pose of the tick before, and odometry after them goes on from there; so it does after a jump. Without odometry
    the robot stands at the first scan.
    """
    seen_ns = np.array([each.stamp_ns for each in sightings], dtype=np.int64)
    if odometry is None:
        odometry = Odometry(seen_ns, np.zeros((len(seen_ns), 3)))
    odometry = odometry.continued()
    at_scans = pose_at(odometry, seen_ns, max(GAP_S, 3.0 * odometry.usual_s))
    rows = np.searchsorted(odometry.stamps_ns, seen_ns, side="right") - 1
    is_new = np.diff(seen_ns, prepend=seen_ns[0] - 1) != 0  # of scans with one stamp the first has the tick of the pose
    same = (rows >= 0) & (odometry.stamps_ns[rows] == seen_ns) & is_new
    of_scan = np.full(len(odometry.stamps_ns), -1)
    of_scan[rows[same]] = np.flatnonzero(same)
    entries = [
        (ns, 0, pose, k)
        for ns, pose, k in zip(odometry.stamps_ns.tolist(), odometry.poses, of_scan.tolist(), strict=True)
    ]
    entries += [(int(seen_ns[k]), 1, at_scans[k], k) for k in np.flatnonzero(~same).tolist()]
    entries.sort(key=lambda entry: entry[:2])
    first_ns = min(entries[0][0], 0)
    ticks: list[Tick] = []
    T_held, is_alone = Pose(), False
    for ns, _, row, k in entries:
        is_known, held = bool(np.isfinite(row[0])), ticks[-1].odometry if ticks else Pose.from_array(odometry.poses[0])
        T_odom_robot = Pose.from_array(row) if is_known else held
        if is_known and is_alone:
            T_held = held @ T_odom_robot.inverse()
        pose = (T_odom_robot if T_held == Pose() else T_held @ T_odom_robot) if is_known else held
        at_ns = max(ns - first_ns, ticks[-1].stamp_ns + 1) if ticks else ns - first_ns
        scan, own_s = (sightings[k].scan, sightings[k].own_s) if k >= 0 else (None, None)
        ticks.append(Tick(at_ns, pose, scan, log_stamp_s=own_s, is_unmeasured=not is_known or is_alone))
        is_alone = not is_known
    return ticks

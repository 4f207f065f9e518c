"""The final pass: scans between key scans are aligned once more, with the key scans where they are at the end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry
from sixthsense.slam.scans.mount import Mount
from sixthsense.slam.scans.odometry_prior import prior_of, with_wheel_errors
from sixthsense.slam.scans.poses import between, compose
from sixthsense.slam.scans.scan_store import ScanStore
from sixthsense.slam.scans.tracking import refine

_REACH_M, _REACH_RAD = 1.5, 1.0  # to key scans that a scan is aligned with
_MOST = 3


class TrackedScan(NamedTuple):
    """A scan and its place among the key scans."""

    scan: Scan | None
    """None for a key scan"""
    key: int
    """the last key scan, which may be the scan itself"""
    odometry: Odometry
    """of the robot since then"""
    motion: Pose
    """of the robot since then, as tracked"""


def refined(store: ScanStore, poses: Array, scans: list[TrackedScan], mount: Mount) -> Array:
    """(S, 3) motion of the robot from the last key scan to each scan; `poses` (K, 3) of key scans, `T_world_laser`."""
    motions = np.array([scan.motion.array() for scan in scans]).reshape(-1, 3)
    if not len(poses):
        return motions
    tree = cKDTree(poses[:, :2])
    for k, scan in enumerate(scans):
        if scan.scan is None:
            continue
        start = compose(poses[scan.key], mount.laser_motion(scan.motion).array())
        near = np.array(sorted(tree.query_ball_point(start[:2], _REACH_M)), dtype=np.int64)
        near = near[np.abs(wrap_angle(poses[near, 2] - start[2])) < _REACH_RAD]
        if len(near) < 2:
            continue
        references = near[np.argsort(np.abs(near - scan.key), kind="stable")[:_MOST]]
        by_wheels = prior_of(poses[scan.key], mount.laser_odometry(with_wheel_errors(scan.odometry)))
        tracked = refine(store.returns, store.put(scan.scan), references, poses, by_wheels._replace(pose=start))
        motion = Pose.from_array(between(poses[scan.key], tracked.pose))
        motions[k] = mount.robot_motion(motion).array()
    return motions

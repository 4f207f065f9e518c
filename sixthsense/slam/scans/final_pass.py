"""The final pass: scans between keyframes are aligned once more, with the keyframes where they are at the end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry
from sixthsense.core.se2 import between, compose
from sixthsense.slam.motion_source import with_wheel_errors
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.graph import REACH_M, REACH_RAD
from sixthsense.slam.scans.mount import Mount
from sixthsense.slam.scans.odometry_prior import informations_in_world
from sixthsense.slam.scans.scan_store import ScanStore
from sixthsense.slam.scans.tracking import NEAREST, SLIP_SIGMAS, refine


class TrackedScan(NamedTuple):
    """A scan and its place among the keyframes."""

    scan: Scan | None
    """None for a keyframe"""
    key: int
    """the last keyframe, which may be the scan itself"""
    odometry: Odometry
    """of the robot since then"""
    motion: Pose
    """of the robot since then, as tracked"""


def refined(store: ScanStore, poses: Array, scans: list[TrackedScan], mount: Mount) -> Array:
    """(S, 3) motion of the robot from the last keyframe to each scan; `poses` (K, 3) of keyframes, `T_world_laser`."""
    motions = np.array([scan.motion.array() for scan in scans]).reshape(-1, 3)
    if not len(poses):
        return motions
    rows = np.array([k for k, scan in enumerate(scans) if scan.scan is not None], dtype=np.int64)
    if not len(rows):
        return motions
    keys = np.array([scans[k].key for k in rows])
    found = compose(poses[keys], mount.laser_motions(motions[rows]))
    covs = np.array([mount.laser_odometry(with_wheel_errors(scans[k].odometry)).cov for k in rows])
    informations = informations_in_world(poses[keys], covs)
    around = cKDTree(poses[:, :2]).query_ball_point(found[:, :2], REACH_M, return_sorted=True)
    is_aligned = np.zeros(len(rows), dtype=np.bool_)
    for i, k in enumerate(rows):
        near = np.array(around[i], dtype=np.int64)
        near = near[np.abs(wrap_angle(poses[near, 2] - found[i, 2])) < REACH_RAD]
        scan = scans[k].scan
        if len(near) < 2 or scan is None:
            continue
        references = near[np.argsort(np.abs(near - keys[i]), kind="stable")[:NEAREST]]
        views = Views(store.returns, store.put(scan), references, poses[references])
        tracked = refine(views, Prior(found[i], informations[i], SLIP_SIGMAS))
        found[i], is_aligned[i] = tracked.pose, True
    rows, keys, found = rows[is_aligned], keys[is_aligned], found[is_aligned]
    motions[rows] = mount.robot_motions(between(poses[keys], found))
    return motions

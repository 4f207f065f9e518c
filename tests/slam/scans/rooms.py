"""Rooms and scans of them, for tests of scan matching."""

import numpy as np

from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Tick
from sixthsense.slam.scans.returns import ScanStore

ROOM = np.array([[[-4, -3], [4, -3]], [[4, -3], [4, 3]], [[4, 3], [-4, 3]], [[-4, 3], [-4, -3]],
                 [[1, 0], [1, 1.5]], [[-2, -3], [-2, -1]]], dtype=float)  # fmt: skip
CORRIDOR = np.array([[[-60, -1], [60, -1]], [[60, 1], [-60, 1]]], dtype=float)
# A ring of corridors, 2 m wide, around a block of 16 m by 10 m, with niches that make its places different.
RING = np.array(
    [[[-10, -7], [10, -7]], [[10, -7], [10, 7]], [[10, 7], [-10, 7]], [[-10, 7], [-10, -7]],
     [[-8, -5], [8, -5]], [[8, -5], [8, 5]], [[8, 5], [-8, 5]], [[-8, 5], [-8, -5]],
     [[-3, -7], [-3, -6.6]], [[-3, -6.6], [-1.5, -6.6]], [[-1.5, -6.6], [-1.5, -7]], [[4, -5], [4, -5.4]],
     [[4, -5.4], [5, -5.4]], [[5, -5.4], [5, -5]], [[10, -2], [9.5, -2]], [[9.5, -2], [9.5, -1]],
     [[9.5, -1], [10, -1]], [[8, 2], [8.4, 2.6]], [[8.4, 2.6], [8, 3.1]], [[6, 7], [6.5, 6.5]],
     [[6.5, 6.5], [7.5, 7]], [[1, 5], [1.3, 5.5]], [[1.3, 5.5], [2.2, 5]], [[-5, 7], [-5, 6.4]],
     [[-5, 6.4], [-6, 6.4]], [[-6, 6.4], [-6, 7]], [[-10, 3], [-9.4, 2.5]], [[-9.4, 2.5], [-10, 1.5]],
     [[-8, -2], [-8.5, -1.5]], [[-8.5, -1.5], [-8, -0.5]]], dtype=float)  # fmt: skip
CORNERS = [(9.0, -6.0), (9.0, 6.0), (-9.0, 6.0), (-9.0, -6.0)]
ROUND = LaserConfig()
HALF = LaserConfig(beams=181, fov=np.pi, max_range=30.0)


def scan_at(pose, walls=ROOM, laser=ROUND, sigma=0.01, rng=None):
    """A scan from `T_world_laser`."""
    ranges = cast_rays(pose, beam_bearings(laser), walls, laser.max_range)
    noise = 0.0 if rng is None else sigma * rng.standard_normal(len(ranges))
    return Scan.from_config(ranges + noise, laser)


def stored(*scans):
    """A store that keeps these scans."""
    store = ScanStore(30.0)
    for scan in scans:
        store.put(scan)
        store.keep()
    return store


def drive(start, corners, step=0.12, turn=0.12) -> list[Pose]:
    """Poses along straight lines between corners, turning on the spot."""
    poses = [start]
    for corner in corners:
        to = np.array(corner) - poses[-1].position
        off = wrap_angle(float(np.arctan2(to[1], to[0]) - poses[-1].theta))
        n = max(1, round(abs(off) / turn))
        for _ in range(n):
            poses.append(poses[-1] @ Pose(theta=off / n))
        n = max(1, round(float(np.hypot(*to)) / step))
        for _ in range(n):
            poses.append(poses[-1] @ Pose(x=float(np.hypot(*to)) / n))
    return poses


def ticks(poses, walls, seed=0, scale=1.0, drift=0.0, mount=None, laser=None):
    """Ticks of a drive whose wheels are wrong by a scale and by a drift in rad per m."""
    rng, odometry, config = np.random.default_rng(seed), poses[0], laser or preset().laser
    config = config if mount is None else config.replaced(mount=tuple(mount.array()))
    for k, pose in enumerate(poses):
        if k:
            step = poses[k - 1].inverse() @ pose
            wrong = Pose(scale * step.x, step.y, step.theta + drift * step.x)
            odometry = odometry @ wrong @ Pose(*(1e-3 * rng.standard_normal(3)))
        scan = scan_at(pose if mount is None else pose @ mount, walls, config, rng=rng)
        yield Tick(100_000_000 * k, odometry, scan, log_stamp_s=0.1 * k)

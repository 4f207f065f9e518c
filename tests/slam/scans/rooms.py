"""Rooms and scans of them, for tests of aligned scans."""

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.core.laser import Scan, beam_bearings, cast_rays
from sixthsense.slam.scans.scan_store import ScanStore

ROOM = np.array([[[-4, -3], [4, -3]], [[4, -3], [4, 3]], [[4, 3], [-4, 3]], [[-4, 3], [-4, -3]],
                 [[1, 0], [1, 1.5]], [[-2, -3], [-2, -1]]], dtype=float)  # fmt: skip
CORRIDOR = np.array([[[-60, -1], [60, -1]], [[60, 1], [-60, 1]]], dtype=float)
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

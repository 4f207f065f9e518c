"""From a scan to walls and landmarks: partition, split, fit lines, find landmarks (report section 4.2, figure 2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.config import AssumedConfig, FeaturesConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.laser import Scan
from sixthsense.core.motion import variance
from sixthsense.core.se2 import Triple, wrapped
from sixthsense.slam.features.deskew import add_sweep_noise
from sixthsense.slam.features.endpoints import EndpointRules, RolledScan
from sixthsense.slam.features.landmarks import find_points, find_walls
from sixthsense.slam.features.line_fit import LaserSigmas
from sixthsense.slam.features.lines import FittedLines, LineRules, fit_lines
from sixthsense.slam.features.partition import Indices, partition, split_pieces

Mask = NDArray[np.bool_]

_MAX_WALL_SIGMA_RAD = 0.1
"""of the direction of a wall that is a landmark: six degrees, up to which its linearization holds"""


@dataclass(frozen=True, slots=True)
class Features:
    """Walls and landmarks of one scan, and the partitions they were found in."""

    walls: Array
    """(W, 2, 2) fitted segments, clipped to their first and last return; robot's frame, metres"""
    observations: tuple[Observation, ...]
    """landmarks with their covariance"""
    pieces: tuple[Indices, ...]
    """beams of each first-level partition"""
    spans: tuple[Indices, ...]
    """beams of each second-level partition"""


NO_FEATURES = Features(np.zeros((0, 2, 2)), (), (), ())
"""where the log itself gives the observations, and where scans are aligned"""
NO_FEATURES.walls.flags.writeable = False


def extract(scan: Scan, assumed: AssumedConfig, config: FeaturesConfig) -> Features:
    """Extract walls and landmarks from a scan; `assumed` is the estimator's noise model."""
    noise, mount = assumed.laser, scan.T_robot_laser
    sigmas = LaserSigmas(
        math.sqrt(variance(noise.distribution, noise.range_m)),
        math.sqrt(variance(noise.distribution, noise.bearing_rad)),
    )
    offset, rolled = _partitioned(scan, sigmas.range_m, config)
    spans, piece_of_span = split_pieces(
        rolled.points, rolled.pieces, rolled.cyclic, config.split.epsilon_m, config.lines.min_points
    )
    limits = config.lines
    rules = LineRules(limits.threshold_m, limits.min_points, limits.min_length_m, limits.cut_false_alarm)
    lines, where, owner = fit_lines(rolled.points, spans, rules, sigmas)
    fitted = FittedLines(lines, np.ascontiguousarray(where[:, 1:]), piece_of_span[where[:, 0]], owner)
    has_ends, ends = config.landmarks != "walls", config.points
    of_ends = EndpointRules(has_ends, ends.max_gap_m, scan.max_range, ends.min_points, limits.threshold_m)
    observations: list[Observation] = []
    if config.landmarks == "corners":
        kinds, found = find_points(rolled, fitted, of_ends, sigmas)
    else:
        walls, found = find_walls(rolled, fitted, of_ends, sigmas)
        kinds = np.full(len(found), Kind.END)
        observations = _wall_observations(walls, mount, assumed)
    observations += _point_observations(kinds, found, mount, assumed, config)
    beams = np.roll(np.arange(len(scan.ranges)), -offset)
    return Features(
        mount @ _clip(rolled.points, fitted),
        add_sweep_noise(observations, scan),
        tuple(beams[a:b] for a, b in rolled.pieces.tolist()),
        tuple(beams[a:b] for a, b in spans.tolist()),
    )


def _partitioned(scan: Scan, sigma_range: float, config: FeaturesConfig) -> tuple[int, RolledScan]:
    """The scan with its first-level partitions, rolled so that none straddles its seam, and its first beam."""
    ranges, bearings = scan.ranges.astype(np.float64), scan.bearings
    spacing = float(scan.angle_increment)
    gaps = np.diff(bearings, prepend=bearings[-1] - 2.0 * math.pi)
    jumps = config.partition
    incidence = jumps.incidence_rad if jumps.method == "adaptive" else 0.0
    offset, pieces, cyclic = partition(ranges, gaps, spacing, scan.closed, jumps.epsilon_m, incidence, sigma_range)
    ranges, bearings = np.roll(ranges, -offset), np.concatenate([bearings[offset:], bearings[:offset] + 2.0 * math.pi])
    points = np.where(np.isfinite(ranges)[:, None], np.roll(scan.points_laser, -offset, axis=0), 0.0)
    return offset, RolledScan(points, ranges, bearings, pieces, scan.closed, cyclic)


class LineExtractor:
    """Walls, corners and free ends by lines that are fitted to the scan."""

    Options = FeaturesConfig

    def __init__(self, assumed: AssumedConfig, options: FeaturesConfig) -> None:
        self._assumed, self._options = assumed, options

    def extract(self, scan: Scan) -> Features:
        """Extract walls and landmarks from a scan."""
        return extract(scan, self._assumed, self._options)


def _point_observations(
    kinds: Indices, found: Array, mount: Pose, assumed: AssumedConfig, config: FeaturesConfig
) -> list[Observation]:
    """Observations in the robot's frame of the points (K, 5) in the laser's frame whose sigma is below the limit."""
    z, cov, is_certain = _points_from(found, mount.triple(), assumed.landmark_floor_m**2, config.points.max_sigma_m**2)
    return [Observation(Kind(int(kinds[k])), z[k], cov[k]) for k in np.flatnonzero(is_certain).tolist()]


@numba.njit(cache=True, error_model="numpy")
def _points_from(found: Array, mount: Triple, floor: float, most: float) -> tuple[Array, Array, Mask]:
    """Places (K, 2) in the robot's frame and their covariances, of points in the laser's frame; which are certain.

    Those whose largest variance is at most `most`, m^2; NaN is not. `floor`, m^2, is added along all directions.
    """
    z, cov, is_certain = np.empty((len(found), 2)), np.empty((len(found), 2, 2)), np.empty(len(found), np.bool_)
    c, s = math.cos(mount[2]), math.sin(mount[2])
    for k in range(len(found)):
        x, y, xx, xy, yy = found[k]
        is_certain[k] = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy) <= most
        z[k, 0], z[k, 1] = mount[0] + c * x - s * y, mount[1] + s * x + c * y
        mixed = c * s * (xx - yy) + (c * c - s * s) * xy
        cov[k, 0, 0], cov[k, 0, 1] = c * c * xx - 2.0 * c * s * xy + s * s * yy + floor, mixed
        cov[k, 1, 0], cov[k, 1, 1] = mixed, s * s * xx + 2.0 * c * s * xy + c * c * yy + floor
    return z, cov, is_certain


def _wall_observations(walls: Array, mount: Pose, assumed: AssumedConfig) -> list[Observation]:
    """Observations in the robot's frame of walls (W, 7) in the laser's frame; their normals point towards the laser."""
    floors = assumed.wall_floor_rad**2, assumed.landmark_floor_m**2
    z, cov, extents = _walls_from(walls, mount.triple(), floors)
    certain = np.flatnonzero(walls[:, 2] <= _MAX_WALL_SIGMA_RAD**2).tolist()
    return [Observation(Kind.WALL, z[k], cov[k], (float(extents[k, 0]), float(extents[k, 1]))) for k in certain]


@numba.njit(cache=True, error_model="numpy")
def _walls_from(walls: Array, mount: Triple, floors: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Lines (W, 2), their covariances (W, 2, 2) and extents (W, 2) in the robot's frame of walls in the laser's frame.

    The floors, rad^2 and m^2, are those of a wall's shape about its middle, whatever the robot's distance: not about
    the foot of its perpendicular.
    """
    z, cov, extents = np.empty((len(walls), 2)), np.empty((len(walls), 2, 2)), np.empty((len(walls), 2))
    for k in range(len(walls)):
        alpha, d, aa, ad, dd, low, high = walls[k, :7]
        middle = 0.5 * (low + high)
        aa += floors[0]
        ad += middle * floors[0]
        dd += middle * middle * floors[0] + floors[1]
        # With its normal towards the laser the wall lies at the distance -d.
        turned = wrapped(alpha + math.pi + mount[2])
        c, s = math.cos(turned), math.sin(turned)
        lever = c * mount[1] - s * mount[0]
        z[k, 0], z[k, 1] = turned, c * mount[0] + s * mount[1] - d
        mixed = lever * aa - ad
        cov[k, 0, 0], cov[k, 0, 1] = aa, mixed
        cov[k, 1, 0], cov[k, 1, 1] = mixed, lever * lever * aa - 2.0 * lever * ad + dd
        extents[k, 0], extents[k, 1] = lever - high, lever - low
    return z, cov, extents


def _clip(points: Array, lines: FittedLines) -> Array:
    """(W, 2, 2) segments: each line's first and last return projected onto it (report section 4.2)."""
    normal = np.column_stack([np.cos(lines.fits[:, 0]), np.sin(lines.fits[:, 0])])
    ends = points[lines.ends]  # (W, 2, 2)
    off = np.einsum("wij,wj->wi", ends, normal) - lines.fits[:, 1:2]
    return np.asarray(ends - off[:, :, None] * normal[:, None, :])

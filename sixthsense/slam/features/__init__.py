"""From a scan to walls and landmarks: partition, split, fit lines, find landmarks (report section 4.2, figure 2)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from sixthsense.config import AssumedConfig, FeaturesConfig
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import Kind, Sighting, born
from sixthsense.core.laser import Scan
from sixthsense.core.motion import variance
from sixthsense.slam.features.landmarks import find_landmarks
from sixthsense.slam.features.lines import fit_lines
from sixthsense.slam.features.partition import Indices, partition
from sixthsense.slam.features.split import split
from sixthsense.slam.features.sweep import with_sweep
from sixthsense.slam.features.walls import find_walls

__all__ = ["Features", "extract"]


@dataclass(frozen=True, slots=True)
class Features:
    """What one scan shows."""

    walls: Array
    """(W, 2, 2) fitted segments, clipped to their first and last return; robot's frame, metres"""
    sightings: tuple[Sighting, ...]
    """landmarks with their covariance"""
    pieces: tuple[Indices, ...]
    """beams of each first-level partition"""
    spans: tuple[Indices, ...]
    """beams of each second-level partition"""


def extract(scan: Scan, assumed: AssumedConfig, config: FeaturesConfig, rng: np.random.Generator) -> Features:
    """Extract walls and landmarks from a scan; `assumed` is the noise believed in, `rng` feeds RANSAC."""
    noise = assumed.laser
    seed = int(rng.integers(1, 2**31 - 2))
    n = len(scan.ranges)
    sigma_range = math.sqrt(variance(noise.distribution, noise.range_m))
    sigma_bearing = math.sqrt(variance(noise.distribution, noise.bearing_rad))
    ranges, bearings = scan.ranges.astype(np.float64), scan.bearings
    spacing = float(scan.angle_increment)
    gaps = None if scan.sweep is None else np.diff(bearings, prepend=bearings[-1] - 2.0 * math.pi)
    offset, pieces, cyclic = partition(ranges, spacing, scan.closed, sigma_range, config.partition, gaps)

    # From here on the scan is rolled so that no piece straddles its seam.
    ranges = np.roll(ranges, -offset)
    if scan.sweep is None:
        bearings = bearings[0] + spacing * (offset + np.arange(n))
    else:
        bearings = np.concatenate([bearings[offset:], bearings[:offset] + 2.0 * math.pi])
    reach = np.where(np.isfinite(ranges), ranges, 0.0)
    points = np.column_stack([reach * np.cos(bearings), reach * np.sin(bearings)])
    spans, piece_of_span = _spans(points, pieces, cyclic, config)
    fitting = config.lines
    lines, where, owner = fit_lines(
        points,
        spans,
        fitting.ransac,
        fitting.ransac_threshold_m,
        fitting.ransac_iterations,
        fitting.least_squares,
        fitting.min_points,
        fitting.min_length_m,
        sigma_range,
        sigma_bearing,
        seed,
    )
    scan_of = (points, ranges, bearings, pieces, piece_of_span[where[:, 0]], lines, where, owner, scan.closed, cyclic)
    rules = config.points
    limits = (scan.max_range, rules.range_margin_m, rules.min_points, fitting.ransac_threshold_m)
    sigmas = (sigma_range, sigma_bearing)
    if config.landmarks == "corners":
        corners = (rules.corners, rules.ends, rules.max_gap_m, rules.min_angle_rad)
        kinds, found = find_landmarks(*scan_of, *corners, *limits, *sigmas)
        sightings: list[Sighting] = []
    else:
        ends = config.landmarks == "both" and rules.ends
        reserved = (config.walls.min_length_m, config.walls.end_points)
        walls, found = find_walls(*scan_of, ends, rules.max_gap_m, rules.min_angle_rad, *limits, *reserved, *sigmas)
        kinds = np.full(len(found), Kind.END)
        sightings = _wall_sightings(walls, scan.T_robot_laser, assumed, config)
    sightings += _point_sightings(kinds, found, scan.T_robot_laser, assumed, config)
    mount = scan.T_robot_laser
    return Features(
        mount @ _clip(points, lines, where),
        with_sweep(sightings, scan),
        tuple((offset + np.arange(a, b)) % n for a, b in pieces),
        tuple((offset + np.arange(a, b)) % n for a, b in spans),
    )


def _point_sightings(
    kinds: Indices, found: Array, mount: Pose, assumed: AssumedConfig, config: FeaturesConfig
) -> list[Sighting]:
    """Sightings, in the robot's frame, of points (K, 5) in the laser's, without those that are known too badly."""
    turn = rotation(mount.theta)
    sightings = []
    for kind, (x, y, xx, xy, yy) in zip(kinds, found, strict=True):
        # The larger eigenvalue of the covariance, in closed form; NaN fails the comparison.
        worst = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
        if worst <= config.points.max_sigma_m**2:
            cov = turn @ np.array([[xx, xy], [xy, yy]]) @ turn.T + assumed.landmark_floor_m**2 * np.eye(2)
            sightings.append(Sighting(Kind(int(kind)), mount @ np.array([x, y]), cov))
    return sightings


def _wall_sightings(walls: Array, mount: Pose, assumed: AssumedConfig, config: FeaturesConfig) -> list[Sighting]:
    """Sightings, in the robot's frame, of walls (W, 7) in the laser's; their normals turned towards the laser."""
    sightings = []
    for alpha, d, aa, ad, dd, low, high in walls.tolist():
        if not aa <= config.walls.max_sigma_rad**2:
            continue
        # A line turns about the middle of its returns, so an error of its angle lengthens d by d/2 times its square.
        # The mean of that is taken out, its variance added.
        dd += 0.5 * (d * aa) ** 2
        d -= 0.5 * d * aa
        # Seen from the laser the wall is at -d along the normal that points to the laser.
        in_laser = Sighting(Kind.WALL, np.array([alpha + math.pi, -d]), np.array([[aa, -ad], [-ad, dd]]))
        z, _, by_z = born(mount, in_laser)
        middle = 0.5 * (low + high)
        # A wall is as crooked as its ends are off, whatever the robot's distance: about its middle, not its foot.
        bent = np.array([[1.0, 0.0], [middle, 1.0]])
        floor = bent @ np.diag([assumed.wall_floor_rad**2, assumed.landmark_floor_m**2]) @ bent.T
        cov = by_z @ (in_laser.cov + floor) @ by_z.T
        foot = -math.sin(z[0]) * mount.x + math.cos(z[0]) * mount.y
        sightings.append(Sighting(Kind.WALL, z, cov, (foot - high, foot - low)))
    return sightings


def _spans(points: Array, pieces: Indices, cyclic: bool, config: FeaturesConfig) -> tuple[Indices, Indices]:
    """Second-level partitions (S, 2), first and past-last return, and (S,) the piece that each is part of.

    A return at which a piece was split may lie on either wall, so it is in neither.
    """
    spans: list[tuple[int, int]] = []
    owners: list[int] = []
    for p, (first, past) in enumerate(pieces):
        if past - first < config.lines.min_points:
            continue
        ends = split(points, first, past - 1, config.split.epsilon_m) if config.split.enabled else (first, past - 1)
        for a, b in itertools.pairwise(ends):
            begin = a if a == first and not cyclic else a + 1
            end = b + 1 if b == past - 1 and not cyclic else b
            spans.append((int(begin), int(end)))
            owners.append(p)
    return np.array(spans, dtype=np.int64).reshape(-1, 2), np.array(owners, dtype=np.int64)


def _clip(points: Array, lines: Array, where: Indices) -> Array:
    """(W, 2, 2) segments: each line's first and last return projected onto it (report section 4.2)."""
    normal = np.column_stack([np.cos(lines[:, 0]), np.sin(lines[:, 0])])
    ends = points[where[:, 1:]]  # (W, 2, 2)
    off = np.einsum("wij,wj->wi", ends, normal) - lines[:, 1:2]
    return np.asarray(ends - off[:, :, None] * normal[:, None, :])

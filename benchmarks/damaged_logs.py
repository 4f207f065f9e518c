"""Logs damaged as buildings, wheels and lasers do, with their relations.

No damage moves the laser. The relations stay true, up to mirroring and the direction of time. Only ticks with a scan
are kept, in `clean` too, which the others are to be compared with. Scans are taken to be instantaneous.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import zlib
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick
from sixthsense.logs.log import Log, Relations, matched

Ticks = Sequence[Tick]

_MARGIN = 60  # scans at either end that stay as they are
_MOVING_M, _M_PER_RAD = 0.02, 0.3  # motion between two scans, a turn counted as the way of a wheel
_GAPS, _GAP_S, _GAPS_APART, _TURNING_OVER = 8, (2.0, 4.0), 200, 9  # the last two in scans
_BLANKS, _BLANK_SCANS = 20, 3
_BUMPS, _BUMP_RAD = 6, (0.2, 0.5)
_SPINS, _SPIN_M, _SPIN_SCANS = 6, (0.3, 0.8), 5
_WRONG_SCALE, _DRIFT_RAD_PER_M = 0.05, 0.04
_PEOPLE_SCANS, _MOST_PEOPLE, _PEOPLE_M, _NEAREST_M = 100, 4, (0.5, 4.0), 0.4
_PACE_M, _LEG_APART_M, _LEG_M, _LEG_SIGMA_M = 0.02, 0.15, 0.08, 0.02  # pace per scan; half the distance and the width
_ROUGH_M, _ROUGH_SHARE, _LEAST_M = 0.03, 0.1, 0.05


def damaged(name: str, log: Log, relations: Relations, seed: int) -> tuple[Log, Relations]:
    """The damage `name` of `DAMAGES` done to a log, with the relations that hold in it and have their scans."""
    ticks = [tick for tick in log.ticks if tick.scan is not None]
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    laser, stamps, poses = log.laser, relations.stamps, relations.poses
    if name == "mirrored":
        poses = np.column_stack([poses[:, 0], -poses[:, 1], wrap_angle(-poses[:, 2])])
        if laser is not None:
            x, y, theta = laser.mount
            laser = laser.replaced(mount=(x, -y, -theta))
    if name == "backwards":
        stamps = sum(_ends_s(ticks)) - stamps
    changed = Log(DAMAGES[name](ticks, rng), laser)
    known = (matched(_stamps_s(changed.ticks), stamps) >= 0).all(axis=1)
    return changed, Relations(stamps[known], poses[known])


def clean(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """As they are."""
    return ticks


def gaps(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """Eight times no data for 2 to 4 s, where the robot turns most."""
    turning = np.convolve(np.abs(steps_of(ticks)[:, 2]), np.ones(_TURNING_OVER), "same")
    stamps_s = 1e-9 * np.array([tick.stamp_ns for tick in ticks])
    kept, done = np.ones(len(ticks), dtype=np.bool_), 0
    for at in np.argsort(-turning):
        until = int(np.searchsorted(stamps_s, stamps_s[at] + rng.uniform(*_GAP_S)))
        is_inside = _MARGIN < at < until < len(ticks) - _MARGIN
        if is_inside and kept[max(at - _GAPS_APART, 0) : until + _GAPS_APART].all():
            kept[at:until] = False
            done += 1
        if done == _GAPS:
            break
    return [tick for tick, stays in zip(ticks, kept, strict=True) if stays]


def blanks(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """Twenty times one to three scans without a return."""
    ranges = _ranges(ticks)
    for at in _moving(ticks, rng, _BLANKS):
        ranges[at : at + rng.integers(1, _BLANK_SCANS + 1)] = math.inf
    return _with_ranges(ticks, ranges)


def bumps(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """Six times the wheels miss a turn of 0.2 to 0.5 rad, or report one that was not driven."""
    steps = steps_of(ticks)
    for at in _moving(ticks, rng, _BUMPS):
        steps[at, 2] += rng.choice((-1.0, 1.0)) * rng.uniform(*_BUMP_RAD)
    return with_steps(ticks, steps)


def spins(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """Six times the wheels spin: 0.3 to 0.8 m forward that were not driven, over five scans."""
    steps = steps_of(ticks)
    for at in _moving(ticks, rng, _SPINS):
        steps[at : at + _SPIN_SCANS, 0] += rng.uniform(*_SPIN_M) / _SPIN_SCANS
    return with_steps(ticks, steps)


def wheels(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """Wheels with an error to one side: 5 % forward, 5 % in turns, and a drift of 0.04 rad/m."""
    steps, side = steps_of(ticks), rng.choice((-1.0, 1.0), 3)
    steps[:, 2] = steps[:, 2] * (1.0 + _WRONG_SCALE * side[1]) + _DRIFT_RAD_PER_M * side[2] * steps[:, 0]
    steps[:, :2] *= 1.0 + _WRONG_SCALE * side[0]
    return with_steps(ticks, steps)


def people(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """Half of the time one to four walkers, 0.5 to 4 m away, pass through the view: two legs each."""
    ranges, scan = _ranges(ticks), _scans(ticks)[0]
    bearings, spacing = scan.bearings, float(scan.angle_increment)
    view, sides = spacing * len(bearings), np.array([-_LEG_APART_M, _LEG_APART_M])
    for begin in range(0, len(ticks), _PEOPLE_SCANS):
        if rng.random() < 0.5:
            continue
        own = ranges[begin : begin + _PEOPLE_SCANS]
        passed = np.arange(len(own))[:, None]
        for _ in range(rng.integers(1, _MOST_PEOPLE + 1)):
            at, turn = bearings[0] + rng.uniform(0.0, view), rng.uniform(-1.0, 1.0) * view / _PEOPLE_SCANS
            near, pace = rng.uniform(*_PEOPLE_M), rng.uniform(-_PACE_M, _PACE_M)
            far = np.maximum(_NEAREST_M, near + pace * passed)
            middles, halves = at + turn * passed + sides / far, _LEG_M / far + spacing / 2.0  # a beam has a width
            is_hit = np.abs(bearings - middles[:, :, None]) <= halves[:, :, None]  # (passed, 2, beams)
            legs = np.where(is_hit, far[:, :, None], math.inf)
            legs[is_hit] += rng.normal(0.0, _LEG_SIGMA_M, np.count_nonzero(is_hit))
            np.minimum(own, legs.min(axis=1), out=own)
    return _with_ranges(ticks, ranges)


def rough(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """A worse laser: 3 cm of noise, and a tenth of the beams without a return."""
    ranges = _ranges(ticks)
    ranges = np.maximum(ranges + rng.normal(0.0, _ROUGH_M, ranges.shape), _LEAST_M)
    ranges[rng.random(ranges.shape) < _ROUGH_SHARE] = math.inf
    return _with_ranges(ticks, ranges)


def mirrored(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """Left and right exchanged."""
    found = []
    for tick, scan in zip(ticks, _scans(ticks), strict=True):
        turned = dataclasses.replace(
            scan,
            ranges=scan.ranges[::-1],
            angle_min=np.float32(-scan.bearings[-1]),
            T_robot_laser=_mirror(scan.T_robot_laser),
        )
        truth = None if tick.truth is None else _mirror(tick.truth)
        found.append(dataclasses.replace(tick, odometry=_mirror(tick.odometry), scan=turned, truth=truth))
    return found


def backwards(ticks: Ticks, rng: np.random.Generator) -> Ticks:
    """Time reversed: the robot drives backwards."""
    ends_ns, ends_s = ticks[0].stamp_ns + ticks[-1].stamp_ns, sum(_ends_s(ticks))
    found = []
    for tick in reversed(ticks):
        own_s = None if tick.log_stamp_s is None else ends_s - tick.log_stamp_s
        found.append(dataclasses.replace(tick, stamp_ns=ends_ns - tick.stamp_ns, log_stamp_s=own_s))
    return found


DAMAGES: dict[str, Callable[[Ticks, np.random.Generator], Ticks]] = {
    damage.__name__: damage
    for damage in (clean, gaps, blanks, bumps, spins, wheels, people, rough, mirrored, backwards)
}


def _moving(ticks: Ticks, rng: np.random.Generator, count: int) -> NDArray[np.int64]:
    """At most `count` scans at which the robot moves, one in each part of the log."""
    steps = steps_of(ticks)
    way = np.hypot(steps[:, 0], steps[:, 1]) + _M_PER_RAD * np.abs(steps[:, 2])
    busy = np.flatnonzero(way > _MOVING_M)
    busy = busy[(busy > _MARGIN) & (busy < len(steps) - _MARGIN)]
    return np.array([rng.choice(part) for part in np.array_split(busy, count) if len(part)], dtype=np.int64)


def steps_of(ticks: Ticks) -> Array:
    """(n - 1, 3) motion by odometry between consecutive ticks, m and rad."""
    poses = [tick.odometry for tick in ticks]
    return np.array([(a.inverse() @ b).array() for a, b in itertools.pairwise(poses)])


def with_steps(ticks: Ticks, steps: Array) -> list[Tick]:
    """The ticks with other motions (n - 1, 3) by odometry."""
    odometry, found = ticks[0].odometry, [ticks[0]]
    for tick, step in zip(ticks[1:], steps, strict=True):
        odometry = odometry @ Pose.from_array(step)
        found.append(dataclasses.replace(tick, odometry=odometry))
    return found


def _scans(ticks: Ticks) -> list[Scan]:
    return [tick.scan for tick in ticks if tick.scan is not None]


def _ranges(ticks: Ticks) -> Array:
    """(n, beams) m, inf for no return."""
    return np.array([scan.ranges for scan in _scans(ticks)], dtype=np.float64)


def _with_ranges(ticks: Ticks, ranges: Array) -> list[Tick]:
    """The ticks with other ranges (n, beams); at or beyond the laser's maximum means no return."""
    found = []
    for tick, scan, own in zip(ticks, _scans(ticks), ranges.astype(np.float32), strict=True):
        kept = np.where(own < np.float32(scan.max_range), own, np.float32(math.inf))
        found.append(dataclasses.replace(tick, scan=dataclasses.replace(scan, ranges=kept)))
    return found


def _stamps_s(ticks: Ticks) -> Array:
    return np.array([tick.log_stamp_s for tick in ticks if tick.log_stamp_s is not None], dtype=np.float64)


def _ends_s(ticks: Ticks) -> tuple[float, float]:
    stamps = _stamps_s(ticks)
    return (float(stamps[0]), float(stamps[-1])) if len(stamps) else (0.0, 0.0)


def _mirror(pose: Pose) -> Pose:
    return Pose(pose.x, -pose.y, -pose.theta)

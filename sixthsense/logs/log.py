"""Recorded logs: scans and odometry joined to ticks by their stamps, what a reader has found, and relations."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, compose
from sixthsense.core.source import Command, Source, Tick, seconds
from sixthsense.logs.finding import Finding
from sixthsense.logs.laser_geometry import Beams
from sixthsense.logs.text_lines import read_table

Stamps = NDArray[np.int64]

GAP_S = 0.5
"""No pose is interpolated in a longer gap of odometry."""
JOLT_M, JOLT_RAD = 0.5, 0.5
"""by which odometry may move at any moment, beside what the robot's speed allows"""
_FASTEST = 5.0  # m/s and rad/s of a robot on wheels in a building
EXACT_S = 1e-6
"""What a float holds of a stamp in seconds since 1970, and less than any two scans are apart."""


def matched(stamps_s: ArrayLike, wanted_s: ArrayLike) -> NDArray[np.int64]:
    """Row of the stamp that is nearest to each wanted one, of equal ones the first; -1 if none is within half a period.

    `stamps_s` (N,) seconds in any order, `wanted_s` of any shape. The period is the median time between stamps.
    """
    import pandas as pd  # here, since it takes a while to load

    wanted = np.asarray(wanted_s, dtype=np.float64)
    ordered, firsts = np.unique(np.asarray(stamps_s, dtype=np.float64), return_index=True)
    half_s = 0.5 * float(np.median(np.diff(ordered))) if len(ordered) > 1 else 0.0
    rows = pd.Index(ordered).get_indexer(wanted.ravel(), method="nearest", tolerance=max(half_s, EXACT_S))
    return np.asarray(np.append(firsts, -1)[rows].reshape(wanted.shape))


def ascending(stamps_ns: ArrayLike) -> NDArray[np.int64]:
    """Stamps (N,), ns, each at least 1 ns after the previous one, so that records keep the order of the file."""
    count = np.arange(np.size(stamps_ns))
    return np.asarray(np.maximum.accumulate(np.asarray(stamps_ns, dtype=np.int64) - count) + count)


def passed_s(stamps_ns: ArrayLike) -> Array:
    """(N - 1,) seconds from each record to the next as far as their stamps tell; infinite where no stamp tells any.

    Records that share a stamp, to a microsecond, are spread evenly up to the next one: it is rounded, or that of a
    moment when several were written.
    """
    steps_s = seconds(np.diff(np.asarray(stamps_ns, dtype=np.int64)).astype(np.float64))
    ends = np.flatnonzero(steps_s > EXACT_S)
    if not len(ends):
        return np.full(len(steps_s), np.inf)
    counts = np.diff(ends, prepend=-1)
    spread = np.repeat(steps_s[ends] / counts, counts)
    return np.concatenate([spread, np.full(len(steps_s) - len(spread), np.median(spread))])


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
        is_jump = (moved_m > _FASTEST * passed + JOLT_M) | (turned > _FASTEST * passed + JOLT_RAD)
        return np.asarray(np.flatnonzero(is_jump) + 1)


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
    is_far = (seconds(gap_ns.astype(np.float64)) > longest_s) & motion.any(axis=1) & (share > 0.0) & (share < 1.0)
    out[is_far | (stamps[0] - at_ns > usual_ns) | (at_ns - stamps[-1] > usual_ns)] = np.nan
    return np.asarray(out)


def joined(sightings: Sequence[Sighting], odometry: Odometry | None) -> list[Tick]:
    """One tick per scan and per pose, and one for both with the same stamp; at least 1 ns apart, none before 0.

    The odometry of a scan is interpolated at its stamp. Scans before and after all odometry, and in a gap of it, keep
    the pose of the tick before, and odometry after them goes on from there; so it does after a jump. Without odometry
    the robot stands at the first scan.
    """
    seen_ns = np.array([each.stamp_ns for each in sightings], dtype=np.int64)
    unique_ns, firsts = np.unique(seen_ns, return_index=True)
    odometry = odometry or Odometry(unique_ns, np.zeros((len(unique_ns), 3)))
    odometry = replace(odometry, poses=_going_on(odometry.poses, odometry.jumps()))
    at_scans = pose_at(odometry, seen_ns, max(GAP_S, 3.0 * odometry.usual_s))
    rows = np.searchsorted(odometry.stamps_ns, seen_ns, side="right") - 1
    same = (rows >= 0) & (odometry.stamps_ns[rows] == seen_ns)
    same &= np.isin(np.arange(len(seen_ns)), firsts)  # of scans with one stamp the first has the tick of the pose
    of_scan = np.full(len(odometry.stamps_ns), -1)
    of_scan[rows[same]] = np.flatnonzero(same)
    stamps_ns = np.concatenate([odometry.stamps_ns, seen_ns[~same]])
    order = np.argsort(stamps_ns, kind="stable")
    poses = np.concatenate([odometry.poses, at_scans[~same]])[order]
    numbers = np.concatenate([of_scan, np.flatnonzero(~same)])[order]
    is_known = np.isfinite(poses[:, 0])
    is_alone = ~(is_known & np.append(True, is_known[:-1]))
    last = np.maximum.accumulate(np.where(is_known, np.arange(len(poses)), np.argmax(is_known)))
    poses = _going_on(poses[last], np.flatnonzero(is_known & is_alone))
    stamps_ns = ascending(stamps_ns[order] - min(stamps_ns.min(), 0))
    ticks = []
    for ns, pose, k, alone in zip(stamps_ns.tolist(), poses.tolist(), numbers.tolist(), is_alone.tolist(), strict=True):
        scan, own_s = (sightings[k].scan, sightings[k].own_s) if k >= 0 else (None, None)
        ticks.append(Tick(ns, Pose(*pose), scan, log_stamp_s=own_s, is_unmeasured=alone))
    return ticks


def _going_on(poses: Array, rows: NDArray[np.int64]) -> Array:
    """Poses (N, 3) that go on from the row before at each of these rows; scans tell what the robot did meanwhile."""
    for row in rows.tolist():
        before, after = (Pose.from_array(poses[k]) for k in (row - 1, row))
        poses = np.concatenate([poses[:row], compose((before @ after.inverse()).array(), poses[row:])])
    return poses


@dataclass(frozen=True)
class Log:
    """A recorded log: its ticks in the order of the file."""

    ticks: Sequence[Tick]
    """All ticks, at least one, with ascending `stamp_ns`."""
    laser: LaserConfig | None = None
    """The laser as the log describes it; None where it does not."""
    found: Sequence[Finding] = ()
    """What its reader has found."""
    sightings: Sequence[Sighting] = ()
    """The scans with their own stamps, of a log whose scans and odometry were joined."""
    odometry: Odometry | None = None
    """The odometry with its own stamps, of such a log; None without any."""
    candidates: Sequence[Beams] = ()
    """The beams that its scans may have, if nothing states them."""

    @classmethod
    def of(
        cls,
        sightings: Sequence[Sighting],
        odometry: Odometry | None,
        laser: LaserConfig,
        found: Sequence[Finding] = (),
        candidates: Sequence[Beams] = (),
    ) -> Log:
        """Join scans with odometry; `laser` has what scans do not say, `candidates` the beams that they may have."""
        laser = described_laser([each.scan for each in sightings], laser)
        return cls(joined(sightings, odometry), laser, found, sightings, odometry, candidates)

    def anew(self, sightings: Sequence[Sighting], odometry: Odometry | None) -> Log:
        """The log of other scans or odometry; itself if they were not joined."""
        return self if self.laser is None else Log.of(sightings, odometry, self.laser, self.found, self.candidates)

    def later(self, time_offset_s: float) -> Log:
        """The log with its odometry so much later, s; itself for one whose scans and odometry were not joined."""
        if self.odometry is None or not time_offset_s:
            return self
        stamps_ns = self.odometry.stamps_ns + round(1e9 * time_offset_s)
        return self.anew(self.sightings, replace(self.odometry, stamps_ns=stamps_ns))

    @functools.cached_property
    def scans(self) -> tuple[Scan, ...]:
        """All scans, in the order of the ticks."""
        return tuple(tick.scan for tick in self.ticks if tick.scan is not None)

    @property
    def has_odometry(self) -> bool:
        """Whether the log has odometry; without it, its poses say nothing."""
        return self.odometry is not None or not self.sightings

    @property
    def start(self) -> Pose:
        """The first odometry pose, `T_odom_robot`."""
        return self.ticks[0].odometry

    @property
    def duration_s(self) -> float:
        """Record time from the first tick to the last, seconds."""
        return seconds(self.ticks[-1].stamp_ns - self.ticks[0].stamp_ns)


def described_laser(scans: Sequence[Scan], laser: LaserConfig) -> LaserConfig:
    """The configuration of the laser that took scans, centred on the mount: of the beams and range that most have."""
    kinds = Counter((len(s.ranges), float(s.angle_increment), s.max_range) for s in scans)
    (count, step, reach), _ = kinds.most_common(1)[0]
    is_closed = abs(step * count - 2.0 * math.pi) < 0.5 * step
    fov = 2.0 * math.pi if is_closed else min(step * (count - 1), 2.0 * math.pi)
    return laser.replaced(beams=count, fov=fov, max_range=reach, mount=tuple(scans[0].T_robot_laser.array().tolist()))


class Playback:
    """A source of recorded ticks, and then of those of another source, if there is one."""

    def __init__(self, ticks: Iterable[Tick], then: Source | None = None) -> None:
        self._ticks, self._then = iter(ticks), then

    def step(self, command: Command) -> Tick | None:
        """The next tick, None at the end; for a recorded one the command is ignored."""
        tick = next(self._ticks, None)
        return tick if tick is not None or self._then is None else self._then.step(command)


@dataclass(frozen=True, slots=True)
class Relations:
    """Relative poses of a robot at pairs of stamps, checked by hand (Kümmerle et al., Autonomous Robots 2009)."""

    stamps: Array
    """(R, 2) seconds: stamps t1 and t2 of scans in the log"""
    poses: Array
    """(R, 3) metres, radians: pose of the robot at t2 in its frame at t1"""


def read_relations(file: str | Path) -> Relations:
    """Read relations, lines of `t1 t2 dx dy dz roll pitch yaw`; blank lines and lines that begin with # are skipped.

    Seconds, metres, radians; dz, roll and pitch are ignored. Raises InputError for a file that
    cannot be read, a line that is not eight finite numbers, or a file without a relation.
    """
    table = read_table(Path(file), "t1 t2 dx dy dz roll pitch yaw").numbers
    poses = np.stack([table[:, 2], table[:, 3], wrap_angle(table[:, 7])], axis=1)
    return Relations(table[:, :2].copy(), poses)

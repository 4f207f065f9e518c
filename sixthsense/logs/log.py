"""Sources of recorded ticks, what a user should know of them, and hand-checked relations between their scans."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Source, Tick, seconds
from sixthsense.logs.stamps import passed_s, stamp_remarks
from sixthsense.logs.text_lines import read_table

GAP_S = 0.5
"""No pose is interpolated in a longer gap of odometry."""
JOLT_M, JOLT_RAD = 0.5, 0.5
"""by which odometry may move at any moment, beside what the robot's speed allows"""
_FASTEST, _FASTEST_RAD = 5.0, 5.0  # m/s and rad/s of a robot on wheels in a building

_FEWEST, _MOST_TRIPLES = 6, 100  # scans, and triples of successive ones that are compared
_BINS = 36  # of bearings, around a full turn
_LEAST_M = 0.1  # difference of two views, below which noise and the robot's own motion may make it
_RATIO = 0.25
"""Of a scan's difference from the second next one, to that from the next: a laser that moves has at least about 1."""
_SHARE = 0.8  # of the triples
_COMPARED = 20  # scans, evenly over the log
_MOVED_M, _FAR_M, _MOST = 0.3, 100.0, 0.5  # by which a range has changed, m; at most; and the share of beams


class Log:
    """A recorded log: its ticks in the order of the file."""

    ticks: tuple[Tick, ...]
    """All ticks."""
    scans: tuple[Scan, ...]
    """All scans, in the order of the ticks."""
    laser: LaserConfig | None
    """The laser as the log describes it; None where it does not."""
    backward_stamps: int
    """Number of scans whose stamp in the log is earlier than that of the previous scan."""
    has_odometry: bool
    """Whether the log has odometry; without it, its poses say nothing."""

    def __init__(
        self,
        ticks: Sequence[Tick],
        laser: LaserConfig | None = None,
        remarks: Sequence[str] = (),
        has_odometry: bool = True,
    ) -> None:
        """Make a log of at least one tick, with ascending `stamp_ns`; `remarks` are what its reader has to say."""
        self.ticks = tuple(ticks)
        self.scans = tuple(tick.scan for tick in self.ticks if tick.scan is not None)
        self.laser, self.has_odometry = laser, has_odometry
        self._remarks = tuple(remarks)
        self._own_stamps = [tick.log_stamp_s for tick in self.ticks if tick.log_stamp_s is not None]
        self.backward_stamps = sum(later < earlier for earlier, later in itertools.pairwise(self._own_stamps))

    @property
    def start(self) -> Pose:
        """The first odometry pose, `T_odom_robot`."""
        return self.ticks[0].odometry

    @property
    def duration_s(self) -> float:
        """Record time from the first tick to the last, seconds."""
        return seconds(self.ticks[-1].stamp_ns - self.ticks[0].stamp_ns)

    def remarks(self) -> list[str]:
        """What a user should know of this log, a line each: what was assumed, what it lacks, what was left out."""
        lines = [*self._remarks, *stamp_remarks(self._own_stamps)]
        if self.has_odometry and len(self.scans) > 1 and all(tick.odometry == self.start for tick in self.ticks):
            if self._scans_move():
                lines.append("the odometry never changes, but the scans do: use `no_odometry`")
            else:
                lines.append(
                    "the odometry never changes: the robot is taken to stand still, and the first scan is its map"
                )
        return lines

    def _scans_move(self) -> bool:
        """Whether scans differ in most of their beams: people who walk by change fewer."""
        first = self.scans[0].ranges
        others = [scan.ranges for scan in self.scans[:: max(1, len(self.scans) // _COMPARED)]]
        changed = []
        for ranges in others:
            count = min(len(first), len(ranges))
            here, there = np.minimum(first[:count], _FAR_M), np.minimum(ranges[:count], _FAR_M)
            changed.append(float(np.mean(np.abs(here - there) > _MOVED_M)))
        return max(changed) > _MOST


class Playback:
    """A source of recorded ticks, and then of those of another source, if there is one."""

    def __init__(self, ticks: Iterable[Tick], then: Source | None = None) -> None:
        self._ticks, self._then = iter(ticks), then

    def step(self, command: Command) -> Tick | None:
        """The next tick, None at the end; for a recorded one the command is ignored."""
        tick = next(self._ticks, None)
        return tick if tick is not None or self._then is None else self._then.step(command)


def pose_between(before: tuple[int, Pose], after: tuple[int, Pose], at_ns: int) -> Pose:
    """Odometry at a stamp between two records of it, each a stamp, ns, and a pose: a share of the motion."""
    (before_ns, pose), (after_ns, other) = before, after
    motion, share = pose.inverse() @ other, (at_ns - before_ns) / (after_ns - before_ns)
    return pose @ Pose(share * motion.x, share * motion.y, share * motion.theta)


def gaps_of(odometry: Sequence[tuple[int, Pose]]) -> list[str]:
    """A line on the gaps of poses with stamps, ns, in the order of the records, if there are any."""
    if len(odometry) < 2:
        return []
    stamps_ns = np.array([stamp_ns for stamp_ns, _ in odometry], dtype=np.int64)
    periods_s, lines = passed_s(stamps_ns), []
    usual_s = float(np.median(periods_s))
    gaps = np.flatnonzero(periods_s > longest_s(usual_s))
    if len(gaps):
        longest = gaps[np.argmax(periods_s[gaps])]
        lines.append(
            f"odometry has {len(gaps)} gaps, the longest of {periods_s[longest]:.1f} s after "
            f"{seconds(stamps_ns[longest] - stamps_ns[0]):.1f} s; it comes every {usual_s:.3f} s otherwise"
        )
    return lines


def longest_s(usual_s: float) -> float:
    """The longest time between records of odometry that come every `usual_s` in which a pose is interpolated."""
    return max(GAP_S, 3.0 * usual_s)


def continued(odometry: Sequence[tuple[int, Pose]]) -> tuple[list[Pose], list[str]]:
    """The poses, with stamps in ns, where odometry that jumps goes on from where it was; and a line on the jumps.

    No robot on wheels is that fast: its driver was started again, or the poses are of a map that was corrected. Scans
    tell what the robot did meanwhile, and standing is next to that. Where stamps tell no time, no motion is a jump.
    """
    poses = [pose for _, pose in odometry]
    if len(poses) < 2:
        return poses, []
    stamps_ns = np.array([stamp_ns for stamp_ns, _ in odometry], dtype=np.int64)
    passed, steps = passed_s(stamps_ns), np.diff([pose.array() for pose in poses], axis=0)
    moved_m, turned = np.hypot(steps[:, 0], steps[:, 1]), np.abs(wrap_angle(steps[:, 2]))
    passed[1:] += np.where(steps[:-1].any(axis=1), 0.0, passed[:-1])  # a record may repeat an old pose, late
    jumps = np.flatnonzero((moved_m > _FASTEST * passed + JOLT_M) | (turned > _FASTEST_RAD * passed + JOLT_RAD))
    if not len(jumps):
        return poses, []
    for first, past in itertools.pairwise([*(jumps + 1).tolist(), len(poses)]):
        back = poses[first - 1] @ poses[first].inverse()
        poses[first:past] = [back @ pose for pose in poses[first:past]]
    largest = jumps[np.argmax(moved_m[jumps])]
    after_s = 1e-9 * (stamps_ns[largest] - stamps_ns[0])
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times, at most"
    return poses, [
        f"odometry jumps {times} by {moved_m[largest]:.1f} m after {after_s:.1f} s: it goes on from where it was"
    ]


def without_jumps(ticks: Sequence[Tick], own_ns: Sequence[int], remarks: list[str]) -> Sequence[Tick]:
    """The ticks, with stamps of the log, with odometry that is `continued`; a line on its jumps goes to the remarks."""
    poses, jumps = continued([(stamp_ns, tick.odometry) for stamp_ns, tick in zip(own_ns, ticks, strict=True)])
    remarks += jumps
    if not jumps:
        return ticks
    return [replace(tick, odometry=pose) for tick, pose in zip(ticks, poses, strict=True)]


def found_turns(scans: Sequence[Scan], frame: str) -> str | None:
    """What is wrong with scans of one topic and `frame` if they are those of two lasers in turn; None if they are not.

    Robots that stand, too: the next scan would else resemble the first as the second next one does.
    """
    if not _take_turns(scans):
        return None
    return f"found scans of two lasers in turn, all of frame {shown_name(frame)}, allowed: a frame for each laser"


def _take_turns(scans: Sequence[Scan]) -> bool:
    """Whether scans resemble the second next one and not the next one, along the whole log."""
    if len(scans) < _FEWEST:
        return False
    first = np.unique(np.linspace(0, len(scans) - 3, _MOST_TRIPLES).astype(int))
    found = [_resembles_the_second_next(*(_view(scan) for scan in scans[k : k + 3])) for k in first]
    return float(np.mean(found)) >= _SHARE


def _view(scan: Scan) -> Array:
    """(36,) median range in each sector of bearings, m; NaN where no beam has returned."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    sector = np.floor(scan.bearings * (_BINS / (2.0 * np.pi))).astype(int) % _BINS
    returned = np.isfinite(ranges) & (ranges > 0.0) & (ranges <= scan.max_range)
    own = [ranges[returned & (sector == k)] for k in range(_BINS)]
    return np.array([np.median(values) if len(values) else np.nan for values in own])


def _resembles_the_second_next(first: Array, next_one: Array, second_next: Array) -> bool:
    to_next, to_second = _difference(first, next_one), _difference(first, second_next)
    return to_next > _LEAST_M and to_second < _RATIO * to_next


def _difference(one: Array, other: Array) -> float:
    """Median difference of two views, m; that of views which share no sector is infinite."""
    off = np.abs(one - other)
    return float(np.nanmedian(off)) if np.isfinite(off).any() else float("inf")


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

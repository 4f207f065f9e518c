"""A recorded log: its ticks, what its reader has found, and hand-checked relations between its scans."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Source, Tick, seconds
from sixthsense.logs.finding import Finding
from sixthsense.logs.joining import Odometry, Sighting, joined
from sixthsense.logs.laser_geometry import with_beams
from sixthsense.logs.text_lines import read_table


class Log:
    """A recorded log: its ticks in the order of the file."""

    ticks: tuple[Tick, ...]
    """All ticks."""
    scans: tuple[Scan, ...]
    """All scans, in the order of the ticks."""
    laser: LaserConfig | None
    """The laser as the log describes it; None where it does not."""
    found: tuple[Finding, ...]
    """What its reader has found."""
    sightings: tuple[Sighting, ...]
    """The scans with their own stamps, of a log whose scans and odometry were joined."""
    odometry: Odometry | None
    """The odometry with its own stamps, of such a log; None without any."""
    candidates: tuple[tuple[float, float], ...]
    """The bearing of the first beam and the angle between two, rad, that its scans may have, if nothing states it."""

    def __init__(self, ticks: Sequence[Tick], laser: LaserConfig | None = None, found: Sequence[Finding] = ()) -> None:
        """Make a log of at least one tick, with ascending `stamp_ns`."""
        self.ticks, self.laser, self.found = tuple(ticks), laser, tuple(found)
        self.scans = tuple(tick.scan for tick in self.ticks if tick.scan is not None)
        self.sightings, self.odometry, self.candidates = (), None, ()

    @classmethod
    def of(
        cls,
        sightings: Sequence[Sighting],
        odometry: Odometry | None,
        laser: LaserConfig,
        found: Sequence[Finding] = (),
        candidates: Sequence[tuple[float, float]] = (),
    ) -> Log:
        """Join scans with odometry; `laser` has what scans do not say, `candidates` the beams that they may have."""
        log = cls(joined(sightings, odometry), described_laser([each.scan for each in sightings], laser), found)
        log.candidates = tuple(candidates)
        log.sightings, log.odometry = tuple(sightings), odometry
        return log

    def _with(self, sightings: Sequence[Sighting], odometry: Odometry | None) -> Log:
        """The log of other scans or odometry; itself if they were not joined."""
        if self.laser is None or not self.sightings:
            return self
        return Log.of(sightings, odometry, self.laser, self.found, self.candidates)

    def later(self, time_offset_s: float) -> Log:
        """The log with its odometry so much later, s; itself for one whose scans and odometry were not joined."""
        if self.odometry is None or not time_offset_s:
            return self
        return self._with(self.sightings, self.odometry.later(time_offset_s))

    def without_odometry(self) -> Log:
        """The log with its scans alone."""
        return self._with(self.sightings, None)

    def with_beams(self, first: float, step: float) -> Log:
        """The log with scans whose beams begin at a bearing, and are a step apart, rad."""
        return self._with(
            [each._replace(scan=with_beams(each.scan, first, step)) for each in self.sightings], self.odometry
        )

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
    mount = scans[0].T_robot_laser
    return laser.replaced(beams=count, fov=fov, max_range=reach, mount=(mount.x, mount.y, mount.theta))


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

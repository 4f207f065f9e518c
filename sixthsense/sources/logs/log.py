"""Sources of recorded ticks: a log of any format, and what another source has sent."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Sequence

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Source, Tick

_COMPARED = 20  # scans, evenly over the log
_MOVED_M, _FAR_M, _MOST = 0.3, 100.0, 0.5  # by which a range has changed, m; at most; and the share of beams


class Log:
    """A recorded log as a `Source`: its ticks in the order of the file."""

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
        self._next = 0

    @property
    def start(self) -> Pose:
        """The first odometry pose, `T_odom_robot`."""
        return self.ticks[0].odometry

    @property
    def duration_s(self) -> float:
        """Record time from the first tick to the last, seconds."""
        return (self.ticks[-1].stamp_ns - self.ticks[0].stamp_ns) * 1e-9

    def remarks(self) -> list[str]:
        """What a user should know of this log, a line each: what was assumed, what it lacks, what was left out."""
        lines = list(self._remarks)
        if self.backward_stamps:
            lines.append(f"stamps decrease at {self.backward_stamps} scans; replayed in the order of the file")
        stamps = self._own_stamps
        if len(stamps) > 1 and min(stamps) == max(stamps):
            lines.append(f"all {len(stamps)} scans have the stamp {stamps[0]:.6f}; replayed in the order of the file")
        if self.has_odometry and len(self.scans) > 1 and all(tick.odometry == self.start for tick in self.ticks):
            if self._scans_move():
                lines.append("the odometry never changes, but the scans do: use --no-odometry")
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

    def rewind(self) -> None:
        """Restart at the first tick."""
        self._next = 0

    def step(self, command: Command) -> Tick | None:
        """The next tick, None at the end; the command is ignored."""
        if self._next == len(self.ticks):
            return None
        self._next += 1
        return self.ticks[self._next - 1]


class RewindableSource:
    """Passes on the ticks of another source, and keeps them until `rewind`, after which they come first."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._kept: deque[Tick] = deque()
        self._is_rewound = False

    def step(self, command: Command) -> Tick | None:
        """The next tick; for one that comes a second time the command is ignored."""
        if self._is_rewound and self._kept:
            return self._kept.popleft()
        tick = self._source.step(command)
        if tick is not None and not self._is_rewound:
            self._kept.append(tick)
        return tick

    def rewind(self) -> None:
        """Begin again; ticks that follow those so far are not kept."""
        self._is_rewound = True

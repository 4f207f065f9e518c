"""A recorded log of any format: a `Source` of its ticks."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command, Tick


class Log:
    """A recorded log as a `Source`: its ticks in the order of the file."""

    ticks: tuple[Tick, ...]
    """All ticks."""
    scans: tuple[Scan, ...]
    """All scans, in the order of the ticks."""
    backward_stamps: int
    """Number of scans whose stamp in the log is earlier than that of the previous scan."""

    def __init__(self, ticks: Sequence[Tick]) -> None:
        """Make a log of at least one tick, with ascending `stamp_ns`."""
        self.ticks = tuple(ticks)
        self.scans = tuple(tick.scan for tick in self.ticks if tick.scan is not None)
        own = [tick.log_stamp_s for tick in self.ticks if tick.log_stamp_s is not None]
        self.backward_stamps = sum(later < earlier for earlier, later in itertools.pairwise(own))
        self._next = 0

    @property
    def start(self) -> Pose:
        """The first odometry pose, `T_odom_robot`."""
        return self.ticks[0].odometry

    @property
    def duration_s(self) -> float:
        """Record time from the first tick to the last, seconds."""
        return (self.ticks[-1].stamp_ns - self.ticks[0].stamp_ns) * 1e-9

    def rewind(self) -> None:
        """Restart at the first tick."""
        self._next = 0

    def step(self, command: Command) -> Tick | None:
        """The next tick, None at the end; the command is ignored."""
        if self._next == len(self.ticks):
            return None
        self._next += 1
        return self.ticks[self._next - 1]

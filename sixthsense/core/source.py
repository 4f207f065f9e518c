"""The interface between the loop and its source of scans and odometry: a simulated world, or a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.laser import Scan

Duration = TypeVar("Duration", float, Array)


def seconds(duration_ns: Duration) -> Duration:
    """A duration, or (n,) of them, in seconds."""
    return 1e-9 * duration_ns


@dataclass(frozen=True, slots=True)
class Command:
    """Velocities commanded to the drive."""

    speed: float = 0.0
    """m/s, forward"""
    turn_rate: float = 0.0
    """rad/s, counter-clockwise"""


@dataclass(frozen=True, slots=True)
class Closure:
    """A measured motion from the pose of an earlier tick to that of this one."""

    before: int
    """number of the tick at which it begins, 0 for the first"""
    motion: Pose
    """of this tick's pose in the frame of that one"""
    cov: Array
    """(3, 3) of its error, axes of this tick's pose"""


@dataclass(frozen=True, slots=True)
class Tick:
    """One step of a source: odometry, and a scan if there is one."""

    stamp_ns: int
    """Record time, strictly ascending."""
    odometry: Pose
    """Pose by wheel odometry alone, `T_odom_robot`; the loop takes differences of it."""
    scan: Scan | None = None
    """The laser's scan at this stamp, if there is one."""
    observations: Mapping[LandmarkId, Observation] | None = None
    """Observations of landmarks that the log identifies; empty if none was in view, None without an observation."""
    increment_cov: Array | None = None
    """(3, 3) of the motion since the last tick, axes of this tick's pose, if the log states it; else it follows from
    the assumed noise."""
    truth: Pose | None = None
    """`T_world_robot`, for the record only."""
    collided: bool = False
    """Whether the robot touched a wall since the last tick; it stands where it touched."""
    walkers: Array | None = None
    """(N, 3) x, y and heading of people in a simulated building, for the record only; None without any."""
    touches: tuple[int, int] = (0, 0)
    """How often the robot and a person have touched so far, by the robot's fault and by the person's."""
    log_stamp_s: float | None = None
    """The log's own stamp of the scan, which relations refer to."""
    closures: Sequence[Closure] | None = None
    """Measured motions to the pose of this tick from earlier ones, of a log whose every tick is then a keyframe; None
    in a log without any."""
    is_unmeasured: bool = False
    """Whether nothing has measured the motion since the last tick: `odometry` is held, and the scan alone tells it."""


class Source(Protocol):
    """A world or a log."""

    def step(self, command: Command) -> Tick | None:
        """Advance by one tick under `command` (a log ignores it); None when there is no more."""
        ...

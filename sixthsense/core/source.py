"""The seam between the loop and where its evidence comes from: a simulated world, or a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Sighting
from sixthsense.core.laser import Scan


@dataclass(frozen=True, slots=True)
class Command:
    """What the follower asks of the drive."""

    speed: float = 0.0
    """m/s, forward"""
    turn_rate: float = 0.0
    """rad/s, counter-clockwise"""


@dataclass(frozen=True, slots=True)
class Tick:
    """One turn of a source's clock."""

    stamp_ns: int
    """Record time, strictly ascending."""
    odometry: Pose
    """Where the wheels alone say the robot is: `T_odom_robot`; the loop differences it."""
    scan: Scan | None = None
    """The laser's scan, taken at this instant, if there is one."""
    sightings: Mapping[LandmarkId, Sighting] | None = None
    """Landmarks that the log itself knows by name; empty where it looked and saw none, None where it did not look."""
    increment_cov: Array | None = None
    """(3, 3) of the motion since the last tick, frame before, where the log states it; else the assumed noise's."""
    truth: Pose | None = None
    """`T_world_robot`, for the record only."""
    collided: bool = False
    """The robot touched a wall on the way here; it stands where it touched."""
    log_stamp_s: float | None = None
    """The log's own stamp of the scan, by which relations name it."""


class Source(Protocol):
    """A world or a log."""

    def step(self, command: Command) -> Tick | None:
        """Advance by one tick under `command` (a log ignores it); None when there is no more."""
        ...

"""Where the motion between scans is from, and what that means for tracking and for the estimator."""

from __future__ import annotations

from typing import Protocol

from sixthsense.core.motion import Odometry
from sixthsense.slam.scans.odometry_prior import with_unsteady_errors, with_wheel_errors


class Increments(Protocol):
    """A source of the motion since the last keyframe, before and after the newest scan is aligned."""

    is_guess: bool
    """whether nothing has measured the motion: the scan alone tells it, and a doubtful alignment is searched again"""

    def is_carried(self, increment: Odometry) -> bool:
        """Whether the robot was carried during an increment."""
        ...

    def aligned(self, since: Odometry, found: Odometry | None) -> Odometry:
        """The motion since the last keyframe to go on from, after a scan was aligned as `found`, or was not."""
        ...

    def with_errors(self, since: Odometry, wheels_are_estimated: bool) -> Odometry:
        """The motion since the last keyframe with all its errors, as the estimator is given it at the next one."""
        ...

    def at_end(self, since: Odometry) -> Odometry:
        """The motion since the last keyframe as the estimator is given it after the last tick."""
        ...

    def at_keyframe(self) -> None:
        """Begin anew at a keyframe."""
        ...


class WheelIncrements:
    """Wheels have measured the motion, and an aligned scan is no reason to forget it."""

    is_guess = False

    def is_carried(self, increment: Odometry) -> bool:
        """Whether no wheel has measured an increment."""
        return increment.is_carried()

    def aligned(self, since: Odometry, found: Odometry | None) -> Odometry:
        """The motion by the wheels."""
        return since

    def with_errors(self, since: Odometry, wheels_are_estimated: bool) -> Odometry:
        """The motion with the errors of any wheels, or with those that their parameters leave."""
        return with_unsteady_errors(since) if wheels_are_estimated else with_wheel_errors(since)

    def at_end(self, since: Odometry) -> Odometry:
        """The motion by the wheels."""
        return since

    def at_keyframe(self) -> None:
        """Nothing is kept."""

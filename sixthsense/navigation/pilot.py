"""From a step of SLAM to a command: the navigator steers, the guard checks every command."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numba

from sixthsense.core.geometry import Pose
from sixthsense.core.se2 import Triple
from sixthsense.core.source import Command
from sixthsense.navigation.guard import Guard, GuardLimits, Returns, checked
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.path_driver import DriverLimits, GoalDrive, steered
from sixthsense.slam.slam import Step

_PATIENCE_NS = 3_000_000_000
"""time that a stopped robot waits for what moves, before it seeks another way"""


class PilotLimits(NamedTuple):
    """What a kernel needs to steer, and does not change."""

    driver: DriverLimits
    guard: GuardLimits


class Steering(NamedTuple):
    """What a kernel changes as it steers."""

    drive: GoalDrive
    since_scan: Triple
    """motion since the latest scan"""
    returns: Returns
    waits_for_moving: bool
    """whether what moves was nearest in the way of the last command"""


@numba.njit(cache=True, error_model="numpy")
def commanded(
    steering: Steering, pose: Triple, stamp_ns: int, limits: PilotLimits
) -> tuple[Steering, float, float, bool]:
    """What `Pilot.command` does in a tick in which nothing has to be decided.

    Returns the state, speed and turn rate, and whether that was so. If not, the state is as before: the mission has to
    be asked, or the guard stops the robot.
    """
    drive, speed, turn_rate, is_all = steered(steering.drive, pose, stamp_ns, limits.driver)
    if not is_all:
        return steering, 0.0, 0.0, False
    speed, turn_rate, is_stopped, waits = checked(
        (speed, turn_rate), steering.since_scan, steering.returns, steering.waits_for_moving, limits.guard
    )
    if is_stopped:
        return steering, 0.0, 0.0, False
    return Steering(drive, steering.since_scan, steering.returns, waits), speed, turn_rate, True


class Steersman(Protocol):
    """What the loop asks for commands."""

    @property
    def navigator(self) -> Navigator:
        """Says where to go."""
        ...

    @property
    def guard(self) -> Guard:
        """Slows or stops the robot before what it would touch."""
        ...

    def steer(self, step: Step) -> Command:
        """Take in a step of SLAM; the command from now on."""
        ...


class Pilot:
    """Takes a command from the navigator and lets the guard slow or stop it."""

    def __init__(self, navigator: Navigator, guard: Guard) -> None:
        self.navigator = navigator
        self.guard = guard
        self._stopped_ns: int | None = None

    def steer(self, step: Step) -> Command:
        """The command for the next control tick."""
        if step.increment is not None:
            self.guard.moved(step.increment.motion)
        self.look(step)
        return self.command(step.pose, step.stamp_ns)

    def look(self, step: Step) -> None:
        """Show the guard the step's scan, and the navigator the map of its keyframe."""
        if step.scan is not None:
            self.guard.see(step.scan, step.moving.points_robot)
        if step.keyframe is not None:
            self.navigator.look(step.grid, step.keyframe.estimate)

    def command(self, pose: Pose, stamp_ns: int) -> Command:
        """The command of a robot at a pose, `T_world_robot`."""
        command = self.guard.check(self.navigator.step(pose, stamp_ns))
        if not self.guard.stopped:
            self._stopped_ns = None
            return command
        if self._stopped_ns is None:
            self._stopped_ns = stamp_ns
        # Who walks by is gone in a moment; then the robot goes around.
        if not self.guard.waits_for_moving or stamp_ns - self._stopped_ns >= _PATIENCE_NS:
            self.navigator.guard_stopped(pose)
        return command

    def between_scans(self) -> tuple[Steering, PilotLimits] | None:
        """What a kernel needs to steer until the next scan; None without a drive to a goal."""
        driver, guard = self.navigator.driver, self.guard
        if driver is None:
            return None
        since = (guard.since.x, guard.since.y, guard.since.theta)
        steering = Steering(driver.drive, since, guard.returns(), guard.waits_for_moving)
        return steering, PilotLimits(driver.limits, guard.limits)

    def passed(self, steering: Steering, ticks: int) -> None:
        """Take in the state after ticks, in the first `ticks` of which a kernel has steered."""
        self.guard.moved_to(steering.since_scan)
        driver = self.navigator.driver
        if ticks and driver is not None:
            driver.drive = steering.drive
            self.guard.passed(steering.waits_for_moving)
            self._stopped_ns = None


class AheadPilot:
    """Asks a pilot to steer a robot whose scans arrive late: by the last step and the odometry since."""

    def __init__(self, pilot: Pilot) -> None:
        self.navigator, self.guard = pilot.navigator, pilot.guard
        self._pilot = pilot
        self._step: Step | None = None
        self._since_scan = Pose()  # motion from the last scan to the last step
        self._guarded = Pose()  # motion from the last scan that the guard knows of
        self._command = Command()

    def steer(self, step: Step) -> Command:
        """Take in a step; the command in force, which the newest odometry has made, and not this late step."""
        if step.increment is not None:
            self._since_scan = self._since_scan @ step.increment.motion
        if step.scan is not None:
            self._since_scan = self._guarded = Pose()
        self._pilot.look(step)
        self._step = step
        return self._command

    def ahead(self, motion: Pose, stamp_ns: int) -> Command:
        """The command of a robot that has moved by `motion` since the last step; a standstill before the first one."""
        if self._step is None:
            return Command()
        since_scan = self._since_scan @ motion
        self.guard.moved(self._guarded.inverse() @ since_scan)
        self._guarded = since_scan
        self._command = self._pilot.command(self._step.pose @ motion, stamp_ns)
        return self._command

"""From a step of SLAM to a command: the navigator steers, the guard checks every command."""

from __future__ import annotations

from sixthsense.core.geometry import Pose
from sixthsense.core.source import Command
from sixthsense.navigation.guard import REMEMBERED_S, Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.slam.result import Step

TURN_RATE = 0.3
"""rad/s, of a robot that looks for its place"""
_PATIENCE_S = 3.0
"""time that a stopped robot waits for what moves, before it seeks another way"""


class Pilot:
    """Takes a command from the navigator and lets the guard slow or stop it."""

    def __init__(self, navigator: Navigator, guard: Guard) -> None:
        self.navigator = navigator
        self.guard = guard
        self.pace = 1.0
        """share of the navigator's speed that is driven; at 0 the robot turns in place, since its map is wrong"""
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
        command = self.guard.check(self._paced(self.navigator.step(pose, stamp_ns)))
        if not self.guard.stopped:
            self._stopped_ns = None
            return command
        if self._stopped_ns is None:
            self._stopped_ns = stamp_ns
        # Who walks by is gone in a moment; then the robot goes around.
        # In a narrow gap the noise of single returns stops it, as long as the guard remembers them.
        patience_s = _PATIENCE_S if self.guard.waits_for_moving else REMEMBERED_S
        if stamp_ns - self._stopped_ns >= patience_s * 10**9:
            self.navigator.guard_stopped(pose)
        return command

    def _paced(self, command: Command) -> Command:
        if self.pace == 1.0 or command == Command():
            return command
        if not self.pace:
            return Command(0.0, TURN_RATE)
        return Command(self.pace * command.speed, self.pace * command.turn_rate)

"""From a step of SLAM to a command: the navigator steers, the guard checks every command."""

from __future__ import annotations

from sixthsense.core.source import Command
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.slam.slam import Step


class Pilot:
    """Takes a command from the navigator and lets the guard slow or stop it."""

    def __init__(self, navigator: Navigator, guard: Guard) -> None:
        self.navigator = navigator
        self.guard = guard

    def steer(self, step: Step) -> Command:
        """The command for the next control tick."""
        if step.increment is not None:
            self.guard.moved(step.increment.motion)
        if step.scan is not None:
            self.guard.see(step.scan)
        if step.key_scan is not None:
            self.navigator.look(step.grid, step.key_scan.estimate)
        command = self.guard.check(self.navigator.step(step.pose, step.stamp_ns))
        if self.guard.stopped:
            self.navigator.guard_stopped(step.pose)
        return command

"""The pilot of a robot whose scans arrive late: it steers by the odometry that is newer than the last step of SLAM."""

from __future__ import annotations

from sixthsense.core.geometry import Pose
from sixthsense.core.source import Command
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.slam.result import Step


class AheadPilot(Pilot):
    """Steers a robot whose scans arrive late: by the last step and the odometry since."""

    def __init__(self, navigator: Navigator, guard: Guard) -> None:
        super().__init__(navigator, guard)
        self._step: Step | None = None
        self._since_scan = Pose()  # motion from the last scan to the last step
        self._guarded = Pose()  # motion from the last scan that the guard knows of
        self._command = Command()

    def steer(self, step: Step) -> Command:
        """Record a step; the command in force, which the newest odometry has made, and not this late step."""
        if step.increment is not None:
            self._since_scan = self._since_scan @ step.increment.motion
        if step.scan is not None:
            # The guard has followed newer odometry: it goes back to where the scan was taken, or the returns of earlier
            # scans would be moved once more by the motion since.
            self.guard.moved(self._guarded.inverse() @ self._since_scan)
            self._since_scan = self._guarded = Pose()
        self.look(step)
        self._step = step
        return self._command

    def ahead(self, motion: Pose, stamp_ns: int) -> Command:
        """The command of a robot that has moved by `motion` since the last step; a standstill before the first scan."""
        if self._step is None:
            return Command()
        since_scan = self._since_scan @ motion
        self.guard.moved(self._guarded.inverse() @ since_scan)
        self._guarded = since_scan
        self._command = self.command(self._step.pose @ motion, stamp_ns)
        return self._command

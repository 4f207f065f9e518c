"""What the loop asks for commands: a navigator, which sets about its task when the first map arrives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Command
from sixthsense.navigation.path_driver import DriveEvent, PathDriver
from sixthsense.navigation.path_planner import PathPlanner
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import Grid

Outcome = Literal["goal reached", "tour ended", "explored", "explored in part", "lost", "goal unreachable", "stuck"]


class Task(Protocol):
    """Decides where to drive, from the first map on."""

    outcome: Outcome | None
    """why it is over, None while it is not"""
    left: list[UnseenPlace]
    """the places that a completed exploration has not seen"""
    driver: PathDriver
    """drives to the present goal"""

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Take in a map that has changed, and the estimate of the robot's pose."""
        ...

    def guard_stopped(self, pose: Pose) -> None:
        """Take in that the guard has stopped the last command."""
        ...

    def handle(self, event: DriveEvent, pose: Pose) -> bool:
        """React to an event of the drive, perhaps with another goal; whether the task is over."""
        ...


class Navigator:
    """Turns the map and the estimate into commands; without a task it steers nothing: a recorded robot moves as it did.

    Before the first map the robot stands still.
    """

    def __init__(
        self,
        begin: Callable[[Grid, Estimate], Task] | None = None,
        paths: PathPlanner | None = None,
        timeout_outcome: str = "log ended",
    ) -> None:
        """`begin` makes the task from the first map; its driver plans by `paths`."""
        self.timeout_outcome = timeout_outcome
        """the outcome if time is up before the task is over"""
        self.plans: list[Array] = [] if paths is None else paths.plans
        """every planned path, (N, 2) each, world frame; always the same list"""
        self.tours: list[Array] = [] if paths is None else paths.tours
        """way points (N, 2) of each tour of an exploration: robot, views, home; always the same list"""
        self._begin, self._paths = begin, paths
        self._task: Task | None = None

    @property
    def outcome(self) -> Outcome | None:
        """Why the task is over, None while it is not."""
        return None if self._task is None else self._task.outcome

    @property
    def plans_below_margin(self) -> int | None:
        """How many paths keep less than the wanted margin; None if the navigator plans nothing."""
        return None if self._paths is None else self._paths.plans_below_margin

    @property
    def plans_by_astar(self) -> int | None:
        """How many paths are A*'s because the planner found none; None if it is A*, or if nothing is planned."""
        return None if self._paths is None else self._paths.plans_by_astar

    @property
    def left(self) -> list[UnseenPlace]:
        """The places that a completed exploration has not seen."""
        return [] if self._task is None else self._task.left

    @property
    def driver(self) -> PathDriver | None:
        """Drives to the present goal; None before there is one."""
        return None if self._task is None else self._task.driver

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Take in a map that has changed, and the estimate of the robot's pose."""
        if self._begin is not None and self._task is None:
            self._task = self._begin(grid, estimate)
        if self._task is not None:
            self._task.look(grid, estimate)

    def guard_stopped(self, pose: Pose) -> None:
        """Take in that the guard has stopped the last command: turn on the spot until another path is found."""
        if self._task is not None:
            self._task.guard_stopped(pose)

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """The command for the next control tick."""
        return Command() if self._task is None else self._task.driver.step(pose, stamp_ns, self._task)

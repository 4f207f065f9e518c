"""What the loop asks of a navigator, and the navigator of a recorded robot."""

from __future__ import annotations

from typing import Literal, Protocol

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Command
from sixthsense.navigation.path_driver import PathDriver
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import Grid

Outcome = Literal["goal reached", "tour ended", "explored", "explored in part", "lost", "goal unreachable", "stuck"]


class Navigator(Protocol):
    """Turns the map and the estimate into commands."""

    @property
    def outcome(self) -> Outcome | None:
        """Why the task is over, None while it is not."""
        ...

    @property
    def timeout_outcome(self) -> str:
        """The outcome if time is up before that."""
        ...

    @property
    def plans(self) -> list[Array]:
        """Every planned path, (N, 2) each, world frame; always the same list."""
        ...

    @property
    def tours(self) -> list[Array]:
        """Way points (N, 2) of each tour of an exploration: robot, views, home; always the same list."""
        ...

    @property
    def plans_below_margin(self) -> int | None:
        """How many of them keep less than the wanted margin; None if the navigator plans nothing."""
        ...

    @property
    def plans_by_astar(self) -> int | None:
        """How many of them are A*'s because the planner found none; None if it is A*, or if nothing is planned."""
        ...

    @property
    def left(self) -> list[UnseenPlace]:
        """The places that a completed exploration has not seen."""
        ...

    @property
    def driver(self) -> PathDriver | None:
        """Drives to the present goal; None before there is one."""
        ...

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Take in a map that has changed, and the estimate of the robot's pose."""
        ...

    def guard_stopped(self, pose: Pose) -> None:
        """Take in that the guard has stopped the last command."""
        ...

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """The command for the next control tick."""
        ...


class ReplayNavigator:
    """Steers nothing: a recorded robot moves as it did."""

    def __init__(self) -> None:
        self.outcome: Outcome | None = None
        self.timeout_outcome = "log ended"
        self.plans: list[Array] = []
        self.tours: list[Array] = []
        self.plans_below_margin: int | None = None
        self.plans_by_astar: int | None = None
        self.left: list[UnseenPlace] = []
        self.driver: PathDriver | None = None

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Nothing to do."""

    def guard_stopped(self, pose: Pose) -> None:
        """Nothing to do."""

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """A standstill, which a log ignores."""
        return Command()

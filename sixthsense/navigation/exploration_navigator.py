"""Exploring a region: the navigator that makes an `Exploration` when the first map arrives."""

from __future__ import annotations

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Command
from sixthsense.navigation.area_to_see import Region
from sixthsense.navigation.exploration import Exploration
from sixthsense.navigation.exploration_task import ExplorationTask
from sixthsense.navigation.follower import Follower
from sixthsense.navigation.navigator import Outcome
from sixthsense.navigation.path_driver import PathDriver
from sixthsense.navigation.path_planner import PathPlanner
from sixthsense.navigation.planners import Planner
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.navigation.view_gain import SensorModel
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import Grid


class ExplorationNavigator:
    """Sees all that can be seen of a region, then drives home."""

    def __init__(
        self, start: Pose, region: Region, radius_m: float, planner: Planner, follower: Follower, config: Config,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        """Explore `region` (x0, y0, x1, y1) from `start` with a disc of `radius_m`; `rng` is for the random method.

        The region is enlarged to hold the start.
        """
        self.timeout_outcome = "out of time"
        self._paths = PathPlanner(planner, config)
        x0, y0, x1, y1 = region
        self._task = ExplorationTask(
            home=start.position,
            region=(min(x0, start.x), min(y0, start.y), max(x1, start.x), max(y1, start.y)),
            radius_m=radius_m,
            sensor=SensorModel.of(config.laser, config.grid.cell_m, config.keyframes.turn_rad),
            paths=self._paths,
            follower=follower,
            config=config,
            rng=rng,
        )
        self._exploration: Exploration | None = None

    @property
    def outcome(self) -> Outcome | None:
        """Why the exploration is over, None while it is not."""
        return None if self._exploration is None else self._exploration.outcome

    @property
    def left(self) -> list[UnseenPlace]:
        """The places that a completed exploration has not seen."""
        return [] if self._exploration is None else self._exploration.left

    @property
    def plans(self) -> list[Array]:
        """Every planned path."""
        return self._paths.plans

    @property
    def tours(self) -> list[Array]:
        """Every tour by which a view was chosen."""
        return self._task.tours

    @property
    def plans_below_margin(self) -> int:
        """How many of them keep less than the wanted margin."""
        return self._paths.plans_below_margin

    @property
    def plans_by_astar(self) -> int | None:
        """How many of them are A*'s because the planner found none; None if it is A*."""
        return self._paths.plans_by_astar

    @property
    def driver(self) -> PathDriver | None:
        """Drives to the present target; None before the first map."""
        return None if self._exploration is None else self._exploration.driver

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Take in a map that has changed."""
        if self._exploration is None:
            self._exploration = Exploration(self._task, grid, estimate)
        self._exploration.look(grid, estimate)

    def guard_stopped(self, pose: Pose) -> None:
        """Turn on the spot until another path is found."""
        if self._exploration is not None:
            self._exploration.driver.guard_stopped(pose)

    def step(self, pose: Pose, stamp_ns: int) -> Command:
        """The command of a control tick; a standstill before the first map."""
        if self._exploration is None:
            return Command()
        return self._exploration.driver.step(pose, stamp_ns, self._exploration)

"""From the map to a command: exploration, path planning, driving, and the guard that stops the robot.

`make_navigator` makes what the loop asks for commands; `guard.py` checks every command before it reaches the drive.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from sixthsense.config import Config
    from sixthsense.core.geometry import Array, Pose
    from sixthsense.navigation.navigator import Navigator

__all__ = ["make_navigator"]


def make_navigator(
    config: Config,
    start: Pose,
    goals: Array,
    region: tuple[float, float, float, float],
    radius_m: float,
    planner_rng: np.random.Generator,
    exploration_rng: np.random.Generator,
) -> Navigator:
    """The navigator of `config.task`, with the configured planner, for a robot that is a disc of `radius_m`.

    `goals` (N, 2) are for the tasks goal and tour, `region` (x0, y0, x1, y1) for explore; world frame, metres. The
    region is enlarged to hold the start.
    """
    from sixthsense.config.parts import PLANNERS
    from sixthsense.config.tree import part_of
    from sixthsense.navigation.exploration import Exploration
    from sixthsense.navigation.exploration_task import ExplorationTask
    from sixthsense.navigation.goal_navigator import goal_navigator
    from sixthsense.navigation.navigator import Navigator
    from sixthsense.navigation.path_planner import PathPlanner

    planner = part_of(config, PLANNERS).make(planner_rng)
    if config.task != "explore":
        return goal_navigator(goals, planner, config)
    x0, y0, x1, y1 = region
    paths = PathPlanner(planner, config)
    task = ExplorationTask(
        home=start.position,
        region=(min(x0, start.x), min(y0, start.y), max(x1, start.x), max(y1, start.y)),
        radius_m=radius_m,
        paths=paths,
        config=config,
        rng=exploration_rng,
    )
    return Navigator(functools.partial(Exploration, task), paths, "out of time")

"""From the map to a command: exploration, path planning, driving, and the guard that stops the robot.

`make_navigator` makes what the loop asks for commands; `guard.py` checks every command before it reaches the drive.
"""

from __future__ import annotations

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

    `goals` (N, 2) are for the tasks goal and tour, `region` (x0, y0, x1, y1) for explore; world frame, metres.
    """
    from sixthsense.navigation.exploration_navigator import ExplorationNavigator
    from sixthsense.navigation.follower import Follower
    from sixthsense.navigation.goal_navigator import GoalNavigator
    from sixthsense.navigation.planners import make_planner

    follower = Follower(config.follow, config.robot)
    planner = make_planner(config.planner, config.rrtstar, planner_rng)
    if config.task == "explore":
        return ExplorationNavigator(start, region, radius_m, planner, follower, config, exploration_rng)
    return GoalNavigator(goals, planner, follower, config)

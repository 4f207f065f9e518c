"""From the map to a command: exploration, path planning, driving, and the guard that stops the robot.

`make_navigator` makes the navigator, which the pilot asks for commands; `guard.py` checks every command before it
reaches the drive.
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

    `goals` (N, 2) are for the tasks goal and tour, `region` (x0, y0, x1, y1) for explore; world frame, metres. The
    region is enlarged to hold the start.
    """
    from sixthsense.config.parts import PLANNERS
    from sixthsense.config.tree import part_of
    from sixthsense.navigation.exploration import Exploration
    from sixthsense.navigation.goals import Goals
    from sixthsense.navigation.navigator import Navigator, Task
    from sixthsense.navigation.path_planner import DrivingMap, PathPlanner

    paths = PathPlanner(part_of(config, PLANNERS).make(planner_rng), config)
    map_ = DrivingMap(radius_m, config, stays_near_seen=config.task == "explore")
    if config.task != "explore":
        task: Task = Goals(goals, config)
        return Navigator(task, paths, map_, config, "tour ended" if config.task == "tour" else "out of time")
    x0, y0, x1, y1 = region
    region = min(x0, start.x), min(y0, start.y), max(x1, start.x), max(y1, start.y)
    task = Exploration(start.position, region, radius_m, config, exploration_rng)
    return Navigator(task, paths, map_, config, "out of time")

"""Start, goals and robot radius of a task in a scene."""

from __future__ import annotations

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.sources.scene import Scene, SceneError, check_placement


def mission(scene: Scene, config: Config) -> tuple[Pose, Array, float]:
    """Start, goals (N, 2) and robot radius of a task, from the configuration or else from the scene.

    An exploration has no goals.

    Raises SceneError, naming the field, for a place that is missing, outside the region or too close to a wall.
    """
    start = Pose(*config.start) if config.start is not None else scene.start
    goal = config.goal if config.goal is not None else scene.goal
    if config.task == "goal" and goal is None:
        raise SceneError(f"goal: missing, the scene {scene.name} has none of its own, allowed: x y")
    tour = (config.tour or scene.tour) if config.task == "tour" else ()
    if config.task == "tour" and not tour:
        raise SceneError(f"tour: missing, the scene {scene.name} has none of its own, allowed: x y x y ...")
    if config.task != "tour" and config.tour is not None:
        raise SceneError(f"tour: found {len(config.tour)} goals with task {config.task}, allowed: with task tour")
    if config.task == "explore" and config.goal is not None:
        raise SceneError(
            f"goal: found ({config.goal[0]:g}, {config.goal[1]:g}) with task explore, allowed: with task goal"
        )
    if config.task != "goal":
        goal = None
    start = check_placement(scene, start, goal, config.region, config.robot.radius, tour)
    goals = np.array(tour if goal is None else (goal,), dtype=np.float64).reshape(-1, 2)
    return start, goals, config.robot.radius or scene.radius

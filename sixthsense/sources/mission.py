"""A task in a scene: start, goals, the robot's radius and who is about."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.random_streams import random_streams
from sixthsense.sources.scene import Scene, check_placement, load_scene
from sixthsense.sources.walkers import Walkers, walkers_of
from sixthsense.sources.world import World

_CELL_M = 0.05
_SLACK_CELLS = 1.5
"""of a distance between cells, so that no place is called unreachable that is not"""


class Mission(NamedTuple):
    """A task in a scene, of one run: its people walk."""

    scene: Scene
    start: Pose
    """`T_world_robot`"""
    goals: Array
    """(N, 2); an exploration has none"""
    radius_m: float
    """of the robot"""
    walkers: Walkers | None

    def world(self, config: Config) -> World:
        """The simulated world at the start."""
        rng = random_streams(config.seed).world
        return World(self.scene.walls, self.start, self.radius_m, config, rng, self.scene.glass, self.walkers)


def mission_of(config: Config, scene: Scene | None = None) -> tuple[Config, Mission]:
    """The mission in `config.scene`, which is `scene` if it is loaded already; the configuration with its people.

    Raises InputError for a scene that cannot be loaded, and as `mission`.
    """
    scene = scene or load_scene(config.scene, config.map_unknown)
    config = with_people(scene, config)
    return config, mission(scene, config)


def mission(scene: Scene, config: Config) -> Mission:
    """The task of a configuration in a scene, which has what the configuration does not say.

    Raises InputError, naming the field, for a place that is missing, outside the region or too close to a wall, for a
    goal that no way leads to, for a start outside region and building from which the laser reaches no wall, and for
    more walkers than fit in.
    """
    start = Pose(*config.start) if config.start is not None else scene.start
    goal = config.goal if config.goal is not None else scene.goal
    if config.task == "goal" and goal is None:
        raise InputError("goal", f"missing, the scene {scene.name} has none of its own", "x y")
    tour = (config.tour or scene.tour) if config.task == "tour" else ()
    if config.task == "tour" and not tour:
        raise InputError("tour", f"missing, the scene {scene.name} has none of its own", "x y x y ...")
    if config.task != "tour" and config.tour is not None:
        raise InputError("tour", f"found {len(config.tour)} goals with task {config.task}", "with task tour")
    if config.task == "explore" and config.goal is not None:
        raise InputError("goal", f"found ({config.goal[0]:g}, {config.goal[1]:g}) with task explore", "with task goal")
    if config.task != "goal":
        goal = None
    start = check_placement(scene, start, goal, config.region, config.robot.radius, tour)
    x0, y0, x1, y1 = config.region or scene.region
    if not (x0 <= start.x <= x1 and y0 <= start.y <= y1):
        _check_building_in_reach(scene, start, config.laser.max_range)
    goals = np.array(tour if goal is None else (goal,), dtype=np.float64).reshape(-1, 2)
    radius_m = config.robot.radius or scene.radius
    _check_ways(scene, start, goals, radius_m, "goal" if config.task == "goal" else "tour")
    return Mission(scene, start, goals, radius_m, walkers_of(scene, config, start, radius_m))


def with_people(scene: Scene, config: Config) -> Config:
    """The configuration of a robot that knows of people where any walk in the scene, unless it says otherwise."""
    if config.people is None and (scene.walkers or config.world.walkers):
        return dataclasses.replace(config, people=True)
    return config


def _check_ways(scene: Scene, start: Pose, goals: Array, radius_m: float, field: str) -> None:
    """Raise InputError for a goal that no way leads to from the start, as in a shaft without a door."""
    if not len(goals):
        return
    for (x, y), is_connected in zip(goals, connected(scene.solid, start.position, goals, radius_m), strict=True):
        if not is_connected:
            found = f"found ({x:g}, {y:g}), which no way leads to from the start ({start.x:g}, {start.y:g})"
            raise InputError(field, found, f"a place that a robot of radius {radius_m:g} m can drive to")


def connected(walls: Array, start: Array, goals: Array, radius_m: float) -> NDArray[np.bool_]:
    """(N,) whether a disc of `radius_m` may get from `start` (2,) to goals (N, 2) among walls (M, 2, 2), world frame.

    A gap that is narrower than the disc by a cell counts as one that it fits through.
    """
    places = np.vstack([start[None], goals])
    corners = np.concatenate([walls.reshape(-1, 2), places])
    low = corners.min(axis=0) - radius_m - 2.0 * _CELL_M
    shape = np.ceil((corners.max(axis=0) + radius_m + 2.0 * _CELL_M - low) / _CELL_M).astype(np.int64) + 1
    is_free = np.ones(tuple(shape), dtype=np.bool_)
    for first, last in walls:
        steps = math.ceil(2.0 * math.dist(first, last) / _CELL_M) + 1
        x, y = np.floor((np.linspace(first, last, steps) - low) / _CELL_M).astype(np.int64).T
        is_free[x, y] = False
    passable = distance_transform_edt(is_free) > radius_m / _CELL_M - _SLACK_CELLS
    parts, _ = label(passable, structure=np.ones((3, 3)))
    found = parts[tuple(np.floor((places - low) / _CELL_M).astype(np.int64).T)]
    return np.asarray((found[1:] == found[0]) | (found[0] == 0) | (found[1:] == 0))


def _check_building_in_reach(scene: Scene, start: Pose, range_m: float) -> None:
    """Raise InputError for a start outside the bounds of the walls and farther than `range_m` from all of them.

    A start within the bounds may see no wall, in a hall that is larger than the laser's range.
    """
    low, high = scene.walls.min(axis=(0, 1)), scene.walls.max(axis=(0, 1))
    place = np.array([start.x, start.y])
    distance_m = float(point_segment_distance(place, scene.walls).min())
    if distance_m > range_m and ((place < low) | (place > high)).any():
        raise InputError(
            "start",
            f"found ({start.x:g}, {start.y:g}), outside the building and {distance_m:.3g} m from its nearest wall",
            f"at most the laser's range {range_m:g} m",
        )

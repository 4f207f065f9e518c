"""A task in a scene: start, goals, the robot's radius and who is about."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.simulation.scene import FreeSpace, Scene, check_placement, load_scene
from sixthsense.simulation.walkers import Walkers, walkers_of
from sixthsense.simulation.world import World

_WORD_SHARE = 0.02
"""of a building: a part that cannot be reached and is larger is worth a word"""


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
    goal that no way leads to, and for more walkers than fit in.
    """
    if config.laser.mirrored:
        raise InputError("laser.mirrored", "found on a simulated robot", "on a log or a robot")
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
    goals = np.array(tour if goal is None else (goal,), dtype=np.float64).reshape(-1, 2)
    radius_m = config.robot.radius or scene.radius
    space = FreeSpace(scene, np.vstack([start.position[None], goals]), radius_m)
    for (x, y), is_connected in zip(goals, space.connected(start.position, goals), strict=True):
        if not is_connected:
            found = f"found ({x:g}, {y:g}), which no way leads to from the start ({start.x:g}, {start.y:g})"
            raise InputError(config.task, found, f"a place that a robot of radius {radius_m:g} m can drive to")
    return Mission(scene, start, goals, radius_m, walkers_of(scene, config, start, radius_m))


def unreachable(scene: Scene) -> str:
    """A line on what of a scene its robot cannot get to, because a door is too narrow; "" for none."""
    if scene.start is None:
        return ""
    goals = [("goal", scene.goal)] if scene.goal else []
    goals += [(f"tour, entry {k}", place) for k, place in enumerate(scene.tour, 1)]
    places = np.array([place for _, place in goals], dtype=np.float64).reshape(-1, 2)
    here = scene.start.position
    space = FreeSpace(scene, np.vstack([here[None], places]), scene.radius)
    is_there = space.connected(here, places)
    found = [name for (name, _), is_reached in zip(goals, is_there, strict=True) if not is_reached]
    if (share := space.closed_share(here)) > _WORD_SHARE:
        found.append(f"{share:.0%} of the rooms")
    return f"{', '.join(found)}: cannot be reached by a robot of {scene.radius:g} m" if found else ""


def with_people(scene: Scene, config: Config) -> Config:
    """The configuration of a robot that knows of people where any walk in the scene, unless it says otherwise."""
    if config.people is None and (scene.walkers or config.world.walkers):
        return config.replaced(people=True)
    return config

"""A task in a scene: start, goals, the robot's radius and who is about."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.simulation.scene import Scene, check_places, closed_off, load_scene, named_goals
from sixthsense.simulation.scene_files import in_radians, ordered
from sixthsense.simulation.walkers import Walkers
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
    """The mission in `config.scene`, which is `scene` if it is loaded already; and the configuration of its robot.

    The robot knows of people where any walk in the scene, unless the configuration says otherwise. Raises InputError
    for a scene that cannot be loaded; and, naming the field, for a place that is missing, outside the region or too
    close to a wall, for a goal that no way leads to, and for more walkers than fit in.
    """
    scene = scene or load_scene(config.scene, config.map_unknown)
    if config.laser.mirrored:
        raise InputError("laser.mirrored", "found on a simulated robot", "on a log or a robot")
    start, radius_m = placement(config, scene)
    goals = _goals(config, scene)
    check_places(scene, goals, radius_m, ordered(config.region or scene.region))
    places = np.array([*goals.values()], dtype=np.float64).reshape(-1, 2)
    is_closed, _ = closed_off(scene, start.position, places, radius_m)
    for where, (x, y) in itertools.compress(goals.items(), is_closed):
        found = f"found ({x:g}, {y:g}), which no way leads to from the start ({start.x:g}, {start.y:g})"
        raise InputError(where, found, f"a place that a robot of radius {radius_m:g} m can drive to")
    has_people = bool(scene.walkers or config.world.walkers)
    if config.people is None and has_people:
        config = config.replaced(people=True)
    walkers = Walkers(scene, config, start, radius_m) if has_people else None
    return config, Mission(scene, start, places, radius_m, walkers)


def placement(config: Config, scene: Scene) -> tuple[Pose, float]:
    """The robot's start and radius: those of the configuration, else of the scene.

    Raises InputError for a start that is missing, has a heading in degrees, or where the robot would touch a wall.
    """
    radius_m = config.robot.radius or scene.radius
    start = scene.start if config.start is None else Pose(*in_radians(config.start))
    if start is None:
        raise InputError("start", f"missing, the scene {scene.name} has none of its own", "x y theta")
    check_places(scene, {"start": (start.x, start.y)}, radius_m, scene.region)
    return start, radius_m


def _goals(config: Config, scene: Scene) -> dict[str, tuple[float, float]]:
    """The goals of the task by name; InputError for those of another task, and if there are none."""
    for task, stated in (("goal", config.goal), ("tour", config.tour)):
        if stated is not None and config.task != task:
            raise InputError(task, f"found with `task` {config.task}", f"with `task` {task}")
    if config.task == "explore":
        return {}
    goal, tour = config.goal or scene.goal, config.tour or scene.tour
    goals = named_goals(goal, ()) if config.task == "goal" else named_goals(None, tour)
    if not goals:
        raise InputError(config.task, f"missing, the scene {scene.name} has none of its own", "x y ...")
    return goals


def unreachable(scene: Scene) -> str:
    """A line on what of a scene its robot cannot get to, because a door is too narrow; "" for none."""
    if scene.start is None:
        return ""
    goals = named_goals(scene.goal, scene.tour)
    places = np.array([*goals.values()], dtype=np.float64).reshape(-1, 2)
    is_closed, share = closed_off(scene, scene.start.position, places, scene.radius)
    found = [*itertools.compress(goals, is_closed), *([f"{share:.0%} of the rooms"] if share > _WORD_SHARE else [])]
    return f"{', '.join(found)}: cannot be reached by a robot of {scene.radius:g} m" if found else ""

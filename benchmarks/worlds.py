"""Tours in worlds that no scene of this repository has: generated families, and plans that others drew.

Every seed is another world, or another tour of the same plan. The tour is a closed path through the free space of the
truth, a list of way points each of which the next can be reached from in a straight line. The robot finds its way from
one to the next with its own map.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from generated_worlds import FAMILIES, generated_world
from numpy.typing import NDArray
from runs import data_path
from scipy.ndimage import distance_transform_edt, label

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.ray_casting import cast_rays
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.shortcut import shortcut
from sixthsense.simulation.scene import Scene, load_scene
from sixthsense.slam.mapping.freespace import FreeSpace

_CELL_M = 0.05
_MARGINS_M = (0.12, 0.08, 0.05)
"""beside the robot's radius; the widest that leaves a tour is taken"""
_REACH_M = 200.0  # of a beam that leaves a building
_LEG_M = (3.0, 12.0)  # from goal to goal
_SHARE_OUT = 0.2
"""of the distance that the robot could drive in the time: the length of the tour's first half, on the way out"""


def world(name: str, seed: int, seconds: float, speed: float) -> Scene:
    """A scene with a start and a tour that takes about `seconds`: of a family, or read from a file.

    Raises InputError for a file that cannot be read or has no room for a tour.
    """
    scene = generated_world(name, seed) if name in FAMILIES else load_scene(name)
    rng = np.random.default_rng([seed, 1])
    radius = min(scene.radius, 0.2)
    for margin in _MARGINS_M:
        points = _tour(scene, radius + margin, _SHARE_OUT * seconds * speed, rng)
        if len(points) > 2:
            first, second = points[:2]
            start = Pose(*first, math.atan2(*(second - first)[::-1]))
            tour = tuple((float(x), float(y)) for x, y in [*points[1:-1], first])
            low, high = scene.solid.min(axis=(0, 1)) - 1.0, scene.solid.max(axis=(0, 1)) + 1.0
            return dataclasses.replace(scene, start=start, radius=radius, tour=tour, region=(*low, *high))
    raise InputError(name, "found no room for a tour", "free space that a robot can drive in")


def _tour(scene: Scene, clearance_m: float, out_m: float, rng: np.random.Generator) -> Array:
    """(K, 2) way points of a closed tour, the first repeated at the end; (0, 2) if there is none."""
    space = _free_space(scene, clearance_m)
    inside = _inside(space, scene, rng)
    free = np.argwhere(inside)
    if len(free) < 100:
        return np.zeros((0, 2))
    planner = AStar()
    goals = [space.centre(*_any(free, rng)) if scene.start is None else scene.start.position]
    paths: list[Array] = []
    driven = 0.0
    for _ in range(200):
        goal = space.centre(*_any(free, rng))
        if not _LEG_M[0] <= float(np.linalg.norm(goal - goals[-1])) <= _LEG_M[1]:
            continue
        plan = planner.plan(space, goals[-1], goal)
        if plan.found and plan.cost <= 2.0 * out_m:
            paths.append(shortcut(space, plan.path_world))
            goals.append(goal)
            driven += plan.cost
        if driven >= out_m:
            break
    if not paths:
        return np.zeros((0, 2))
    back = planner.plan(space, goals[-1], goals[0])
    return np.concatenate([p[:-1] for p in paths] + [shortcut(space, back.path_world)])


def _any(cells: NDArray[np.int64], rng: np.random.Generator) -> tuple[int, int]:
    row, col = cells[rng.integers(len(cells))].tolist()
    return row, col


def _free_space(scene: Scene, clearance_m: float) -> FreeSpace:
    """The cells whose centre is farther than `clearance_m` from all that is solid."""
    solid = scene.solid
    origin = solid.min(axis=(0, 1)) - 1.0
    height, width = np.ceil((solid.max(axis=(0, 1)) + 1.0 - origin) / _CELL_M).astype(int)[::-1].tolist()
    away = distance_transform_edt(~occupied(solid, origin, _CELL_M, (height, width))) * _CELL_M
    blocked = away <= clearance_m + 0.5 * _CELL_M
    return FreeSpace(blocked, ~blocked, (float(origin[0]), float(origin[1])), _CELL_M)


def occupied(walls: Array, origin: Array, cell_m: float, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(H, W) the cells on the walls (N, 2, 2), of a grid whose first corner is `origin` (2,)."""
    cells = np.zeros(shape, dtype=np.bool_)
    for a, b in walls:
        steps = np.linspace(0.0, 1.0, 2 + math.ceil(float(np.linalg.norm(b - a)) / (0.5 * cell_m)))
        cols, rows = np.floor((a + steps[:, None] * (b - a) - origin) / cell_m).astype(np.int64).T
        inside = (rows >= 0) & (rows < shape[0]) & (cols >= 0) & (cols < shape[1])
        cells[rows[inside], cols[inside]] = True
    return cells


def _inside(space: FreeSpace, scene: Scene, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(H, W) the connected free cells that hold the start; without one, those where beams end, most of them.

    A map has free cells outside the building and in its solids. From outside beams get away. The largest connected part
    that is inside is taken.
    """
    parts, count = label(~space.blocked)
    if scene.start is not None:
        return np.asarray(parts == parts[space.cell_of(scene.start.position)])
    sizes = np.bincount(parts.ravel())
    bearings = np.linspace(-math.pi, math.pi, 180, endpoint=False)
    best, score = np.zeros_like(parts, dtype=bool), 0.0
    for part in np.argsort(-sizes[1:])[:4] + 1 if count else ():
        cells = np.argwhere(parts == part)
        poses = [Pose(*space.centre(*_any(cells, rng))) for _ in range(40)]
        closed = [np.isfinite(cast_rays(pose, bearings, scene.solid, _REACH_M)).mean() for pose in poses]
        if (found := float(np.mean(closed)) ** 8 * len(cells)) > score and _in_free(poses, scene) > 0.5:
            best, score = np.asarray(parts == part), found
    return best


def _in_free(poses: Sequence[Pose], scene: Scene) -> float:
    """Share of the poses that are not inside a solid of a map, whose outlines have the solid on their left."""
    if not scene.solid_left:
        return 1.0
    outside = 0
    for pose in poses:
        off = scene.walls.mean(axis=1) - pose.position
        along = scene.walls[:, 1] - scene.walls[:, 0]
        nearest = int(np.argmin(np.hypot(*off.T)))
        outside += bool(along[nearest, 0] * -off[nearest, 1] - along[nearest, 1] * -off[nearest, 0] < 0.0)
    return outside / len(poses)


def plan(name: str) -> str:
    """The file of a plan."""
    return str(data_path(f"plans/{name}.yaml"))

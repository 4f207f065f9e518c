"""Scenes: the walls of a building, the start, the goals and the region of interest. Metres, world frame.

Two formats are read: TOML (walls and polygons, the format of the shipped scenes) and a ROS map (map_server's `.yaml`
with an image).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from sixthsense.config.errors import InputError
from sixthsense.config.sections import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.simulation.scene_files import (
    Point,
    Region,
    ScriptedWalk,
    in_radians,
    ordered,
    read_scene,
    scene_file,
    shipped_scenes,
)
from sixthsense.simulation.scene_grid import Bools, SceneGrid

__all__ = ["InputError", "Scene", "check_placement", "load_scene", "shipped_scenes"]

BODY_M = 0.25
"""radius of the disc that a person's body is"""
_WALKING_CELL_M = 0.1
_MOST_WALKING_CELLS = 25_000_000
_FINEST_M, _MOST_CELLS = 0.02, 5_000_000
"""of the grid in which places are checked: in a large scene its cells are larger"""
_NO_GLASS = np.zeros((0, 2, 2))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Scene:
    """A building with the start and goals of a robot, in metres and radians, world frame."""

    name: str
    """Name of the shipped scene, or of the file without its suffix."""
    walls: Array
    """(N, 2, 2) segments by their two ends; read-only."""
    start: Pose | None
    """`T_world_robot` at the start; None if the file has none (a ROS map)."""
    radius: float
    """Radius of the robot, a disc."""
    goal: Point | None
    """x, y of the goal of the goal task, if the file has one."""
    tour: tuple[Point, ...]
    """Goals of the tour task, visited in this order again and again."""
    region: Region
    """x0, y0, x1, y1 of the region of interest."""
    solid_left: bool = False
    """Whether walls are closed outlines with the solid on their left (a ROS map), so that a point can lie inside."""
    glass: Array = field(default_factory=lambda: _NO_GLASS)
    """(G, 2, 2) segments that stop the robot and return no beam; read-only."""
    walkers: tuple[ScriptedWalk, ...] = ()
    """Walks of people that the file states."""
    notes: tuple[str, ...] = ()
    """what a user should know of the file, a line each"""

    def __post_init__(self) -> None:
        for name, least in (("walls", 1), ("glass", 0)):
            segments = np.array(getattr(self, name), dtype=np.float64)
            if segments.ndim != 3 or segments.shape[1:] != (2, 2) or len(segments) < least:
                raise InputError(name, f"expected shape (N, 2, 2) with N >= {least}, got {segments.shape}")
            segments.flags.writeable = False
            object.__setattr__(self, name, segments)

    @property
    def solid(self) -> Array:
        """(N + G, 2, 2) walls and glass: all that stops the robot."""
        return np.concatenate([self.walls, self.glass])

    def summary(self) -> str:
        """Name, size and number of walls in a line."""
        x0, y0, x1, y1 = self.region
        parts = [f"{x1 - x0:.3g} x {y1 - y0:.3g} m", f"{len(self.walls):,d} walls"]
        counts = {"of glass": len(self.glass), "goals on the tour": len(self.tour), "walking": len(self.walkers)}
        parts += [f"{count} {what}" for what, count in counts.items() if count]
        return f"{self.name}: {', '.join(parts)}"

    def __repr__(self) -> str:
        return f"<Scene {self.summary()}>"


def load_scene(name_or_file: str | Path, map_unknown: Literal["wall", "free"] = "wall") -> Scene:
    """Read a shipped scene by its name, or a `.toml` or map_server `.yaml` file.

    `map_unknown` is what the unknown cells of a map_server map are.

    Raises InputError, one line, for an unknown name (with the known ones), and for a field that is missing, misspelt,
    not finite, or places the robot in a wall or outside the region.
    """
    path = scene_file(name_or_file)
    try:
        if path.suffix.lower() == ".toml":
            return _stated(path)
        from sixthsense.simulation.ros_map import read_map

        walls, notes = read_map(path, map_unknown)
        bounds = _bounds(walls)
        return Scene(path.stem, walls, None, DEFAULT_ROBOT_RADIUS_M, None, (), bounds, solid_left=True, notes=notes)
    except InputError as error:
        raise error.within(path) from None


def check_placement(
    scene: Scene,
    start: Pose | tuple[float, float, float] | None = None,
    goal: Point | None = None,
    region: Region | None = None,
    radius: float = 0.0,
    tour: Sequence[Point] = (),
) -> Pose:
    """Check a start, a goal and a tour against the walls of a loaded scene, and return the start.

    `start` (x, y, theta), `region` (x0, y0, x1, y1) and `radius` default to those of the scene (None, None, 0);
    `goal` (x, y) and `tour` are checked only if given. Metres, world frame. Raises InputError, one line naming the
    field, for a missing start, a heading in degrees, a place where the disc of `radius` touches a wall, a goal outside
    the region, and a region with reversed corners.
    """
    radius, bounds = radius or scene.radius, ordered(region or scene.region)
    start = scene.start if start is None else start
    if start is None:
        raise InputError("start", f"missing, the scene {scene.name} has none of its own", "x y theta")
    if not isinstance(start, Pose):
        try:
            start = Pose(*in_radians(start))
        except InputError as error:
            raise error.at("start") from None
    _check_clear("start", (start.x, start.y), scene, radius)
    goals = [] if goal is None else [("goal", goal)]
    for where, place in [*goals, *((f"tour, entry {k}", place) for k, place in enumerate(tour, 1))]:
        _check_inside(where, place, bounds)
        _check_clear(where, place, scene, radius)
    return start


class FreeSpace:
    """Where a disc can be in a scene."""

    def __init__(self, scene: Scene, places: Array, radius_m: float) -> None:
        """Among walls and glass, in an area that holds them and `places` (N, 2)."""
        corners = np.concatenate([scene.solid.reshape(-1, 2), places])
        low, high = corners.min(axis=0), corners.max(axis=0)
        sides = high - low + 2.0 * radius_m
        # A long and thin area has cells in its margins above all.
        cell_m = max(_FINEST_M, math.sqrt(float(np.prod(sides)) / _MOST_CELLS), 8.0 * float(sides.max()) / _MOST_CELLS)
        margin = radius_m + 2.0 * cell_m
        self.radius_m = radius_m
        self.grid = SceneGrid(scene.solid, low - margin, high + margin, cell_m, margin)
        # A disc is nowhere farther from a cell's centre than half a diagonal: all ways that there are lead over these.
        self.passable: Bools = self.grid.clearance_m > radius_m - cell_m * math.sqrt(0.5)

    def connected(self, start: Array, goals: Array) -> Bools:
        """(N,) whether the disc may get from `start` (2,) to goals (N, 2)."""
        return np.asarray(self.grid.at(self.grid.reachable(self.passable, start), goals), dtype=np.bool_)

    def closed_share(self, start: Array) -> float:
        """Share of the places where the disc fits that it cannot get to from `start` (2,), while a point could."""
        is_open = self.grid.reachable(self.grid.clearance_m > 0.75 * self.grid.cell_m, start) & self.passable
        own = self.grid.reachable(self.passable, start)
        return float(1.0 - own[is_open].mean()) if is_open.any() else 0.0


def walking_grid(scene: Scene) -> tuple[SceneGrid, Bools]:
    """The grid of the region in which people walk, and (H, W) the cells in whose centres a body fits."""
    x0, y0, x1, y1 = scene.region
    cell_m = max(_WALKING_CELL_M, math.sqrt((x1 - x0) * (y1 - y0) / _MOST_WALKING_CELLS))
    grid = SceneGrid(scene.solid, np.array([x0, y0]), np.array([x1, y1]), cell_m, BODY_M + cell_m)
    return grid, grid.clearance_m >= BODY_M


def _stated(path: Path) -> Scene:
    """The scene of a `.toml` file."""
    stated = read_scene(path)
    walls = [*stated.walls, *itertools.chain(*(polygon.walls() for polygon in stated.polygons))]
    if not walls:
        raise InputError("walls", "found none", "at least one wall or polygon")
    segments = np.array(walls).reshape(-1, 2, 2)
    scene = Scene(
        path.stem,
        segments,
        Pose(*stated.start),
        stated.radius,
        stated.goal,
        stated.tour,
        ordered(stated.region or _bounds(segments)),
        glass=np.array(stated.glass).reshape(-1, 2, 2),
        walkers=stated.walkers,
    )
    _check_inside("start", stated.start[:2], scene.region)
    check_placement(scene, goal=scene.goal, tour=scene.tour)
    _check_walks(scene)
    return scene


def _check_walks(scene: Scene) -> None:
    """Raise InputError for a way point in a wall or outside the region, and for two between which no way leads."""
    if not scene.walkers:
        return
    grid, free = walking_grid(scene)
    for k, walk in enumerate(scene.walkers, 1):
        points = np.array(walk.points)
        around = grid.reachable(free, points[0])
        for number, (x, y) in enumerate(walk.points, 1):
            where, found = f"walkers, entry {k}, point {number}", f"found ({x:g}, {y:g}),"
            if not grid.at(free, np.array([x, y])):
                allowed = f"a place with room for a body of {BODY_M:g} m"
                raise InputError(where, f"{found} in a wall or outside the region", allowed)
            if not grid.at(around, np.array([x, y])):
                raise InputError(where, f"{found} to which no way leads from the first", "points that ways join")


def _bounds(walls: Array) -> Region:
    low, high = walls.min(axis=(0, 1)), walls.max(axis=(0, 1))
    if not (low < high).all():
        raise InputError("walls", "all on one line", "walls that bound an area, or a region")
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _check_inside(where: str, point: Point, region: Region) -> None:
    (x, y), (x0, y0, x1, y1) = point, region
    if not (x0 <= x <= x1 and y0 <= y <= y1):
        raise InputError(where, f"found ({x:g}, {y:g}), outside the region", f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g}")


def _check_clear(where: str, point: Point, scene: Scene, radius: float) -> None:
    """Raise InputError for a place in a wall or too near to one."""
    place = np.array(point, dtype=np.float64)
    distance = float(point_segment_distance(place, scene.solid).min())
    is_inside = _is_in_wall(place, scene)
    if distance > radius * (1.0 + 1e-9) and not is_inside:
        return
    found = f"found ({point[0]:g}, {point[1]:g}), {distance:.3g} m from a wall"
    allowed = f"more than the robot's radius {radius:g} m"
    if is_inside:
        found, allowed = f"found ({point[0]:g}, {point[1]:g}), inside a wall, {distance:.3g} m deep", "a free place"
    raise InputError(where, found, allowed)


def _is_in_wall(place: Array, scene: Scene) -> bool:
    """Whether a place (2,) lies inside the outlines of a scene whose walls have the solid on their left."""
    if not scene.solid_left:
        return False
    ends = scene.walls - place  # (N, 2, 2)
    cross = ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 0, 1] * ends[:, 1, 0]
    turns = np.arctan2(cross, np.einsum("ij,ij->i", ends[:, 0], ends[:, 1])).sum() / (2 * math.pi)
    return bool(turns > 0.5)

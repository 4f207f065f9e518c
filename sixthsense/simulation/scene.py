"""Scenes: the walls of a building, the start, the goals and the region of interest. Metres, world frame.

Two formats are read: TOML (walls and polygons, the format of the shipped scenes) and a ROS map (map_server's `.yaml`
with an image).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from sixthsense.config.errors import InputError
from sixthsense.config.files import read_table
from sixthsense.config.sections import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.simulation.scene_files import (
    Point,
    Region,
    SceneFile,
    ScriptedWalk,
    checked,
    in_radians,
    ordered,
    scene_file,
)
from sixthsense.simulation.scene_grid import Bools, SceneGrid

BODY_M = 0.25
"""radius of the disc that a person's body is"""
_WALKING_CELL_M, _FINEST_CELL_M = 0.1, 0.02
_MOST_WALLS = 50_000
"""every beam is compared with every wall"""


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
    glass: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))
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
            if len(segments) > _MOST_WALLS:
                raise InputError(name, f"found {len(segments):,}", f"at most {_MOST_WALLS:,}")
            points = segments[(segments[:, 0] == segments[:, 1]).all(axis=1), 0]
            if len(points):
                found = f"found one of no length at ({points[0, 0]:g}, {points[0, 1]:g})"
                raise InputError(name, found, "two different ends")
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
    table = read_table(path) if path.suffix.lower() == ".toml" else None
    try:
        if table is not None:
            return _stated(path.stem, checked(SceneFile, table))
        from sixthsense.simulation.ros_map import read_map

        walls, notes = read_map(path, map_unknown)
        bounds = _bounds(walls)
        return Scene(path.stem, walls, None, DEFAULT_ROBOT_RADIUS_M, None, (), bounds, solid_left=True, notes=notes)
    except InputError as error:
        raise error.within(path) from None


def named_goals(goal: Point | None, tour: Sequence[Point]) -> dict[str, Point]:
    """A goal and those of a tour by their names in messages."""
    found = {} if goal is None else {"goal": goal}
    return found | {f"tour, entry {k}": place for k, place in enumerate(tour, 1)}


def check_places(scene: Scene, places: Mapping[str, Point], radius_m: float, region: Region | None = None) -> None:
    """Raise InputError for a place outside the region, and for one where a disc would touch a wall or be inside it.

    The error names the place, whose field in the configuration or file is its key.
    """
    x0, y0, x1, y1 = region or (-math.inf, -math.inf, math.inf, math.inf)
    for where, (x, y) in places.items():
        found = f"found ({x:g}, {y:g}),"
        if not (x0 <= x <= x1 and y0 <= y <= y1):
            raise InputError(where, f"{found} outside the region", f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g}")
        distance = float(point_segment_distance(np.array((x, y)), scene.solid).min())
        if _is_in_wall(np.array((x, y)), scene):
            raise InputError(where, f"{found} inside a wall, {distance:.3g} m deep", "a free place")
        if distance <= radius_m:
            found = f"{found} {distance:.3g} m from a wall"
            raise InputError(where, found, f"more than the robot's radius {radius_m:g} m")


def closed_off(scene: Scene, start: Array, places: Array, radius_m: float) -> tuple[Bools, float]:
    """(N,) to which of the places (N, 2) no way leads from `start` (2,) for a disc, and to which share of the rooms.

    The share is that of the area where the disc fits and to which a way leads for a point.
    """
    corners, margin_m = np.concatenate([scene.solid.reshape(-1, 2), start[None], places]), radius_m + 2 * _FINEST_CELL_M
    low, high = corners.min(axis=0) - margin_m, corners.max(axis=0) + margin_m
    grid = SceneGrid(scene.solid, low, high, _FINEST_CELL_M, margin_m)
    # A disc is nowhere farther from a cell's centre than half a diagonal: all ways that there are lead over these.
    fits = grid.clearance_m > radius_m - grid.cell_m * math.sqrt(0.5)
    reached = grid.reachable(fits, start)
    is_room = fits & grid.reachable(grid.clearance_m > 0.75 * grid.cell_m, start)
    return ~grid.at(reached, places), float(1.0 - reached[is_room].mean()) if is_room.any() else 0.0


def walking_grid(scene: Scene) -> tuple[SceneGrid, Bools]:
    """The grid of the region in which people walk, and (H, W) the cells in whose centres a body fits."""
    low, high = np.array(scene.region).reshape(2, 2)
    grid = SceneGrid(scene.solid, low, high, _WALKING_CELL_M, 2.0 * BODY_M)
    return grid, grid.clearance_m >= BODY_M


def _stated(name: str, file: SceneFile) -> Scene:
    """The scene of a `.toml` file."""
    walls, glass = (np.array(rows, dtype=np.float64).reshape(-1, 2, 2) for rows in (file.segments(), file.glass))
    if not len(walls):
        raise InputError("walls", "found none", "at least one wall or polygon")
    region, start = ordered(file.region or _bounds(walls)), Pose(*in_radians(file.start))
    scene = Scene(name, walls, start, file.radius, file.goal, file.tour, region, glass=glass, walkers=file.walkers)
    places = {"start": (start.x, start.y), **named_goals(scene.goal, scene.tour)}
    check_places(scene, places, scene.radius, region)
    if scene.walkers:
        _check_walks(scene)
    return scene


def _check_walks(scene: Scene) -> None:
    """Raise InputError for a way point to which nobody can walk from the first one of the walk."""
    grid, free = walking_grid(scene)
    for k, walk in enumerate(scene.walkers, 1):
        reached = grid.at(grid.reachable(free, np.array(walk.points[0])), np.array(walk.points))
        for number in np.flatnonzero(~reached).tolist():
            found = "found ({:g}, {:g}), to which no way leads from the first".format(*walk.points[number])
            allowed = f"a place in the region with room for a body of {BODY_M:g} m"
            raise InputError(f"walkers, entry {k}, point {number + 1}", found, allowed)


def _bounds(walls: Array) -> Region:
    low, high = walls.min(axis=(0, 1)), walls.max(axis=(0, 1))
    if not (low < high).all():
        raise InputError("walls", "all on one line", "walls that bound an area, or a region")
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _is_in_wall(place: Array, scene: Scene) -> bool:
    """Whether a place (2,) lies inside the outlines of a scene whose walls have the solid on their left."""
    ends = scene.walls - place  # (N, 2, 2)
    cross = ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 0, 1] * ends[:, 1, 0]
    turns = np.arctan2(cross, np.einsum("ij,ij->i", ends[:, 0], ends[:, 1])).sum() / (2.0 * math.pi)
    return bool(scene.solid_left and turns > 0.5)

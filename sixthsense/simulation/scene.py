"""Scenes: the walls of a building, the start, the goals and the region of interest. Metres, world frame.

Three formats are read: TOML (walls and polygons, the format of the shipped scenes), a ROS map (map_server's
`.yaml` with an image) and the report's `.scn`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sixthsense.config.errors import InputError
from sixthsense.config.files import parse_toml
from sixthsense.config.sections import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.simulation.scene_files import (
    Point,
    Region,
    check_count,
    check_keys,
    read_each,
    read_floats,
    read_numbers,
    read_point,
    read_polygon,
    read_positive,
    read_region,
    read_section,
    read_text,
    read_wall,
    scene_file,
    shipped_scenes,
)
from sixthsense.simulation.walking_space import ScriptedWalk, check_walks, read_walks

if TYPE_CHECKING:
    from sixthsense.core.picture import Picture

__all__ = ["InputError", "Scene", "check_placement", "load_scene", "shipped_scenes"]

_SCENE_KEYS = ("start", "radius", "goal", "tour", "region", "walls", "polygons", "glass", "campus", "walkers")
_OTHER_LISTS = 2_000  # at most, of a scene's tour, polygons, glass and comments
_WIDTH_IN, _FRAME_IN = 8.0, 1.0  # of the picture, and the height of its title, axis label and legend
_WALL, _GLASS, _GOAL, _ROBOT, _WALKER = "#4D4D4D", "#56B4E9", "#009E73", "#0072B2", "#882255"
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
        walls = np.array(self.walls, dtype=np.float64)
        if walls.ndim != 3 or walls.shape[1:] != (2, 2) or len(walls) == 0:
            raise InputError("walls", f"expected shape (N, 2, 2) with N > 0, got {walls.shape}")
        glass = np.array(self.glass, dtype=np.float64)
        if glass.ndim != 3 or glass.shape[1:] != (2, 2):
            raise InputError("glass", f"expected shape (G, 2, 2), got {glass.shape}")
        for name, segments in (("walls", walls), ("glass", glass)):
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

    def plot(self) -> Picture:
        """A picture of the scene: walls, glass, region, the robot at its start, goals and walkers."""
        return _picture(self)


def load_scene(name_or_file: str | Path, map_unknown: Literal["wall", "free"] = "wall") -> Scene:
    """Read a shipped scene by its name, or a `.toml`, map_server `.yaml` or report `.scn` file.

    `map_unknown` is what the unknown cells of a map_server map are.

    Raises InputError, one line, for an unknown name (with the known ones), and for a field that is missing, misspelt,
    not finite, or places the robot in a wall or outside the region.
    """
    path = scene_file(name_or_file)
    suffix = path.suffix.lower()
    try:
        if suffix == ".toml":
            return _from_toml(path)
        if suffix == ".scn":
            return _from_scn(path)
        from sixthsense.simulation.ros_map import read_map

        walls, notes = read_map(path, map_unknown)
        bounds = _bounds(walls)
        return Scene(path.stem, walls, None, DEFAULT_ROBOT_RADIUS_M, None, (), bounds, solid_left=True, notes=notes)
    except InputError as error:
        raise error.within(path) from None


def check_placement(
    scene: Scene,
    start: Pose | Sequence[float] | None = None,
    goal: Sequence[float] | None = None,
    region: Sequence[float] | None = None,
    radius: float = 0.0,
    tour: Sequence[Sequence[float]] = (),
) -> Pose:
    """Check a start, a goal and a tour against the walls of a loaded scene, and return the start.

    `start` (x, y, theta), `region` (x0, y0, x1, y1) and `radius` default to those of the scene (None, None, 0);
    `goal` (x, y) and `tour` are checked only if given. Metres, world frame. Raises InputError, one line naming the
    field, for a missing start, a place where the disc of `radius` touches a wall, a goal outside the region, a region
    with reversed corners, a radius that is not positive, and numbers that are not finite.
    """
    radius = read_positive("radius", radius) if radius else scene.radius
    bounds = scene.region if region is None else read_region("region", region)
    if start is None:
        start = scene.start
    if start is None:
        raise InputError("start", f"missing, the scene {scene.name} has none of its own", "x y theta")
    values = (start.x, start.y, start.theta) if isinstance(start, Pose) else start
    x, y, theta = read_numbers("start", values, "x y theta")
    _check_heading("start", theta)
    _check_clear("start", (x, y), scene, radius)
    goals = [] if goal is None else [("goal", goal)]
    goals += [(f"tour, entry {k}", place) for k, place in enumerate(tour, 1)]
    for where, found in goals:
        place = read_point(where, found)
        _check_inside(where, place, bounds)
        _check_clear(where, place, scene, radius)
    return start if isinstance(start, Pose) else Pose(x, y, theta)


def _from_toml(path: Path) -> Scene:
    text = read_text(path)
    check_count("walls", text.count("[") - _OTHER_LISTS)  # before they are parsed, which takes 10 s for 200,000
    try:
        table = parse_toml(text)
    except ValueError as error:
        raise InputError("", str(error)) from None
    check_keys("", table, _SCENE_KEYS, ("start", "radius"))
    segments = read_each("walls", table.get("walls", []), read_wall)
    segments += itertools.chain(*read_each("polygons", table.get("polygons", []), read_polygon))
    if "campus" in table:
        from sixthsense.simulation.campus import Campus, campus_walls

        segments += campus_walls(read_section("campus", table["campus"], Campus)).tolist()
    if not segments:
        raise InputError("walls", "found none", "at least one wall, polygon or campus")
    walls, glass = np.array(segments), read_each("glass", table.get("glass", []), read_wall)
    region = read_region("region", table["region"]) if "region" in table else _bounds(walls)
    tour = tuple(read_each("tour", table.get("tour", []), read_point))
    goal = read_point("goal", table["goal"]) if "goal" in table else None
    x, y, theta = read_numbers("start", table["start"], "x y theta")
    _check_heading("start", theta)
    start = Pose(x, y, theta)
    scene = Scene(
        path.stem,
        walls,
        start,
        read_positive("radius", table["radius"]),
        goal,
        tour,
        region,
        glass=np.array(glass).reshape(-1, 2, 2),
        walkers=read_walks(table.get("walkers", [])),
    )
    _check_inside("start", (start.x, start.y), region)
    check_placement(scene, goal=goal, tour=tour)
    check_walks(scene.walkers, scene.solid, region)
    return scene


def _from_scn(path: Path) -> Scene:
    rows = [(k, line.split()) for k, line in enumerate(read_text(path).splitlines(), 1) if line.strip()]
    if not rows:
        raise InputError("line 1", "missing", "x y theta radius")
    number, words = rows[0]
    x, y, theta, radius = read_numbers(f"line {number}", read_floats(words), "x y theta radius")
    check_count("walls", len(rows) - 1)
    if len(rows) == 1:
        raise InputError(f"line {number + 1}", "missing", "at least one wall x1 y1 x2 y2")
    walls = np.array([read_wall(f"line {number}", read_floats(words)) for number, words in rows[1:]])
    radius = read_positive(f"line {number}, radius", radius)
    scene = Scene(path.stem, walls, Pose(x, y, theta), radius, None, (), _bounds(walls))
    check_placement(scene)
    return scene


def _bounds(walls: Array) -> Region:
    low, high = walls.min(axis=(0, 1)), walls.max(axis=(0, 1))
    if not (low < high).all():
        raise InputError("walls", "all on one line", "walls that bound an area, or a region")
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _check_heading(where: str, theta: float) -> None:
    """Raise InputError for a heading that can only be degrees."""
    if abs(theta) > 2.0 * math.pi:
        raise InputError(where, f"found the heading {theta:g}", "radians, -6.28 to 6.28")


def _check_inside(where: str, point: Point, region: Region) -> None:
    (x, y), (x0, y0, x1, y1) = point, region
    if not (x0 <= x <= x1 and y0 <= y <= y1):
        raise InputError(where, f"found ({x:g}, {y:g}), outside the region", f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g}")


def _check_clear(where: str, point: Point, scene: Scene, radius: float) -> None:
    distance = float(point_segment_distance(np.array(point), scene.solid).min())
    found, allowed = f"found ({point[0]:g}, {point[1]:g}),", f"more than the robot's radius {radius:g} m"
    if distance <= radius * (1.0 + 1e-9):
        raise InputError(where, f"{found} {distance:.3g} m from a wall", allowed + _near(point, scene, radius))
    if _is_in_wall(point, scene):
        allowed = "a free place" + _near(point, scene, radius)
        raise InputError(where, f"{found} inside a wall, {distance:.3g} m deep", allowed)


def _is_in_wall(point: Point, scene: Scene) -> bool:
    """Whether a point lies inside the outlines of a scene whose walls have the solid on their left."""
    if not scene.solid_left:
        return False
    ends = scene.walls - np.array(point)  # (N, 2, 2)
    cross = ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 0, 1] * ends[:, 1, 0]
    turns = np.arctan2(cross, np.einsum("ij,ij->i", ends[:, 0], ends[:, 1])).sum() / (2 * math.pi)
    return bool(turns > 0.5)


def _near(point: Point, scene: Scene, radius: float) -> str:
    """The end of a message about a place that is not free: the nearest one that is."""
    from sixthsense.simulation.free_parts import FreeParts  # here, since most places are free

    place = np.array(point, dtype=np.float64)
    near = FreeParts(scene.solid, place[None], radius, is_coarse=True).nearest(place)
    return "" if near is None or _is_in_wall((near[0], near[1]), scene) else f", such as ({near[0]:.2f}, {near[1]:.2f})"


def _picture(scene: Scene) -> Picture:
    """The plan of a scene as a figure whose height follows from its shape."""
    from sixthsense.core.picture import Picture  # here, since a run draws no scene

    x0, y0, x1, y1 = scene.region
    figure = Picture(_WIDTH_IN, min(max(_WIDTH_IN * (y1 - y0) / (x1 - x0), 1.5), 11.0) + _FRAME_IN)
    ax = figure.add_subplot()
    _draw(ax, scene)
    figure.legend(loc="outside lower center", ncols=5, frameon=False)
    return figure


def _draw(ax: Any, scene: Scene) -> None:
    """Draw walls, glass, start, goal, tour, region and walkers of a scene on axes in metres, world frame."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Circle, Rectangle

    x0, y0, x1, y1 = scene.region
    style: dict[str, Any] = {"fill": False, "edgecolor": _GLASS, "linestyle": ":", "label": "region"}
    ax.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, **style))
    ax.add_collection(LineCollection(list(scene.walls), colors=_WALL, linewidths=1.5, label="walls"))
    if len(scene.glass):
        ax.add_collection(LineCollection(list(scene.glass), colors=_GLASS, linewidths=2.5, label="glass"))
    for k, walk in enumerate(scene.walkers):
        ax.plot(*zip(*walk.points, strict=True), "o--", color=_WALKER, markersize=3, label="" if k else "people")
    if scene.tour:
        ax.plot(*zip(*scene.tour, strict=True), "o", color=_GOAL, markersize=4, label="tour")
        for k, point in enumerate(scene.tour, 1):
            ax.annotate(str(k), point, xytext=(4, 4), textcoords="offset points", color=_GOAL, fontsize=8)
    if scene.goal is not None:
        ax.plot(*scene.goal, "*", color=_GOAL, markersize=11, label="goal")
    if (start := scene.start) is not None:
        ax.add_patch(Circle((start.x, start.y), scene.radius, fill=False, edgecolor=_ROBOT))
        ax.plot([], [], "o", color=_ROBOT, fillstyle="none", label="robot at its start")
        reach = 2.0 * scene.radius
        end = start.x + reach * math.cos(start.theta), start.y + reach * math.sin(start.theta)
        ax.annotate("", end, (start.x, start.y), arrowprops={"arrowstyle": "->", "color": _ROBOT})
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=scene.summary())

"""The planners on true maps: A* against Dijkstra, four ways of planning side by side, and replans in Willow Garage."""

from __future__ import annotations

import math
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from harness import Figures, arguments, print_figures, print_table, single_threaded, write_json
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from sixthsense.config import GridConfig, LaserConfig, RobotConfig, RRTStarConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.navigation.planners import Plan, make_planner
from sixthsense.navigation.planners.shortcut import path_is_free, shortcut
from sixthsense.slam.mapping.freespace import Bools, FreeSpace
from sixthsense.slam.mapping.grid import Grid
from sixthsense.sources.scene import Scene, SceneError, check_placement, load_scene

SCENES = ("apartment", "office", "loop")
WILLOW = "willow-2010-02-18-0.10"
WALLS_ABOVE = 0.196
"""occupied_thresh for Willow Garage's map: at its own, 0.65, its faint walls would not be any"""
LASER_M = 10.0
"""A new obstacle is seen this far ahead at most."""
OBSTACLE_M = 0.2
"""Radius of a new obstacle: a person's legs, a bin."""
REACH = {
    "optimality.worst_difference_m": "<= 1e-9",
    "all.rrtstar.ratio_median": "<= 1.03",
    "all.informed.ratio_median": "<= 1.03",
    "replan.ahead.ms_median": "<= 5",
    "replan.ahead.worst_difference_m": "<= 1e-9",
}


@dataclass(frozen=True)
class Question:
    """What every planner is asked."""

    start: Array
    """(2,) metres, world frame"""
    goal: Array
    """(2,) metres, world frame"""


@dataclass(frozen=True)
class TrueMap:
    """A scene's walls drawn into a grid, as the robot would have it after having seen them all."""

    space: FreeSpace
    """where the robot's centre may be"""
    cells: NDArray[np.int64]
    """(K, 2) row, col of the free cells that the robot can reach"""
    radius_m: float
    """of the robot and its clearance"""

    def questions(self, count: int, rng: np.random.Generator) -> list[Question]:
        """From anywhere to anywhere, centres of cells."""
        picks = self.cells[rng.integers(len(self.cells), size=(count, 2))].tolist()
        return [Question(self.space.centre(*a), self.space.centre(*b)) for a, b in picks]


def true_map(scene: Scene, cell_m: float = 0.05) -> TrueMap:
    """Draw a scene's walls; where it has no start of its own, reachable is the largest room."""
    config = GridConfig(cell_m=cell_m)
    grid = Grid(config, scene.radius)
    nothing = Scan.from_config(np.full(2, np.nan), LaserConfig(beams=2))
    grid.add(Pose(), nothing, scene.walls)
    space = grid.free_space()
    rooms, _ = ndimage.label(~space.blocked)
    if scene.start is not None:
        room = rooms[space.cell_of(scene.start.position)]
    else:
        sizes = np.bincount(rooms.ravel())
        sizes[0] = 0
        order = [room for room in np.argsort(sizes)[::-1] if sizes[room] > 0]
        room = next(room for room in order if _is_inside(scene, space, np.argwhere(rooms == room)))
    return TrueMap(space, np.argwhere(rooms == room), scene.radius + config.clearance_m)


def _is_inside(scene: Scene, space: FreeSpace, cells: NDArray[np.int64]) -> bool:
    """Whether a robot may stand in a room, given by its cells, and the room is not all that lies about the map."""
    x, y = space.centre(*cells[len(cells) // 2].tolist())
    try:
        check_placement(scene, (x, y, 0.0))
    except SceneError:
        return False
    return bool(cells.min() > 0 and (cells.max(axis=0) < np.array(space.blocked.shape) - 1).all())


def step_graph(blocked: Bools) -> sparse.csr_array:
    """The graph of steps between the cells of (H, W) `blocked`, flat; costs in cells, no corner cut."""
    height, width = blocked.shape
    index = np.arange(height * width).reshape(height, width)
    free = ~blocked
    tails, heads, costs = [], [], []
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        rows, rows_to = slice(0, height - down), slice(down, height)
        cols = slice(max(-across, 0), width - max(across, 0))
        cols_to = slice(max(across, 0), width - max(-across, 0))
        passable = free[rows, cols] & free[rows_to, cols_to] & free[rows, cols_to] & free[rows_to, cols]
        tails.append(index[rows, cols][passable])
        heads.append(index[rows_to, cols_to][passable])
        costs.append(np.full(np.count_nonzero(passable), math.hypot(down, across)))
    places = np.concatenate(tails), np.concatenate(heads)
    return sparse.coo_array((np.concatenate(costs), places), shape=(index.size, index.size)).tocsr()


def dijkstra(graph: sparse.csr_array, space: FreeSpace, source: Array) -> Array:
    """(H, W) costs, metres, from the cell of `source` to every other, by SciPy; inf where there is no way."""
    row, col = space.cell_of(source)
    costs = csgraph.dijkstra(graph, directed=False, indices=row * space.blocked.shape[1] + col)
    return np.asarray(costs).reshape(space.blocked.shape) * space.cell_m


def optimality_figures(maps: dict[str, TrueMap], sources: int, goals: int) -> Figures:
    """Largest difference of A*'s cost from Dijkstra's over `sources` starts with `goals` goals each, in every map."""
    rng = np.random.default_rng(1)
    worst, asked = 0.0, 0
    for drawn in maps.values():
        graph = step_graph(drawn.space.blocked)
        for _ in range(sources):
            start = drawn.questions(1, rng)[0].start
            costs = dijkstra(graph, drawn.space, start)
            for question in drawn.questions(goals, rng):
                plan = make_planner("astar").plan(drawn.space, start, question.goal)
                worst = max(worst, abs(plan.cost - float(costs[drawn.space.cell_of(question.goal)])))
                asked += 1
    return {"optimality.queries": asked, "optimality.worst_difference_m": worst}


def astar_shortcut(space: FreeSpace, start: Array, goal: Array) -> Plan:
    """A*, and of its path the way points that a straight line cannot do without."""
    plan = make_planner("astar").plan(space, start, goal)
    if not plan.found:
        return plan
    path, seconds = timed(lambda: shortcut(space, plan.path_world))
    return Plan.along(path, plan.expanded, plan.seconds + seconds)


def timed(function: Callable[[], Array]) -> tuple[Array, float]:
    """What a function returns, and the seconds it took."""
    began = time.perf_counter()
    value = function()
    return value, time.perf_counter() - began


def turns(path_world: Array) -> float:
    """Sum of the absolute heading changes along (N, 2) way points, radians."""
    steps = np.diff(path_world, axis=0)
    steps = steps[(steps != 0.0).any(axis=1)]
    return float(np.abs(wrap_angle(np.diff(np.arctan2(steps[:, 1], steps[:, 0])))).sum())


def comparison_figures(maps: dict[str, TrueMap], queries: int, config: RRTStarConfig) -> Figures:
    """Four ways of planning on the same `queries` questions a map: medians, and lengths relative to A* + shortcut.

    Drive time is that of a robot that turns on the spot at every way point, at the default robot's speeds.
    """
    robot = RobotConfig()
    plain = RRTStarConfig(False, config.iterations, config.range_m, config.goal_bias)
    ways: dict[str, Callable[[FreeSpace, Array, Array], Plan]] = {
        "astar": lambda *question: make_planner("astar").plan(*question),
        "astar_shortcut": astar_shortcut,
        "rrtstar": lambda *question: make_planner("rrtstar", plain).plan(*question),
        "informed": lambda *question: make_planner("rrtstar", config).plan(*question),
    }
    figures: Figures = {}
    everywhere: dict[str, list[list[float]]] = {name: [] for name in ways}
    missing = dict.fromkeys(ways, 0)
    for scene, drawn in maps.items():
        here: dict[str, list[list[float]]] = {name: [] for name in ways}
        gave_up = dict.fromkeys(ways, 0)
        for question in drawn.questions(queries, np.random.default_rng(2)):
            plans = {name: way(drawn.space, question.start, question.goal) for name, way in ways.items()}
            shortest = plans["astar_shortcut"].cost
            for name, plan in plans.items():
                if not plan.found:
                    gave_up[name] += 1
                    continue
                assert path_is_free(drawn.space, plan.path_world)
                turned = turns(plan.path_world)
                drive = turned / robot.turn_rate + plan.cost / robot.speed
                ratio = plan.cost / shortest if shortest > 0.0 else 1.0
                here[name].append([plan.cost, turned, drive, 1e3 * plan.seconds, ratio])
        for name in ways:
            figures |= _medians(f"{scene}.{name}", here[name], gave_up[name])
            everywhere[name] += here[name]
            missing[name] += gave_up[name]
    for name in ways:
        figures |= _medians(f"all.{name}", everywhere[name], missing[name])
    return figures


COLUMNS = ("length_m", "turns_rad", "drive_s", "plan_ms", "ratio")


def _medians(name: str, rows: list[list[float]], gave_up: int) -> Figures:
    """Medians over the plans found, the ratio's 90th percentile, and how many were not."""
    table = np.array(rows).reshape(-1, len(COLUMNS))
    figures: Figures = {f"{name}.gave_up": gave_up}
    if len(table):
        figures |= {f"{name}.{key}_median": float(np.median(table[:, k])) for k, key in enumerate(COLUMNS)}
        figures[f"{name}.ratio_p90"] = float(np.percentile(table[:, -1], 90))
    return figures


def comparison_rows(figures: Figures) -> list[list[str]]:
    """The table: a line per map and way of planning."""
    lines = [["map, planner", "gave up", *(f"{key}, median" for key in COLUMNS), "ratio, p90"]]
    for key in figures:
        name = key.removesuffix(".gave_up")
        if name == key:
            continue
        found = [figures.get(f"{name}.{column}_median", math.nan) for column in COLUMNS]
        found.append(figures.get(f"{name}.ratio_p90", math.nan))
        lines.append([name, f"{figures[key]:.0f}", *(f"{value:.3f}" for value in found)])
    return lines


def replan_figures(drawn: TrueMap, replans: int, checked: int) -> Figures:
    """Plans anew when one obstacle is seen on the path, ahead of a robot under way: A* with its memory, and without.

    ahead: at most `LASER_M` from the robot, as a laser sees it; anywhere: anywhere on the rest of the path. The first
    `checked` of each are compared with Dijkstra. cpu_ms leaves out the time that a busy machine gave to others.
    """
    figures: Figures = {}
    for where in ("ahead", "anywhere"):
        rng = np.random.default_rng(3)
        kept, cpu, scratch, scratch_cpu, first, found, worst = [], [], [], [], [], 0, 0.0
        while len(kept) < replans:
            question = drawn.questions(1, rng)[0]
            planner = make_planner("astar")
            plan = planner.plan(drawn.space, question.start, question.goal)
            path = plan.path_world
            along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
            if plan.cost < 3.0:
                continue
            here = rng.uniform(0.0, plan.cost - 2.0)
            reach = plan.cost - here - 1.0
            there = here + rng.uniform(1.0, max(1.0, min(reach, LASER_M) if where == "ahead" else reach))
            robot, obstacle = (path[np.searchsorted(along, way)] for way in (here, there))
            blocked = with_obstacle(drawn.space, obstacle, OBSTACLE_M + drawn.radius_m)
            space = FreeSpace(blocked, drawn.space.seen, drawn.space.origin, drawn.space.cell_m)
            if space.is_blocked(robot) or space.is_blocked(question.goal):
                continue
            began = time.thread_time()
            again = planner.plan(space, robot, question.goal)
            cpu.append(1e3 * (time.thread_time() - began))
            began = time.thread_time()
            anew = make_planner("astar").plan(space, robot, question.goal)
            scratch_cpu.append(1e3 * (time.thread_time() - began))
            if again.found != anew.found:
                worst = math.inf
            elif again.found:
                worst = max(worst, abs(again.cost - anew.cost))
            if again.found and len(kept) < checked:
                cost = dijkstra(step_graph(blocked), space, robot)[space.cell_of(question.goal)]
                worst = max(worst, abs(again.cost - float(cost)))
            found += again.found
            first.append(1e3 * plan.seconds)
            kept.append(1e3 * again.seconds)
            scratch.append(1e3 * anew.seconds)
        figures |= {
            f"replan.{where}.first_ms_median": float(np.median(first)),
            f"replan.{where}.ms_median": float(np.median(kept)),
            f"replan.{where}.ms_p90": float(np.percentile(kept, 90)),
            f"replan.{where}.ms_max": float(np.max(kept)),
            f"replan.{where}.cpu_ms_median": float(np.median(cpu)),
            f"replan.{where}.scratch_ms_median": float(np.median(scratch)),
            f"replan.{where}.scratch_ms_p90": float(np.percentile(scratch, 90)),
            f"replan.{where}.scratch_ms_max": float(np.max(scratch)),
            f"replan.{where}.scratch_cpu_ms_median": float(np.median(scratch_cpu)),
            f"replan.{where}.found_share": found / replans,
            f"replan.{where}.worst_difference_m": worst,
        }
    return figures


def with_obstacle(space: FreeSpace, centre: Array, radius_m: float) -> Bools:
    """The blocked cells, and those whose centres a disc about (2,) `centre` covers."""
    height, width = space.blocked.shape
    x = space.origin[0] + (np.arange(width) + 0.5) * space.cell_m - centre[0]
    y = space.origin[1] + (np.arange(height) + 0.5) * space.cell_m - centre[1]
    disc: Bools = np.hypot(x[None, :], y[:, None]) <= radius_m
    return space.blocked | disc


def willow(folder: Path) -> Scene:
    """Willow Garage's map among the data in `folder`, its walls taken for walls."""
    text = (folder / f"{WILLOW}.yaml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("image:", "occupied_thresh:"))]
    lines += [f"image: {(folder / f'{WILLOW}.pgm').resolve()}", f"occupied_thresh: {WALLS_ABOVE}"]
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "willow.yaml"
        file.write_text("\n".join(lines) + "\n")
        return load_scene(file)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--queries", type=int, default=67, metavar="N", help="questions in each of three scenes (67)")
    parser.add_argument("--iterations", type=int, default=RRTStarConfig().iterations, metavar="N", help="RRT*'s budget")
    parser.add_argument("--replans", type=int, default=200, metavar="N", help="replans in Willow Garage (200)")
    options = parser.parse_args()
    for name in ("queries", "iterations", "replans"):
        if getattr(options, name) < 1:
            parser.error(f"--{name}: found {getattr(options, name)}, allowed: at least 1")
    with single_threaded():
        maps = {name: true_map(load_scene(name)) for name in SCENES}
        figures = optimality_figures(maps, 17, 10)
        comparison = comparison_figures(maps, options.queries, RRTStarConfig(iterations=options.iterations))
        folder = Path(os.environ.get("SIXTHSENSE_DATA", "")) / "maps"
        if "SIXTHSENSE_DATA" in os.environ and (folder / f"{WILLOW}.yaml").is_file():
            figures |= replan_figures(true_map(willow(folder)), options.replans, 20)
        else:
            print("planning.py: no replans, SIXTHSENSE_DATA must be a folder with maps/", file=sys.stderr)
    print_table(comparison_rows(comparison))
    figures |= comparison
    print_figures({key: value for key, value in figures.items() if key in REACH or key not in comparison}, REACH)
    write_json(options.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The planners on true maps: A* against Dijkstra, four planners on the same queries, and replans in Willow Garage."""

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
from harness import Figures, arguments, check_at_least, print_figures, print_table, single_threaded, write_json
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
"""occupied_thresh for Willow Garage's map: its own value, 0.65, would miss its faint walls"""
LASER_M = 10.0
"""Largest distance ahead at which a new obstacle is seen."""
OBSTACLE_M = 0.2
"""Radius of a new obstacle, such as a person's legs or a bin."""
TARGETS = {
    "optimality.worst_difference_m": "<= 1e-9",
    "all.rrtstar.ratio_median": "<= 1.03",
    "all.informed.ratio_median": "<= 1.03",
    "replan.ahead.ms_median": "<= 5",
    "replan.ahead.worst_difference_m": "<= 1e-9",
}


@dataclass(frozen=True)
class Query:
    """Start and goal of a plan."""

    start: Array
    """(2,) metres, world frame"""
    goal: Array
    """(2,) metres, world frame"""


@dataclass(frozen=True)
class TrueMap:
    """A grid with all walls of a scene, as after a complete exploration without noise."""

    space: FreeSpace
    """free space of the robot's centre"""
    cells: NDArray[np.int64]
    """(K, 2) row, col of the cells that the robot can reach"""
    radius_m: float
    """radius of the robot plus clearance"""

    def queries(self, count: int, rng: np.random.Generator) -> list[Query]:
        """Queries between centres of random cells."""
        picks = self.cells[rng.integers(len(self.cells), size=(count, 2))].tolist()
        return [Query(self.space.centre(*a), self.space.centre(*b)) for a, b in picks]


def true_map(scene: Scene, cell_m: float = 0.05) -> TrueMap:
    """The true map of a scene; without a start in the scene, the reachable cells are those of the largest room."""
    config = GridConfig(cell_m=cell_m)
    grid = Grid(config, scene.radius)
    no_returns = Scan.from_config(np.full(2, np.nan), LaserConfig(beams=2))
    grid.add(Pose(), no_returns, scene.walls)
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
    """Whether a robot may stand in a room, given by its cells, and the room is not the outside of the building."""
    x, y = space.centre(*cells[len(cells) // 2].tolist())
    try:
        check_placement(scene, (x, y, 0.0))
    except SceneError:
        return False
    return bool(cells.min() > 0 and (cells.max(axis=0) < np.array(space.blocked.shape) - 1).all())


def step_graph(blocked: Bools) -> sparse.csr_array:
    """The graph of steps between the free cells of `blocked` (H, W), by flat index; costs in cells, no cut corners."""
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
    """(H, W) costs, metres, from the cell of `source` to every cell, by SciPy; inf where there is no path."""
    row, col = space.cell_of(source)
    costs = csgraph.dijkstra(graph, directed=False, indices=row * space.blocked.shape[1] + col)
    return np.asarray(costs).reshape(space.blocked.shape) * space.cell_m


def optimality_figures(maps: dict[str, TrueMap], sources: int, goals: int) -> Figures:
    """Largest difference between the costs of A* and Dijkstra, for `sources` starts with `goals` goals each per map."""
    rng = np.random.default_rng(1)
    worst, count = 0.0, 0
    for drawn in maps.values():
        graph = step_graph(drawn.space.blocked)
        for _ in range(sources):
            start = drawn.queries(1, rng)[0].start
            costs = dijkstra(graph, drawn.space, start)
            for query in drawn.queries(goals, rng):
                plan = make_planner("astar").plan(drawn.space, start, query.goal)
                worst = max(worst, abs(plan.cost - float(costs[drawn.space.cell_of(query.goal)])))
                count += 1
    return {"optimality.queries": count, "optimality.worst_difference_m": worst}


def astar_shortcut(space: FreeSpace, start: Array, goal: Array) -> Plan:
    """A* with its path shortcut to the necessary way points."""
    plan = make_planner("astar").plan(space, start, goal)
    if not plan.found:
        return plan
    path, seconds = timed(lambda: shortcut(space, plan.path_world))
    return Plan.along(path, plan.expanded, plan.seconds + seconds)


def timed(function: Callable[[], Array]) -> tuple[Array, float]:
    """The result of a function and the seconds it took."""
    began = time.perf_counter()
    value = function()
    return value, time.perf_counter() - began


def turns(path_world: Array) -> float:
    """Sum of the absolute heading changes along (N, 2) way points, radians."""
    steps = np.diff(path_world, axis=0)
    steps = steps[(steps != 0.0).any(axis=1)]
    return float(np.abs(wrap_angle(np.diff(np.arctan2(steps[:, 1], steps[:, 0])))).sum())


def comparison_figures(maps: dict[str, TrueMap], queries: int, config: RRTStarConfig) -> Figures:
    """Four planners on the same `queries` per map: medians, and lengths relative to A* with shortcut.

    The drive time is that of the default robot if it turns on the spot at every way point.
    """
    robot = RobotConfig()
    plain = RRTStarConfig(False, config.iterations, config.range_m, config.goal_bias)
    planners: dict[str, Callable[[FreeSpace, Array, Array], Plan]] = {
        "astar": lambda *query: make_planner("astar").plan(*query),
        "astar_shortcut": astar_shortcut,
        "rrtstar": lambda *query: make_planner("rrtstar", plain).plan(*query),
        "informed": lambda *query: make_planner("rrtstar", config).plan(*query),
    }
    figures: Figures = {}
    everywhere: dict[str, list[list[float]]] = {name: [] for name in planners}
    missing = dict.fromkeys(planners, 0)
    for scene, true in maps.items():
        here: dict[str, list[list[float]]] = {name: [] for name in planners}
        gave_up = dict.fromkeys(planners, 0)
        for query in true.queries(queries, np.random.default_rng(2)):
            plans = {name: plan(true.space, query.start, query.goal) for name, plan in planners.items()}
            shortest = plans["astar_shortcut"].cost
            for name, plan in plans.items():
                if not plan.found:
                    gave_up[name] += 1
                    continue
                assert path_is_free(true.space, plan.path_world)
                turned = turns(plan.path_world)
                drive = turned / robot.turn_rate + plan.cost / robot.speed
                ratio = plan.cost / shortest if shortest > 0.0 else 1.0
                here[name].append([plan.cost, turned, drive, 1e3 * plan.seconds, ratio])
        for name in planners:
            figures |= _medians(f"{scene}.{name}", here[name], gave_up[name])
            everywhere[name] += here[name]
            missing[name] += gave_up[name]
    for name in planners:
        figures |= _medians(f"all.{name}", everywhere[name], missing[name])
    return figures


COLUMNS = ("length_m", "turns_rad", "drive_s", "plan_ms", "ratio")


def _medians(name: str, rows: list[list[float]], gave_up: int) -> Figures:
    """Medians over the found plans, the 90th percentile of the ratio, and the number of failures."""
    table = np.array(rows).reshape(-1, len(COLUMNS))
    figures: Figures = {f"{name}.gave_up": gave_up}
    if len(table):
        figures |= {f"{name}.{key}_median": float(np.median(table[:, k])) for k, key in enumerate(COLUMNS)}
        figures[f"{name}.ratio_p90"] = float(np.percentile(table[:, -1], 90))
    return figures


def comparison_rows(figures: Figures) -> list[list[str]]:
    """The table: a row per map and planner."""
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
    """Times of replanning after a new obstacle appears on the rest of the path: incremental A*, and A* from scratch.

    ahead: the obstacle lies at most `LASER_M` from the robot; anywhere: anywhere on the rest of the path. The first
    `checked` replans of each are compared with Dijkstra. cpu_ms excludes the time of other processes.
    """
    figures: Figures = {}
    for where in ("ahead", "anywhere"):
        rng = np.random.default_rng(3)
        kept, cpu, scratch, scratch_cpu, first, found, worst = [], [], [], [], [], 0, 0.0
        while len(kept) < replans:
            query = drawn.queries(1, rng)[0]
            planner = make_planner("astar")
            plan = planner.plan(drawn.space, query.start, query.goal)
            path = plan.path_world
            along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
            if plan.cost < 3.0:
                continue
            here = rng.uniform(0.0, plan.cost - 2.0)
            rest = plan.cost - here - 1.0
            there = here + rng.uniform(1.0, max(1.0, min(rest, LASER_M) if where == "ahead" else rest))
            robot, obstacle = (path[np.searchsorted(along, way)] for way in (here, there))
            blocked = with_obstacle(drawn.space, obstacle, OBSTACLE_M + drawn.radius_m)
            space = FreeSpace(blocked, drawn.space.seen, drawn.space.origin, drawn.space.cell_m)
            if space.is_blocked(robot) or space.is_blocked(query.goal):
                continue
            began = time.thread_time()
            again = planner.plan(space, robot, query.goal)
            cpu.append(1e3 * (time.thread_time() - began))
            began = time.thread_time()
            anew = make_planner("astar").plan(space, robot, query.goal)
            scratch_cpu.append(1e3 * (time.thread_time() - began))
            if again.found != anew.found:
                worst = math.inf
            elif again.found:
                worst = max(worst, abs(again.cost - anew.cost))
            if again.found and len(kept) < checked:
                cost = dijkstra(step_graph(blocked), space, robot)[space.cell_of(query.goal)]
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
    """The blocked cells and those whose centres lie in a disc around `centre` (2,)."""
    height, width = space.blocked.shape
    x = space.origin[0] + (np.arange(width) + 0.5) * space.cell_m - centre[0]
    y = space.origin[1] + (np.arange(height) + 0.5) * space.cell_m - centre[1]
    disc: Bools = np.hypot(x[None, :], y[:, None]) <= radius_m
    return space.blocked | disc


def willow(folder: Path) -> Scene:
    """Willow Garage's map in the data folder `folder`, with its faint walls occupied."""
    text = (folder / f"{WILLOW}.yaml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("image:", "occupied_thresh:"))]
    lines += [f"image: {(folder / f'{WILLOW}.pgm').resolve()}", f"occupied_thresh: {WALLS_ABOVE}"]
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "willow.yaml"
        file.write_text("\n".join(lines) + "\n")
        return load_scene(file)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--queries", type=int, default=67, metavar="N", help="queries in each of three scenes (67)")
    parser.add_argument(
        "--iterations", type=int, default=RRTStarConfig().iterations, metavar="N", help="iterations of RRT*"
    )
    parser.add_argument("--replans", type=int, default=200, metavar="N", help="replans in Willow Garage (200)")
    options = parser.parse_args()
    check_at_least(parser, options, queries=1, iterations=1, replans=1)
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
    print_figures({key: value for key, value in figures.items() if key in TARGETS or key not in comparison}, TARGETS)
    write_json(options.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Large places: memory and time of a map of which little is seen, choosing a view on a large map, and explorations.

    python benchmarks/large_places.py                              # the map alone
    python benchmarks/large_places.py --plan willow.yaml 28.85 26.65 0 --plan stata.yaml -20.15 9.84 0

Times are of the processor. The dense grid that memory is compared with has the same cells in arrays over their box.
"""

from __future__ import annotations

import math
import resource
import time
from argparse import Namespace
from types import SimpleNamespace
from typing import Any

import numpy as np
from harness import Figures, arguments, machine, print_table, run, write_json

from sixthsense.config import Config, GridConfig, preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.ray_casting import cast_rays
from sixthsense.navigation.exploration_navigator import ExplorationNavigator
from sixthsense.navigation.follower import Follower
from sixthsense.navigation.planners import make_planner
from sixthsense.running.warmup import warm_up
from sixthsense.slam.mapping.evidence import Cells
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.restore import restore_grid

NO_WALLS = np.zeros((0, 2, 2))
REACH_M = 3.5  # what is seen to each side of the way across the large world
STEP_M = 0.5  # between two scans


def cell_bytes() -> int:
    """Memory of one cell, bytes."""
    return sum(cells.itemsize for cells in Cells.empty(1))


def scan_of_corridor(heading: float) -> Scan:
    """A scan in a straight corridor, the robot turned by `heading` against it."""
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    ranges = np.minimum(REACH_M / np.maximum(np.abs(np.sin(angles + heading)), 1e-9), 10.0)
    return Scan(
        np.where(ranges < 10.0, ranges, np.inf).astype(np.float32), np.float32(-np.pi), np.float32(np.pi / 180), 10.0
    )


def sparse_world(side_m: float) -> dict[str, float]:
    """A way across a square world, corner to corner: share seen, memory against the dense grid, and time of a scan."""
    config = GridConfig()
    count, heading = round(math.hypot(side_m, side_m) / STEP_M), 0.25 * math.pi
    scan = scan_of_corridor(0.0)
    large, times = Grid(config, 0.2), []
    for k in range(count):
        at = Pose(k * side_m / count, k * side_m / count, heading)
        began = time.process_time()
        large.add(at, scan, NO_WALLS)
        times.append(time.process_time() - began)
    small_times = []
    for _ in range(6):
        small = Grid(config, 0.2)
        for k in range(80):
            at = Pose(k * side_m / count, k * side_m / count, heading)
            began = time.process_time()
            small.add(at, scan, NO_WALLS)
            small_times.append(time.process_time() - began)
    seen = len(large.submap().cells)
    dense = (side_m / config.cell_m) ** 2
    return {
        "seen_share": seen / dense,
        "memory_share": large.cells_in_memory / dense,
        "memory_mb": large.cells_in_memory * cell_bytes() / 2**20,
        "add_ms": 1e3 * float(np.median(times[-400:])),
        "add_small_ms": 1e3 * float(np.median(small_times[80:])),
    }


def rooms(height: int, width: int, room: int = 120, door: int = 24) -> tuple[Array, Array, Array]:
    """Hits, passes and seen cells (H, W) of a building of square rooms with doors, of which the left half is seen."""
    hits, passes = np.zeros((height, width), dtype=np.int32), np.zeros((height, width), dtype=np.int32)
    for first in range(20, min(height, width // 2 * 2) - 20, room):
        hits[first : first + 2, 20:-20], hits[20:-20, first : first + 2] = 10, 10
    for first in range(20, width - 20, room):
        hits[20:-20, first : first + 2] = 10
    middle = slice((room - door) // 2, (room + door) // 2)
    for row in range(20, height - 20 - room, room):
        for col in range(20, width - 20 - room, room):
            hits[row + room : row + room + 2, col + middle.start : col + middle.stop] = 0
            hits[row + middle.start : row + middle.stop, col + room : col + room + 2] = 0
    seen = np.zeros((height, width), dtype=np.bool_)
    seen[22:-22, 22 : width // 2 + room // 3] = True
    hits[~seen & (np.arange(width) > width // 2 + room // 3)] = 0
    passes[seen & (hits == 0)] = 20
    return hits, passes, seen


def choice_of_view(height: int, width: int, repeats: int) -> dict[str, float]:
    """Processor time of a keyframe that changes little, and of one that chooses a view and plans the way to it."""
    config = Config()
    grid = restore_grid(config.grid, 0.2, (0.0, 0.0), *rooms(height, width))
    cell_m = config.grid.cell_m
    region = 1.0, 1.0, width * cell_m - 1.0, height * cell_m - 1.0
    home = Pose(4.0, 4.0, 0.0)
    follower, rng = Follower(config.follow, config.robot), np.random.default_rng(0)
    navigator = ExplorationNavigator(home, region, 0.2, make_planner("astar"), follower, config, rng)
    bearings = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    near = Scan(cast_rays(Pose(), bearings, NO_WALLS, 0.5), np.float32(-np.pi), np.float32(np.pi / 180), 0.5)
    looks, choices = [], []
    for k in range(repeats):
        pose = Pose(width * cell_m / 2 - 2.0 + 0.05 * k, 4.0, 0.0)
        grid.add(pose, near, NO_WALLS)
        estimate: Any = SimpleNamespace(pose=pose, pose_cov=np.diag([1e-4, 1e-4, 1e-5]))
        began = time.process_time()
        navigator.look(grid, estimate)
        looks.append(time.process_time() - began)
        exploration = navigator._exploration
        assert exploration is not None
        began = time.process_time()
        exploration._choose_view(pose)
        choices.append(time.process_time() - began)
    return {
        "cells": float(height * width),
        "look_ms": 1e3 * float(np.median(looks[2:])),
        "choice_ms": 1e3 * float(np.median(choices[2:])),
        "choice_max_ms": 1e3 * max(choices[2:]),
    }


def exploration(plan: list[str], max_time: float | None) -> dict[str, float]:
    """An exploration of a plan from a pose: coverage, travel, errors, times and peak memory."""
    scene, start = plan[0], [float(value) for value in plan[1:]]
    config = preset("default", scene=scene, start=start, task="explore", estimator="ekf-invariant", max_time=max_time)
    warm_up()
    began = time.process_time()
    measured = run(config)
    seconds = time.process_time() - began
    metrics = {key: float(value) for key, value in measured.metrics.items() if isinstance(value, int | float)}
    print(f"{scene}: {measured.metrics['outcome']}")
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return metrics | {"cpu_s": seconds, "cpu_share": seconds / metrics["sim_time_s"], "peak_mb": peak_mb}


COLUMNS = (
    "coverage", "path_length_m", "sim_time_s", "cpu_s", "ate_rmse_m", "pose_nees_world_mean", "home_error_m",
    "scan_ms_p50", "scan_ms_p99", "scan_ms_max", "peak_mb",
)  # fmt: skip


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--side", type=float, default=1000.0, help="side of the world of which little is seen, metres")
    parser.add_argument("--repeats", type=int, default=20, help="choices of a view")
    parser.add_argument("--plan", nargs=4, action="append", default=[], metavar=("FILE", "X", "Y", "THETA"))
    parser.add_argument("--max-time", type=float, help="of an exploration, simulated seconds")
    options: Namespace = parser.parse_args()
    figures: Figures = {}
    figures |= {f"sparse.{key}": value for key, value in sparse_world(options.side).items()}
    for height, width in ((484, 550), (1936, 2202)):
        found = choice_of_view(height, width, options.repeats)
        figures |= {f"view.{height}x{width}.{key}": value for key, value in found.items()}
    print(machine())
    print_table([["figure", "value"], *([key, f"{value:.4g}"] for key, value in figures.items())])
    for plan in options.plan:
        found = exploration(plan, options.max_time)
        print_table([["figure", "value"], *([key, f"{found[key]:.4g}"] for key in COLUMNS if key in found)])
        figures |= {f"explore.{plan[0]}.{key}": value for key, value in found.items()}
    write_json(options.json, figures)


if __name__ == "__main__":
    main()

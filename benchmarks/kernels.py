"""Speed of the hot loops beside their limits: ray casting, extraction, A*, scan insertion, and the EKF's update.

    python benchmarks/kernels.py                # `make bench`, 5 minutes
    python benchmarks/kernels.py --loop 5a5ab19  # whole runs instead, beside a commit; 10 minutes
    SIXTHSENSE_DATA=FOLDER python benchmarks/kernels.py --logs f1371fe  # logs, the first use, MRPT; 10 minutes

Ray casting and A* are compared with references, the EKF's update with one pass over its covariance (`ekf_scaling.py`).
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable

import numpy as np
from ekf_scaling import LIMITS as EKF_LIMITS
from ekf_scaling import scaling_figures
from harness import Figures, against_limits, alternate, arguments, finish, single_threaded
from log_speed import logs_tables
from loop_speed import loop_table
from numpy.typing import NDArray

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import beams_of, cast_among, cast_rays
from sixthsense.evaluation.coverage import visible_area
from sixthsense.navigation.gridsearch import cheapest_path
from sixthsense.simulation.scene import Scene, load_scene
from sixthsense.slam.features import extract
from sixthsense.slam.mapping.grid import Grid

LIMITS = {
    "raycast_speedup_numpy": ">= 12",
    "raycast_max_difference_m": "<= 1e-9",
    "extract_ms_p50": "<= 0.2",
    "astar_expansions_per_s": ">= 4e6",
    "astar_speedup_heapq": ">= 20",
    "astar_cost_difference": "<= 1e-6",
    **EKF_LIMITS,
}

SQRT2 = math.sqrt(2.0)


def free_poses(scene: Scene, count: int, rng: np.random.Generator) -> list[Pose]:
    """Random collision-free poses in the visible area of the scene."""
    assert scene.start is not None
    area = visible_area(scene.walls, scene.region, (scene.start.x, scene.start.y), scene.radius, 10.0)
    cells = np.argwhere(area.mask)
    poses: list[Pose] = []
    while len(poses) < count:
        row, col = cells[rng.integers(len(cells))] + rng.random(2)
        pose = Pose(area.origin[0] + col * area.cell_m, area.origin[1] + row * area.cell_m, rng.uniform(-np.pi, np.pi))
        if point_segment_distance(pose.position, scene.walls).min() > scene.radius:
            poses.append(pose)
    return poses


def noisy_scans(scene: Scene, poses: Iterable[Pose], rng: np.random.Generator) -> list[Scan]:
    """Scans with the noise of the default robot."""
    config = preset()
    bearings, laser = beam_bearings(config.laser), config.laser
    noise = config.world.laser.range_m
    clean = (cast_rays(pose, bearings, scene.walls, laser.max_range) for pose in poses)
    return [Scan.from_config(ranges + rng.normal(0.0, noise, len(ranges)), laser) for ranges in clean]


def cast_rays_numpy(T_world_laser: Pose, directions: Array, walls: Array, max_range: float) -> Array:
    """Vectorised reference: beams (2, N) of the laser against all walls in range, by Cramer's rule on (M, N)."""
    in_frame = T_world_laser.inverse() @ walls
    start, along = in_frame[:, 0], in_frame[:, 1] - in_frame[:, 0]
    s = np.clip(-(start * along).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
    nearest = start + s[:, None] * along
    near = (nearest * nearest).sum(axis=1) <= max_range**2
    start, along = start[near], along[near]
    across = start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / (np.stack([along[:, 1], -along[:, 0]], axis=1) @ directions)  # (M, N)
        t = across[:, None] * inverse
        u = (np.stack([-start[:, 1], start[:, 0]], axis=1) @ directions) * inverse
        t[~((t >= 0.0) & (np.abs(u - 0.5) <= 0.5 + 1e-9))] = np.inf
    ranges = np.min(t, axis=0, initial=np.inf)
    ranges[ranges >= max_range] = np.inf
    return np.asarray(ranges)


def cast_rays_plain(T_world_laser: Pose, bearings: Array, walls: Array, max_range: float) -> Array:
    """Plain reference: one beam and one wall at a time, in the frame of the beam, which is its x axis."""
    ranges = np.full(len(bearings), np.inf)
    for i, bearing in enumerate(bearings):
        inverse = (T_world_laser @ Pose(theta=bearing)).inverse()
        for (ax, ay), (bx, by) in (inverse @ walls).tolist():
            if (ay > 0.0) != (by > 0.0):
                t = ax - ay * (bx - ax) / (by - ay)
                if 0.0 <= t < min(ranges[i], max_range):
                    ranges[i] = t
    return ranges


def raycast_figures(poses: int = 1000, checked: int = 50) -> Figures:
    """Time of the kernel and of the NumPy reference at random poses, and the difference from the plain reference."""
    scene, laser = load_scene("apartment"), preset().laser
    bearings = beam_bearings(laser)
    beams, directions = beams_of(bearings), np.stack([np.cos(bearings), np.sin(bearings)])
    places = free_poses(scene, poses, np.random.default_rng(0))
    worst = 0.0
    for pose in places[:checked]:
        reference = cast_rays_plain(pose, bearings, scene.walls, laser.max_range)
        for ranges in (
            cast_rays(pose, bearings, scene.walls, laser.max_range),
            cast_rays_numpy(pose, directions, scene.walls, laser.max_range),
        ):
            same = ranges == reference  # inf included
            worst = max(worst, float(np.max(np.abs(ranges[~same] - reference[~same]), initial=0.0)))
    ms = alternate(
        places,
        lambda pose: cast_among(pose, beams, scene.walls.reshape(-1, 4), laser.max_range),
        lambda pose: cast_rays_numpy(pose, directions, scene.walls, laser.max_range),
    )
    ours, numpy = np.median(ms, axis=0)
    return {
        "raycast_ms_p50": float(ours),
        "raycast_numpy_ms_p50": float(numpy),
        "raycast_speedup_numpy": float(numpy / ours),
        "raycast_max_difference_m": worst,
    }


def scan_figures(poses: int = 1000) -> Figures:
    """Time of feature extraction and of scan insertion, per scan of the default laser in the apartment."""
    scene, config = load_scene("apartment"), preset()
    rng = np.random.default_rng(1)
    places = free_poses(scene, poses, rng)
    scans = noisy_scans(scene, places, rng)
    found = [extract(scan, config.assumed, config.features) for scan in scans]
    extraction = alternate(scans, lambda scan: extract(scan, config.assumed, config.features))
    grid = Grid(config.grid, scene.radius)
    work = list(zip(places, scans, [features.walls for features in found], strict=True))
    grid.add(*work[0])
    insertion = alternate(work, lambda item: grid.add(*item))
    return {
        "extract_ms_p50": float(np.median(extraction)),
        "extract_ms_p99": float(np.percentile(extraction, 99)),
        "grid_add_ms_p50": float(np.median(insertion)),
        "grid_add_ms_p99": float(np.percentile(insertion, 99)),
    }


def search_heapq(blocked: NDArray[np.bool_], start: int, goal: int) -> tuple[float, int]:
    """Reference: A* with a heap in plain Python, with the same moves, costs and heuristic.

    `start` and `goal` are flat indices into `blocked`. Returns the cost in cells and the number of expansions.
    """
    width = blocked.shape[1] + 2
    wall = np.pad(blocked, 1, constant_values=True).ravel().tolist()
    start, goal = ((i // (width - 2) + 1) * width + i % (width - 2) + 1 for i in (start, goal))
    goal_row, goal_col = divmod(goal, width)
    straight = (1, -1, width, -width)
    diagonal = tuple((across + down, across, down) for down in (width, -width) for across in (1, -1))
    cost = [math.inf] * len(wall)
    closed = [False] * len(wall)
    cost[start] = 0.0
    heap = [(0.0, start)]
    expanded = 0
    while heap:
        _, node = heapq.heappop(heap)
        if node == goal:
            return cost[goal], expanded
        if closed[node]:
            continue
        closed[node] = True
        expanded += 1
        g = cost[node]
        steps = [(node + d, g + 1.0) for d in straight]
        steps += [(node + d, g + SQRT2) for d, a, b in diagonal if not (wall[node + a] or wall[node + b])]
        for to, g_to in steps:
            if g_to < cost[to] and not (wall[to] or closed[to]):
                cost[to] = g_to
                row, col = divmod(to, width)
                rows, cols = abs(row - goal_row), abs(col - goal_col)
                octile = rows + (SQRT2 - 1.0) * cols if rows > cols else cols + (SQRT2 - 1.0) * rows
                heapq.heappush(heap, (g_to + octile, to))
    return math.inf, expanded


def random_grid(seed: int, size: int) -> NDArray[np.bool_]:
    """(size, size) cells with 300 random rectangles of at most 6 % of the side, and two free opposite corners."""
    rng = np.random.default_rng(seed)
    blocked = np.zeros((size, size), dtype=np.bool_)
    sides = rng.integers(max(size // 200, 1), max(size * 6 // 100, 2), (300, 2))
    for (row, col), (height, width) in zip(rng.integers(0, size, (300, 2)), sides, strict=True):
        blocked[row : row + height, col : col + width] = True
    blocked[:3, :3] = blocked[-3:, -3:] = False
    return blocked


def cost_of(blocked: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W) costs of cells of which some are blocked."""
    return np.where(blocked, np.inf, 1.0).astype(np.float32)


def astar_figures(size: int = 1000, grids: int = 4, repeats: int = 3) -> Figures:
    """Corner-to-corner searches on the first random grids with a path, against the heap."""
    last = size - 1
    solvable: list[NDArray[np.bool_]] = []
    expanded: list[int] = []
    differences: list[float] = []
    seed = 0
    while len(solvable) < grids:
        blocked = random_grid(seed, size)
        _, cost, count = cheapest_path(cost_of(blocked), (0, 0), (last, last))
        seed += 1
        if math.isfinite(cost):
            solvable.append(blocked)
            expanded.append(count)
            differences.append(abs(cost - search_heapq(blocked, 0, blocked.size - 1)[0]))
    ms = np.array(
        [
            np.median(
                alternate(
                    [blocked] * repeats,
                    lambda blocked: cheapest_path(cost_of(blocked), (0, 0), (last, last)),
                    lambda blocked: search_heapq(blocked, 0, blocked.size - 1),
                ),
                axis=0,
            )
            for blocked in solvable
        ]
    )
    ours, heap = ms.sum(axis=0)
    return {
        "astar_ms_mean": float(ours / grids),
        "astar_expansions_mean": sum(expanded) / grids,
        "astar_expansions_per_s": float(1e3 * sum(expanded) / ours),
        "astar_heapq_ms_mean": float(heap / grids),
        "astar_speedup_heapq": float(heap / ours),
        "astar_cost_difference": max(differences),
    }


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--loop", metavar="REV", help="measure whole runs and their start, beside this commit")
    parser.add_argument(
        "--logs", metavar="REV", help="measure logs, explorations and the first use, beside this commit"
    )
    options = parser.parse_args()
    if options.logs is not None:
        try:
            finish(options, "log_speed", *logs_tables(options.logs))
        except RuntimeError as error:
            parser.error(f"--logs: {error}")
        return
    if options.loop is not None:
        try:
            finish(options, "loop", loop_table(options.loop))
        except RuntimeError as error:
            parser.error(f"--loop: {error}")
        return
    with single_threaded():
        figures = raycast_figures() | scan_figures() | astar_figures() | scaling_figures()
    finish(options, "bench", against_limits(figures, LIMITS))


if __name__ == "__main__":
    main()

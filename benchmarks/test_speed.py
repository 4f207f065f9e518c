"""Speed of the hot loops beside a peer or a limit, by pytest-benchmark: `make bench`.

Ray casting is compared with all beams against all walls in range as NumPy matrices, A* with plain Python on a binary
heap with the same moves, costs and heuristic, an update of the filter with one pass over its covariance.
"""

from __future__ import annotations

import heapq
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.motion import Odometry
from sixthsense.core.ray_casting import beams_of, cast_among, cast_rays
from sixthsense.evaluation.coverage import visible_area
from sixthsense.navigation.gridsearch import cheapest_path
from sixthsense.simulation.scene import Scene, load_scene
from sixthsense.slam.estimators.ekf import EKF
from sixthsense.slam.features import extract
from sixthsense.slam.mapping.grid import Grid

SCENE, CONFIG = load_scene("apartment"), preset()
BEARINGS, MAX_RANGE_M = beam_bearings(CONFIG.laser), CONFIG.laser.max_range
SEEN = 10
"""landmarks of an update"""
MOTION = Odometry(Pose(0.1, 0.0, 0.01), 1e-5 * np.eye(3))


def free_poses(scene: Scene, count: int) -> list[Pose]:
    """Random collision-free poses in the visible area of the scene."""
    assert scene.start is not None
    rng, poses = np.random.default_rng(0), list[Pose]()
    area = visible_area(scene.walls, scene.region, (scene.start.x, scene.start.y), scene.radius, 10.0)
    cells = np.argwhere(area.mask)
    while len(poses) < count:
        row, col = cells[rng.integers(len(cells))] + rng.random(2)
        pose = Pose(area.origin[0] + col * area.cell_m, area.origin[1] + row * area.cell_m, rng.uniform(-np.pi, np.pi))
        if point_segment_distance(pose.position, scene.walls).min() > scene.radius:
            poses.append(pose)
    return poses


POSES = free_poses(SCENE, 200)


def cast_by_numpy(T_world_laser: Pose) -> Array:
    """Beams (2, N) of the laser against all walls in range, by Cramer's rule on (M, N)."""
    in_frame = T_world_laser.inverse() @ SCENE.walls
    start, along = in_frame[:, 0], in_frame[:, 1] - in_frame[:, 0]
    s = np.clip(-(start * along).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
    nearest = start + s[:, None] * along
    near = (nearest * nearest).sum(axis=1) <= MAX_RANGE_M**2
    start, along = start[near], along[near]
    across = start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]
    directions = np.stack([np.cos(BEARINGS), np.sin(BEARINGS)])
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / (np.stack([along[:, 1], -along[:, 0]], axis=1) @ directions)  # (M, N)
        t = across[:, None] * inverse
        u = (np.stack([-start[:, 1], start[:, 0]], axis=1) @ directions) * inverse
        t[~((t >= 0.0) & (np.abs(u - 0.5) <= 0.5 + 1e-9))] = np.inf
    ranges = np.min(t, axis=0, initial=np.inf)
    ranges[ranges >= MAX_RANGE_M] = np.inf
    return np.asarray(ranges)


def cast(pose: Pose) -> Array:
    """The compiled kernel."""
    return cast_among(pose, beams_of(BEARINGS), SCENE.walls.reshape(-1, 4), MAX_RANGE_M)


@pytest.mark.parametrize("function", [cast, cast_by_numpy], ids=["ours", "peer"])
def test_raycast(benchmark: Any, function: Any) -> None:
    found = benchmark(lambda: [function(pose) for pose in POSES])
    for ranges, pose in zip(found, POSES, strict=True):
        np.testing.assert_allclose(ranges, cast_rays(pose, BEARINGS, SCENE.walls, MAX_RANGE_M), atol=1e-9)


def search_by_heap(blocked: NDArray[np.bool_], start: int, goal: int) -> float:
    """The cost in cells of a way between flat indices, by A* with a heap in plain Python."""
    width = blocked.shape[1] + 2
    wall = np.pad(blocked, 1, constant_values=True).ravel().tolist()
    start, goal = ((i // (width - 2) + 1) * width + i % (width - 2) + 1 for i in (start, goal))
    goal_row, goal_col = divmod(goal, width)
    straight = (1, -1, width, -width)
    diagonal = tuple((across + down, across, down) for down in (width, -width) for across in (1, -1))
    cost, closed = [math.inf] * len(wall), [False] * len(wall)
    cost[start], heap = 0.0, [(0.0, start)]
    while heap:
        _, node = heapq.heappop(heap)
        if node == goal:
            return cost[goal]
        if closed[node]:
            continue
        closed[node] = True
        steps = [(node + d, cost[node] + 1.0) for d in straight]
        steps += [(node + d, cost[node] + 2**0.5) for d, a, b in diagonal if not (wall[node + a] or wall[node + b])]
        for to, length in steps:
            if length < cost[to] and not (wall[to] or closed[to]):
                cost[to] = length
                rows, cols = abs(to // width - goal_row), abs(to % width - goal_col)
                heapq.heappush(heap, (length + max(rows, cols) + (2**0.5 - 1.0) * min(rows, cols), to))
    return math.inf


def random_grid(seed: int, size: int = 1000) -> NDArray[np.bool_]:
    """(size, size) cells with 300 random rectangles of at most 6 % of the side, and two free opposite corners."""
    rng = np.random.default_rng(seed)
    blocked = np.zeros((size, size), dtype=np.bool_)
    sides = rng.integers(max(size // 200, 1), max(size * 6 // 100, 2), (300, 2))
    for (row, col), (height, width) in zip(rng.integers(0, size, (300, 2)), sides, strict=True):
        blocked[row : row + height, col : col + width] = True
    blocked[:3, :3] = blocked[-3:, -3:] = False
    return blocked


@pytest.mark.parametrize("is_ours", [True, False], ids=["ours", "peer"])
def test_astar(benchmark: Any, is_ours: bool) -> None:
    blocked = random_grid(0)
    last, costs = len(blocked) - 1, np.where(blocked, np.inf, 1.0).astype(np.float32)
    if is_ours:
        found = benchmark(lambda: cheapest_path(costs, (0, 0), (last, last))[1])
    else:
        found = benchmark.pedantic(lambda: search_by_heap(blocked, 0, blocked.size - 1), rounds=3)
    assert found == pytest.approx(search_by_heap(blocked, 0, blocked.size - 1), abs=1e-6)


def scans() -> list[Scan]:
    """Scans with the noise of the default robot."""
    rng, sigma_m = np.random.default_rng(1), CONFIG.world.laser.range_m
    clean = (cast_rays(pose, BEARINGS, SCENE.walls, MAX_RANGE_M) for pose in POSES)
    return [Scan.from_config(ranges + rng.normal(0.0, sigma_m, len(ranges)), CONFIG.laser) for ranges in clean]


def test_extraction(benchmark: Any) -> None:
    given = scans()
    benchmark(lambda: [extract(scan, CONFIG.assumed, CONFIG.features) for scan in given])


def test_map_insertion(benchmark: Any) -> None:
    given = [*zip(POSES, scans(), strict=True)]
    grid = Grid(CONFIG.grid, SCENE.radius)
    benchmark(lambda: [grid.add(pose, scan) for pose, scan in given])


def filter_of(size: int) -> EKF:
    """A filter with landmarks around the origin."""
    points = np.random.default_rng(3).uniform(-30.0, 30.0, (size, 2))
    filled = EKF(Pose(), 1e-4 * np.eye(3))
    filled.update({i: Observation(Kind.CORNER, point, 1e-2 * np.eye(2)) for i, point in enumerate(points)})
    return filled


@pytest.mark.parametrize("size", [30, 1000])
def test_update(benchmark: Any, size: int) -> None:
    estimator = filter_of(size)
    estimate = estimator.estimate()
    seen = {i: Observation(Kind.CORNER, estimate.landmarks[i], 1e-2 * np.eye(2)) for i in range(SEEN)}

    def step() -> None:
        estimator.predict(Odometry(Pose(), MOTION.cov))
        estimator.update(seen)

    benchmark(step)


def test_pass(benchmark: Any) -> None:
    cov = np.ones((3 + 2 * 1000,) * 2)
    benchmark(lambda: np.multiply(cov, 1.0, out=cov))

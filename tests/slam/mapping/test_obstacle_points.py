"""Where in its cell an obstacle is."""

import itertools

import numpy as np
import pytest

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.grid import Grid

CONFIG = GridConfig()
NO_WALLS = np.zeros((0, 2, 2))
POSES = Pose(0.31, -0.22, 0.7), Pose(0.43, 0.17, -2.1), Pose(-0.28, 0.36, 2.9)


def scans(seed: int) -> list[Scan]:
    rng = np.random.default_rng(seed)
    return [Scan(rng.uniform(1.2, 1.7, 300).astype(np.float32), np.float32(-3.1), np.float32(0.02), 2.5) for _ in POSES]


def means(seed: int) -> dict[tuple[int, int], np.ndarray]:
    """The mean of the returns of each cell."""
    found: dict[tuple[int, int], list[np.ndarray]] = {}
    for pose, scan in zip(POSES, scans(seed), strict=True):
        at = scan.bearings + pose.theta
        ranges = scan.ranges.astype(np.float64)
        for x, y in zip(pose.x + ranges * np.cos(at), pose.y + ranges * np.sin(at), strict=True):
            found.setdefault((int(np.floor(y / 0.05)), int(np.floor(x / 0.05))), []).append(np.array([x, y]))
    return {cell: np.mean(points, axis=0) for cell, points in found.items()}


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("is_composed", [False, True])
def test_an_obstacle_is_at_the_mean_of_its_returns(seed: int, is_composed: bool) -> None:
    grid = Grid(CONFIG, 0.2)
    parts = [Grid(CONFIG, 0.2) for _ in POSES] if is_composed else [grid] * len(POSES)
    for part, pose, scan in zip(parts, POSES, scans(seed), strict=True):
        part.add(pose, scan, NO_WALLS)
    if is_composed:
        grid.compose([part.submap() for part in parts])
    wanted = means(seed)
    points = grid.obstacle_points(grid.box)
    assert len(points) > 300
    for x, y in points:
        assert wanted[int(np.floor(y / 0.05)), int(np.floor(x / 0.05))] == pytest.approx([x, y], abs=1e-5)


def test_a_wall_without_returns_is_where_it_was_fitted() -> None:
    grid, ends = Grid(CONFIG, 0.2), np.array([[1.013, -0.321], [1.137, 0.844]])
    nothing = Scan(np.full(3, np.nan, dtype=np.float32), np.float32(0.2), np.float32(0.1), 2.5)
    pose = Pose(0.31, -0.22, 0.7)
    grid.add(pose, nothing, (pose.inverse() @ ends)[None])
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    off = (grid.obstacle_points(grid.box) - ends[0]) @ np.array([-along[1], along[0]])
    assert len(off) > 20 and np.median(np.abs(off)) < 1e-6
    assert np.abs(off).max() < 0.026  # Bresenham's line leaves the wall's cells by half a cell


def test_cells_are_near_an_obstacle_where_no_place_in_them_keeps_the_distance_to_its_returns() -> None:
    grid = Grid(CONFIG, 0.2)
    for pose, scan in zip(POSES, scans(5), strict=True):
        grid.add(pose, scan, NO_WALLS)
    box = grid.box.grown(-7)
    points = grid.obstacle_points(grid.box.grown(10))
    away = np.zeros((box.bottom - box.top, box.right - box.left))
    for right, up in itertools.product((-1.0, 0.0, 1.0), repeat=2):  # thirds of a cell
        x = (np.arange(box.left, box.right)[None, :] + 0.5 + right / 3.0) * 0.05
        y = (np.arange(box.top, box.bottom)[:, None] + 0.5 + up / 3.0) * 0.05
        away = np.maximum(away, np.hypot(x[..., None] - points[:, 0], y[..., None] - points[:, 1]).min(axis=-1))
    for distance_m in (0.2, 0.137):
        assert np.array_equal(grid.near_returns(box, distance_m), away <= distance_m)
    assert 0.1 < (away <= 0.137).mean() < 0.9

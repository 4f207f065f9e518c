"""The grid follows the smoothed poses of its key scans."""

import numpy as np
import pytest

from sixthsense.config import GridConfig, LaserConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, cast_rays
from sixthsense.loop import run
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import Mapper

LASER = LaserConfig(beams=90)
ROOM = np.array([[[-3, -2], [3, -2]], [[3, -2], [3, 2]], [[3, 2], [-3, 2]], [[-3, 2], [-3, -2]]], dtype=np.float64)
NO_WALLS = np.zeros((0, 2, 2))

CORNERS = {"landmarks": "corners"}  # with walls the block leaves nothing to correct


def look(pose: Pose) -> Scan:
    bearings = Scan.from_config(np.ones(LASER.beams), LASER).bearings
    return Scan.from_config(cast_rays(pose, bearings, ROOM, LASER.max_range), LASER)


def poses(count: int) -> np.ndarray:
    return np.array([[0.2 * k - 1.0, 0.1 * k, 0.3 * k] for k in range(count)])


def by_hand(trajectory: np.ndarray, scans: list[Scan]) -> Grid:
    grid = Grid(GridConfig(), 0.2)
    for row, scan in zip(trajectory, scans, strict=True):
        grid.add(Pose.from_array(row), scan, NO_WALLS)
    return grid


def test_without_movement_the_grid_is_not_rebuilt() -> None:
    scans, mapper = [look(Pose.from_array(row)) for row in poses(6)], Mapper(GridConfig(), 0.2)
    for k, scan in enumerate(scans):
        mapper.add(poses(k + 1), scan, NO_WALLS)
    assert mapper.rebuilds == 0
    assert np.array_equal(mapper.grid.occupancy(), by_hand(poses(6), scans).occupancy())


@pytest.mark.parametrize(
    ("shift", "rebuilt"), [([0.02, 0, 0], 0), ([0.03, 0, 0], 1), ([0, 0, 0.001], 0), ([0, 0, 0.03], 1)]
)
def test_half_a_cell_of_movement_rebuilds_the_grid(shift: list[float], rebuilt: int) -> None:
    scans, mapper = [look(Pose.from_array(row)) for row in poses(6)], Mapper(GridConfig(), 0.2)
    for k in range(5):
        mapper.add(poses(k + 1), scans[k], NO_WALLS)
    moved = poses(6)
    moved[2] += shift  # a heading's error moves what was seen, by its lever
    mapper.add(moved, scans[5], NO_WALLS)
    assert mapper.rebuilds == rebuilt
    expected = by_hand(moved if rebuilt else poses(6), scans)
    assert np.array_equal(mapper.grid.occupancy(), expected.occupancy())
    mapper.add(np.vstack([moved, poses(7)[-1:]]), look(Pose.from_array(poses(7)[-1])), NO_WALLS)
    assert mapper.rebuilds == rebuilt  # once is enough


def test_a_scan_without_a_return_causes_no_error() -> None:
    mapper = Mapper(GridConfig(), 0.2)
    empty = Scan.from_config(np.full(LASER.beams, np.inf), LASER)
    for k in range(3):
        mapper.add(poses(k + 1), empty, NO_WALLS)
    assert not mapper.grid.obstacles.any()


def test_a_smoother_that_revisits_corners_rebuilds_its_map() -> None:
    """In the block's corridors the heading is uncertain until the next corner, whose sighting moves earlier poses."""
    trace = run(preset(scene="block", estimator="isam2", task="tour", max_time=100.0, features=CORNERS))
    assert trace.outcome == "tour ended" and trace.rebuilds > 0
    moved = trace.trajectory - np.array([estimate.pose.array() for estimate in trace.key_estimates])
    assert np.hypot(*moved[:, :2].T).max() > 0.5 * trace.config.grid.cell_m
    filtered = run(preset(scene="block", estimator="ekf", task="tour", max_time=100.0, features=CORNERS))
    assert filtered.rebuilds == 0

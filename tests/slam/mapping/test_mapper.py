"""The grid follows the smoothed poses of its keyframes."""

import numpy as np
import pytest
from scanned import box, look

from sixthsense.config import GridConfig, LaserConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.loop import run
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import Mapper

LASER = LaserConfig(beams=90)
ROOM = box(-3, -2, 6, 4)
NO_WALLS = np.zeros((0, 2, 2))

CORNERS = {"landmarks": "corners"}  # with walls the block leaves nothing to correct


def seen(row: np.ndarray) -> Scan:
    return look(Pose.from_array(row), ROOM, LASER)


def poses(count: int) -> np.ndarray:
    return np.array([[0.2 * k - 1.0, 0.1 * k, 0.3 * k] for k in range(count)])


def by_hand(trajectory: np.ndarray, scans: list[Scan]) -> Grid:
    grid = Grid(GridConfig(), 0.2)
    for row, scan in zip(trajectory, scans, strict=True):
        grid.add(Pose.from_array(row), scan, NO_WALLS)
    return grid


def test_without_movement_the_grid_is_not_rebuilt() -> None:
    scans, mapper = [seen(row) for row in poses(6)], Mapper(GridConfig(), 0.2)
    for k, scan in enumerate(scans):
        mapper.add(poses(k + 1).copy, scan, NO_WALLS)
        assert mapper.grid.seen.any()
    assert mapper.rebuilds == 0
    assert np.array_equal(mapper.grid.occupancy(), by_hand(poses(6), scans).occupancy())


@pytest.mark.parametrize(
    ("shift", "rebuilt"), [([0.02, 0, 0], 0), ([0.03, 0, 0], 1), ([0, 0, 0.001], 0), ([0, 0, 0.03], 1)]
)
def test_half_a_cell_of_movement_rebuilds_the_grid(shift: list[float], rebuilt: int) -> None:
    scans, mapper = [seen(row) for row in poses(6)], Mapper(GridConfig(), 0.2)
    for k in range(5):
        mapper.add(poses(k + 1).copy, scans[k], NO_WALLS)
        assert mapper.grid.seen.any()
    moved = poses(6)
    moved[2] += shift  # a heading's error moves what was seen, by its lever
    mapper.add(moved.copy, scans[5], NO_WALLS)
    expected = by_hand(moved if rebuilt else poses(6), scans)
    assert np.array_equal(mapper.grid.occupancy(), expected.occupancy())
    assert mapper.rebuilds == rebuilt
    mapper.add(np.vstack([moved, poses(7)[-1:]]).copy, seen(poses(7)[-1]), NO_WALLS)
    assert mapper.grid.seen.any()
    assert mapper.rebuilds == rebuilt  # once is enough


def test_a_map_that_nobody_reads_is_drawn_once_at_the_last_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    scans, drawn, add = [seen(row) for row in poses(6)], [], Grid.add
    monkeypatch.setattr(Grid, "add", lambda self, pose, *rest: (drawn.append(pose), add(self, pose, *rest))[1])
    mapper = Mapper(GridConfig(), 0.2)
    for k, scan in enumerate(scans):
        mapper.add((poses(k + 1) + 0.1 * k).copy, scan, NO_WALLS)
    assert drawn == [] and mapper.rebuilds == 0
    mapper.complete(poses(6) + 0.5)
    assert len(drawn) == 6 and mapper.rebuilds == 0
    last = poses(6) + 0.5
    assert np.array_equal(mapper.grid.occupancy(), by_hand(last, scans).occupancy())
    assert mapper.grid.origin == by_hand(last, scans).origin


@pytest.mark.parametrize("read_at", [(), (0,), (2, 3), (0, 1, 2, 3, 4, 5)])
def test_how_often_the_map_is_read_does_not_change_it_where_poses_stay(read_at: tuple[int, ...]) -> None:
    scans, mapper = [seen(row) for row in poses(6)], Mapper(GridConfig(), 0.2)
    for k, scan in enumerate(scans):
        mapper.add(poses(k + 1).copy, scan, NO_WALLS)
        if k in read_at:
            assert mapper.grid.hits.sum() == by_hand(poses(k + 1), scans[: k + 1]).hits.sum()
    expected = by_hand(poses(6), scans)
    for name in ("hits", "passes", "seen", "obstacles", "origin"):
        assert np.array_equal(getattr(mapper.grid, name), getattr(expected, name))
    assert np.array_equal(mapper.grid.free_space().blocked, expected.free_space().blocked)


def test_a_smoother_that_sees_corners_again_rebuilds_its_map() -> None:
    """In the block's corridors the heading is uncertain until a corner is observed, which moves earlier poses."""
    trace = run(preset(scene="block", estimator="isam2", task="tour", max_time=100.0, features=CORNERS))
    assert trace.outcome == "tour ended" and trace.rebuilds > 0
    moved = trace.trajectory - np.array([estimate.pose.array() for estimate in trace.key_estimates])
    assert np.hypot(*moved[:, :2].T).max() > 0.5 * trace.config.grid.cell_m
    filtered = run(preset(scene="block", estimator="ekf", task="tour", max_time=100.0, features=CORNERS))
    assert filtered.rebuilds == 0


def earlier() -> Grid:
    """The grid of an earlier run, in which there was a box in the middle of the room."""
    grid = Grid(GridConfig(), 0.2)
    for row in poses(40):
        pose = Pose(-2.0, row[1] - 2.0 if row[1] < 3.0 else 0.0, row[2])
        grid.add(pose, look(pose, np.concatenate([ROOM, box(0, -1, 0.5, 0.5)]), LASER), NO_WALLS)
    return grid


def begun() -> Mapper:
    mapper = Mapper(GridConfig(), 0.2)
    mapper.start_from(earlier().submap())
    return mapper


def same_cells(one: Grid, other: Grid, name: str) -> bool:
    """Whether two grids have the same cells that are something, wherever their corners lie."""
    places = [np.argwhere(getattr(grid, name)) + np.round(np.array(grid.origin)[::-1] / 0.05) for grid in (one, other)]
    return set(map(tuple, places[0].tolist())) == set(map(tuple, places[1].tolist()))


def test_a_map_begins_with_the_obstacles_of_an_earlier_one_of_which_nothing_is_seen_yet() -> None:
    mapper = begun()
    assert same_cells(mapper.grid, earlier(), "obstacles")
    assert not mapper.grid.seen.any() and mapper.grid.hits.max() <= 3


def test_what_an_earlier_run_has_seen_is_seen_when_the_map_is_complete() -> None:
    mapper = begun()
    mapper.complete(np.zeros((0, 3)))
    assert same_cells(mapper.grid, earlier(), "seen") and same_cells(mapper.grid, earlier(), "obstacles")


def is_obstacle(grid: Grid, x: float, y: float) -> bool:
    row, col = np.floor((np.array([y, x]) - np.array(grid.origin)[::-1]) / 0.05).astype(int)
    return bool(grid.obstacles[row, col])


def test_an_earlier_obstacle_that_is_gone_becomes_free_after_a_few_scans() -> None:
    mapper, rows = begun(), np.tile([-1.5, -0.73, 0.0], (20, 1))
    assert is_obstacle(mapper.grid, 0.02, -0.73)
    for k in range(20):
        mapper.add(rows[: k + 1].copy, seen(rows[k]), NO_WALLS)
    assert not is_obstacle(mapper.grid, 0.02, -0.73)


def test_earlier_evidence_out_of_sight_stays_when_key_poses_move() -> None:
    far = Grid(GridConfig(), 0.2)
    far.add(Pose(20.02, 0.02, 0.0), Scan.from_config(np.full(LASER.beams, 0.01), LASER), NO_WALLS)
    mapper, rows = Mapper(GridConfig(), 0.2), poses(12)
    mapper.start_from(far.submap())
    for k in range(11):
        mapper.add(rows[: k + 1].copy, seen(rows[k]), NO_WALLS)
        assert is_obstacle(mapper.grid, 20.02, 0.02)
    moved = rows + np.array([0.1, 0.0, 0.0])
    mapper.add(moved.copy, seen(moved[11]), NO_WALLS)
    assert is_obstacle(mapper.grid, 20.02, 0.02) and mapper.rebuilds == 1
    mapper.complete(rows)
    assert is_obstacle(mapper.grid, 20.02, 0.02) and mapper.rebuilds == 2

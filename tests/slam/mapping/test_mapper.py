"""The grid follows the smoothed poses of its keyframes, and is composed of submaps."""

import numpy as np
import pytest
from scanned import box, look

from sixthsense.config import GridConfig, LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.evidence import Cells, EvidenceRules, Tiles
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import SCANS_PER_SUBMAP, Mapper
from sixthsense.slam.mapping.submap import Submap, add_submap

LASER = LaserConfig(beams=120)
ROOM = box(-3, -2, 6, 4)
CELL_M = GridConfig().cell_m

RULES = EvidenceRules(min_hits=2, max_hits=10, passes_per_hit=4.0)


def seen(row: np.ndarray) -> Scan:
    return look(Pose.from_array(row), ROOM, LASER)


def poses(count: int) -> np.ndarray:
    return np.array([[0.2 * k - 1.0, 0.1 * k, 0.3 * k] for k in range(count)])


def by_hand(trajectory: np.ndarray, scans: list[Scan], config: GridConfig | None = None) -> Grid:
    grid = Grid(config or GridConfig(), 0.2)
    for row, scan in zip(trajectory, scans, strict=True):
        grid.add(Pose.from_array(row), scan)
    return grid


@pytest.mark.parametrize(
    ("shift", "follows"), [([0, 0, 0], False), ([0.02, 0, 0], False), ([0.03, 0, 0], True), ([0, 0, 0.001], False),
                           ([0, 0, 0.03], True)]
)  # fmt: skip
def test_a_drawn_map_follows_a_key_pose_that_has_moved_by_half_a_cell(shift: list[float], follows: bool) -> None:
    scans, mapper = [seen(row) for row in poses(6)], Mapper(GridConfig(), 0.2)
    for k in range(5):
        mapper.add(k, poses(k + 1).copy, scans[k])
        assert mapper.draw().seen.any()
    moved = poses(6)
    moved[2] += shift  # a heading's error moves what was seen, by its lever
    mapper.add(5, moved.copy, scans[5])
    expected = by_hand(moved if follows else poses(6), scans).occupancy()
    assert not np.array_equal(mapper.grid.occupancy(), expected)  # reading draws nothing
    assert np.array_equal(mapper.draw().occupancy(), expected)


def test_a_map_that_is_not_drawn_before_the_end_is_drawn_once_at_the_last_poses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scans, drawn, add = [seen(row) for row in poses(6)], [], Grid.add
    monkeypatch.setattr(Grid, "add", lambda self, pose, *rest: (drawn.append(pose), add(self, pose, *rest))[1])
    mapper = Mapper(GridConfig(), 0.2)
    for k, scan in enumerate(scans):
        mapper.add(k, (poses(k + 1) + 0.1 * k).copy, scan)
    assert drawn == []
    mapper.complete(poses(6) + 0.5)
    assert len(drawn) == 6
    last = poses(6) + 0.5
    assert np.array_equal(mapper.draw().occupancy(), by_hand(last, scans).occupancy())
    assert mapper.draw().origin == by_hand(last, scans).origin


@pytest.mark.parametrize("drawn_at", [(), (0,), (2, 3), (0, 1, 2, 3, 4, 5)])
def test_how_often_the_map_is_drawn_does_not_change_it_where_poses_stay(drawn_at: tuple[int, ...]) -> None:
    scans, mapper = [seen(row) for row in poses(6)], Mapper(GridConfig(), 0.2)
    for k, scan in enumerate(scans):
        mapper.add(k, poses(k + 1).copy, scan)
        if k in drawn_at:
            assert mapper.draw().hits.sum() == by_hand(poses(k + 1), scans[: k + 1]).hits.sum()
    expected = by_hand(poses(6), scans)
    for name in ("hits", "passes", "seen", "obstacles", "origin"):
        assert np.array_equal(getattr(mapper.draw(), name), getattr(expected, name))
    assert np.array_equal(mapper.draw().free_space().blocked, expected.free_space().blocked)


def earlier() -> Grid:
    """The grid of an earlier run, in which there was a box in the middle of the room."""
    grid = Grid(GridConfig(), 0.2)
    for row in poses(40):
        pose = Pose(-2.0, row[1] - 2.0 if row[1] < 3.0 else 0.0, row[2])
        grid.add(pose, look(pose, np.concatenate([ROOM, box(0, -1, 0.5, 0.5)]), LASER))
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
    assert same_cells(mapper.draw(), earlier(), "obstacles")
    assert not mapper.draw().seen.any() and mapper.draw().hits.max() <= 3


def test_what_an_earlier_run_has_seen_is_seen_when_the_map_is_complete() -> None:
    mapper = begun()
    mapper.complete(np.zeros((0, 3)))
    assert same_cells(mapper.draw(), earlier(), "seen") and same_cells(mapper.draw(), earlier(), "obstacles")


def is_obstacle(grid: Grid, x: float, y: float) -> bool:
    row, col = np.floor((np.array([y, x]) - np.array(grid.origin)[::-1]) / 0.05).astype(int)
    return bool(grid.obstacles[row, col])


def test_an_earlier_obstacle_that_is_gone_becomes_free_after_a_few_scans() -> None:
    mapper, rows = begun(), np.tile([-1.5, -0.73, 0.0], (20, 1))
    assert is_obstacle(mapper.draw(), 0.02, -0.73)
    for k in range(20):
        mapper.add(k, rows[: k + 1].copy, seen(rows[k]))
    assert not is_obstacle(mapper.draw(), 0.02, -0.73)


def test_earlier_evidence_out_of_sight_stays_when_key_poses_move() -> None:
    far = Grid(GridConfig(), 0.2)
    far.add(Pose(20.02, 0.02, 0.0), Scan.from_config(np.full(LASER.beams, 0.01), LASER))
    mapper, rows = Mapper(GridConfig(), 0.2), poses(12)
    mapper.start_from(far.submap())
    for k in range(11):
        mapper.add(k, rows[: k + 1].copy, seen(rows[k]))
        assert is_obstacle(mapper.draw(), 20.02, 0.02)
    moved = rows + np.array([0.1, 0.0, 0.0])
    mapper.add(11, moved.copy, seen(moved[11]))
    assert is_obstacle(mapper.draw(), 20.02, 0.02)
    mapper.complete(rows)
    assert is_obstacle(mapper.draw(), 20.02, 0.02)


def turning(count: int) -> np.ndarray:
    return np.array([[1.5 * np.sin(0.2 * k), 0.8 * np.cos(0.3 * k), 0.25 * k] for k in range(count)])


def drawn(rows: np.ndarray, config: GridConfig | None = None) -> Grid:
    return by_hand(rows, [seen(row) for row in rows], config)


def plain_add(grid: Cells, first: tuple[int, int], submap: Submap, rules: EvidenceRules) -> None:
    """The reference of `add_submap`, on whole arrays; no cell is in a submap twice."""
    at = submap.cells[:, 0] - first[0], submap.cells[:, 1] - first[1]
    is_hit = submap.hits > 0
    hits = np.where(is_hit, np.minimum(grid.hits[at] + submap.hits, rules.max_hits), grid.hits[at])
    most = np.floor(rules.passes_per_hit * hits)
    passes = np.where(is_hit, np.minimum(grid.passes[at], most), grid.passes[at]) + submap.passes
    is_obstacle = is_hit & (submap.passes <= rules.passes_per_hit * submap.hits)
    grid.hits[at], grid.passes[at] = hits, np.where(is_obstacle, np.minimum(passes, most), passes)
    grid.seen[at] |= submap.seen


def random_submap(rng: np.random.Generator) -> Submap:
    cells = np.argwhere(rng.random((20, 30)) < 0.4) + np.array([-5, 7])
    count = len(cells)
    hits = (rng.integers(0, 4, count) * rng.integers(0, 2, count)).astype(np.int32)
    passes, seen = rng.integers(0, 30, count).astype(np.int32), rng.random(count) < 0.8
    return Submap(cells, hits, passes, seen, np.zeros((count, 3), np.int16))


def test_the_kernel_adds_a_submap_as_the_plain_reference_does() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        tiles, box = Tiles(RULES), Box(-5, 7, 15, 37)
        tiles.cover(box)
        plain = Cells(*(np.zeros((20, 30), dtype=array.dtype) for array in tiles.cells))
        for _ in range(6):
            submap = random_submap(rng)
            slots = tiles.slots(submap.cells)
            add_submap(tiles.cells, slots, submap, RULES)
            plain_add(plain, (-5, 7), submap, RULES)
        for name in ("hits", "passes", "seen"):
            assert np.array_equal(tiles.part(getattr(tiles.cells, name), box), getattr(plain, name))


@pytest.mark.parametrize("config", [GridConfig(), GridConfig(min_hits=2, passes_per_hit=0.5)])
def test_a_grid_composed_of_one_submap_is_the_grid_it_was_taken_from(config: GridConfig) -> None:
    grid, composed = drawn(turning(12), config), Grid(config, 0.2)
    composed.compose([grid.submap()])
    for name in ("hits", "passes", "seen", "obstacles"):
        there, here = np.argwhere(getattr(grid, name)), np.argwhere(getattr(composed, name))
        shift = np.round(np.subtract(grid.origin, composed.origin)[::-1] / config.cell_m).astype(int)
        assert np.array_equal(there + shift, here)
        assert np.array_equal(getattr(grid, name)[tuple(there.T)], getattr(composed, name)[tuple(here.T)])


def test_only_submaps_with_a_moved_scan_are_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    count = 3 * SCANS_PER_SUBMAP + 4
    mapper, added, add = Mapper(GridConfig(), 0.2), [], Grid.add
    monkeypatch.setattr(Grid, "add", lambda self, pose, *rest: (added.append(pose), add(self, pose, *rest))[1])
    rows = turning(count + 2)
    for k in range(count):
        mapper.add(k, rows[: k + 1].copy, seen(rows[k]))
        assert mapper.draw().seen.any()
    assert len(added) == count
    moved = rows.copy()
    for k, (scan, drawn_again) in enumerate(((5, 3), (SCANS_PER_SUBMAP + 1, 1))):
        added.clear()
        moved[scan, 0] += 0.04
        mapper.add(count + k, moved[: count + 1 + k].copy, seen(moved[count + k]))
        assert mapper.draw().seen.any()
        assert len(added) == drawn_again * SCANS_PER_SUBMAP + 5 + k  # with the scans that are in no submap yet
    shift = np.abs(mapper._drawn_at - moved[: len(mapper._drawn_at)])
    assert shift.max() == 0.0
    assert mapper.draw().obstacles.sum() == pytest.approx(drawn(moved[: count + 2]).obstacles.sum(), rel=0.1)


@pytest.mark.parametrize("seed", range(6))
def test_tiles_composed_anew_are_as_if_all_were(seed: int) -> None:
    """Submaps that move by turns, some of them far: evidence and obstacles, cell for cell."""
    rng, count = np.random.default_rng(seed), 8
    config = GridConfig(min_hits=2, passes_per_hit=3.0)
    rows = turning(5 * count) + np.array([1.5 * (seed % 2), 0.0, 0.0]) * np.arange(5 * count)[:, None]
    submaps = [drawn(rows[5 * k : 5 * k + 5], config).submap() for k in range(count)]
    partly, whole = Grid(config, 0.2), Grid(config, 0.2)
    partly.compose(submaps)
    for _ in range(4):
        before = list(submaps)
        moved = rng.choice(count, 2, replace=False).tolist()
        for k in moved:
            shift = rng.normal(0.0, 1.0, 3) * (3.0, 3.0, 0.5)
            submaps[k] = drawn(rows[5 * k : 5 * k + 5] + shift, config).submap()
        partly.recompose(submaps, [s.box for k in moved for s in (before[k], submaps[k])])
        whole.compose(submaps)
        box = Box(*partly._box)
        for name in ("hits", "passes", "seen", "obstacles"):
            assert np.array_equal(partly.part(name, box), whole.part(name, box)), name


def test_submaps_out_of_reach_of_what_moves_are_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A long corridor of which one end moves: as many submaps are composed as lie there."""
    mapper, given, recompose = Mapper(GridConfig(), 0.2), [], Grid.recompose
    monkeypatch.setattr(
        Grid, "recompose", lambda self, submaps, boxes: (given.append(len(submaps)), recompose(self, submaps, boxes))
    )
    count = 12 * SCANS_PER_SUBMAP
    rows = np.array([[1.0 * k, 0.0, 0.0] for k in range(count + 2)])
    scan = seen(np.zeros(3))
    for k in range(count):
        mapper.add(k, rows[: k + 1].copy, scan)
        assert mapper.draw().seen.any()
    moved = rows.copy()
    moved[3, 1] += 0.1
    mapper.add(count, moved[: count + 1].copy, scan)
    assert mapper.draw().seen.any()
    assert len(given) == 1 and 1 <= given[0] <= 3
    again = Mapper(GridConfig(), 0.2)
    for k in range(count + 1):
        again.add(k, moved[: k + 1].copy, scan)
        assert again.draw().seen.any()
    for name in ("seen", "obstacles"):
        assert np.array_equal(getattr(mapper.draw(), name), getattr(again.draw(), name))


def test_nothing_is_left_where_a_submap_was_that_moves_far() -> None:
    count, far = SCANS_PER_SUBMAP + 3, np.array([43.0, -31.0, 0.7])
    rows, scan = poses(count + 1) + np.array([0.3, 0.7, 0.2]), seen(poses(1)[0])
    mapper = Mapper(GridConfig(), 0.23)
    for k in range(count):
        mapper.add(k, rows[: k + 1].copy, scan)
        assert mapper.draw().seen.any()
    moved = rows + far
    mapper.add(count, moved.copy, scan)
    grid = mapper.draw()
    row, col = np.nonzero(grid.seen)
    x, y = grid.origin[0] + CELL_M * col, grid.origin[1] + CELL_M * row
    reach_m = LASER.max_range + 1.0
    assert len(x) and np.hypot(x[:, None] - moved[:, 0], y[:, None] - moved[:, 1]).min(axis=1).max() < reach_m

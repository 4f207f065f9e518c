import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.ray_casting import cast_rays
from sixthsense.slam.mapping.evidence import line_cells
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.slam.mapping.grid import Grid, Walls

ROOM = np.array(
    [
        [[-4.0, -3.0], [5.0, -3.0]],
        [[5.0, -3.0], [5.0, 4.0]],
        [[5.0, 4.0], [-4.0, 4.0]],
        [[-4.0, 4.0], [-4.0, -3.0]],
        [[1.0, 1.0], [2.0, 2.5]],
    ]
)
ORIGIN = Pose()


def scan_of(ranges: Array, angle_min: float = 0.0, increment: float = 0.1, max_range: float = 10.0) -> Scan:
    return Scan(np.asarray(ranges, dtype=np.float32), np.float32(angle_min), np.float32(increment), max_range)


def scan_of_room(T_world_robot: Pose, walls: Array = ROOM, max_range: float = 6.0, mount: Pose = ORIGIN) -> Scan:
    increment = np.float32(2 * math.pi / 120)
    bearings = -np.pi + np.arange(120) * np.float64(increment)
    ranges = cast_rays(T_world_robot @ mount, bearings, walls, max_range).astype(np.float32)
    return Scan(ranges, np.float32(-math.pi), increment, max_range, mount)


def random_pose(rng: np.random.Generator) -> Pose:
    return Pose(rng.uniform(-3.0, 0.5), rng.uniform(-2.5, 3.5), rng.uniform(-3.0, 3.0))


def cells_by_world(grid: Grid, values: Array) -> dict[tuple[int, int], int]:
    """The non-zero cells of an array of the grid by row and column counted from the world's origin."""
    x0, y0 = grid.origin
    row0, col0 = round(y0 / CONFIG.cell_m), round(x0 / CONFIG.cell_m)
    return {(int(r) + row0, int(c) + col0): int(values[r, c]) for r, c in np.argwhere(values)}


CONFIG = GridConfig(cell_m=0.1)


class PlainGrid:
    """The rules of evidence in plain Python, on dictionaries of cells."""

    def __init__(self, config: GridConfig) -> None:
        self.config = config
        self.hits: dict[tuple[int, int], int] = {}
        self.passes: dict[tuple[int, int], int] = {}
        self.seen: set[tuple[int, int]] = set()

    def cell(self, point: Array) -> tuple[int, int]:
        return math.floor(point[1] / self.config.cell_m), math.floor(point[0] / self.config.cell_m)

    def add(self, T_world_robot: Pose, scan: Scan, walls: Walls) -> None:
        T_world_laser = T_world_robot @ scan.T_robot_laser
        laser = self.cell(T_world_laser.position)
        hit, crossed = set(), set()
        for reading, bearing in zip(scan.ranges.astype(float), scan.bearings, strict=True):
            if not reading > 0.0:
                continue
            reach = min(reading, scan.max_range)
            angle = T_world_laser.theta + bearing
            end = self.cell(T_world_laser.position + reach * np.array([np.cos(angle), np.sin(angle)]))
            line = [tuple(map(int, cell)) for cell in line_cells(*laser, *end)]
            self.seen.update(line)
            if reading < np.float32(scan.max_range):
                hit.add(end)
                line = line[:-1]
            crossed.update(line)
        for lines, closes in zip(walls, (True, False), strict=True):
            for a, b in T_world_robot @ lines:
                line = [tuple(map(int, cell)) for cell in line_cells(*self.cell(a), *self.cell(b))]
                hit.update(cell for cell in line if closes or not self.is_free(cell))
        for cell in hit:
            self.hits[cell] = min(self.hits.get(cell, 0) + 1, self.config.max_hits)
            if cell in self.passes:
                self.passes[cell] = min(self.passes[cell], int(self.config.passes_per_hit * self.hits[cell]))
        for cell in crossed - hit:
            self.passes[cell] = self.passes.get(cell, 0) + 1

    def is_free(self, cell: tuple[int, int]) -> bool:
        return self.passes.get(cell, 0) > self.config.passes_per_hit * self.hits.get(cell, 0)

    @property
    def obstacles(self) -> set[tuple[int, int]]:
        least, ratio = self.config.min_hits, self.config.passes_per_hit
        return {c for c, n in self.hits.items() if n >= least and self.passes.get(c, 0) <= ratio * n}


@pytest.mark.parametrize("seed", range(30))
def test_a_bresenham_line_is_connected_thin_and_near_the_true_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    r0, c0, r1, c1 = (int(n) for n in rng.integers(-40, 40, 4))
    cells = line_cells(r0, c0, r1, c1)
    assert tuple(cells[0]) == (r0, c0) and tuple(cells[-1]) == (r1, c1)
    steps = np.abs(np.diff(cells, axis=0))
    major = max(abs(r1 - r0), abs(c1 - c0))
    assert len(cells) == major + 1 and (steps.max(axis=1, initial=0) == 1).all()
    along = np.linspace(0.0, 1.0, major + 1)[:, None]
    exact = np.array([r0, c0]) + along * np.array([r1 - r0, c1 - c0])
    assert np.abs(cells - exact).max() <= 0.5 + 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_the_compiled_grid_counts_as_plain_python_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    config = CONFIG.replaced(min_hits=1 + seed % 2, max_hits=3, passes_per_hit=1.0 + seed % 3)
    grid, plain = Grid(config, 0.2), PlainGrid(config)
    for _ in range(8):
        pose = random_pose(rng)
        mount = Pose(0.2, -0.1, 0.4) if seed % 2 else Pose()
        scan = scan_of_room(pose, max_range=3.6, mount=mount)
        noisy = scan.ranges + rng.normal(0.0, 0.2, 120).astype(np.float32)
        noisy[rng.integers(0, 120, 6)] = [np.nan, np.inf, -np.inf, 0.0, 99.0, 3.6]
        robot = pose.inverse()
        walls = Walls(*(robot @ (ROOM[rng.integers(0, 5, 2)] + rng.normal(0.0, 0.05, (2, 2, 2))) for _ in range(2)))
        for each in (grid, plain):
            each.add(pose, replace(scan, ranges=noisy), walls)
    assert cells_by_world(grid, grid.hits) == plain.hits
    assert cells_by_world(grid, grid.passes) == plain.passes
    assert set(cells_by_world(grid, grid.seen)) == plain.seen
    assert grid.seen_area_m2 == pytest.approx(len(plain.seen) * CONFIG.cell_m**2)
    assert set(cells_by_world(grid, grid.obstacles)) == plain.obstacles


def test_growth_keeps_what_was_counted() -> None:
    """A grid that grows with every scan ends up as one that was large from the start."""
    rng = np.random.default_rng(7)
    poses = [Pose(0.0, 0.0, 0.0), Pose(-40.0, 3.0, 1.0), Pose(30.0, -35.0, 2.0), Pose(2.0, 45.0, -1.0)]
    scans = [scan_of(rng.uniform(0.5, 9.0, 60)) for _ in poses]
    growing, roomy = Grid(CONFIG, 0.25), Grid(CONFIG, 0.25)
    for x, y in ((-60.0, -60.0), (60.0, 60.0)):
        roomy.add(Pose(x, y), scan_of([1.0]))
    for pose, scan in zip(poses, scans, strict=True):
        growing.add(pose, scan)
        roomy.add(pose, scan)
    for x, y in ((-60.0, -60.0), (60.0, 60.0)):
        growing.add(Pose(x, y), scan_of([1.0]))
    for name in ("hits", "passes", "seen", "obstacles"):
        assert cells_by_world(growing, getattr(growing, name)) == cells_by_world(roomy, getattr(roomy, name))
    blocked = cells_by_world(growing, growing.free_space().blocked)
    assert blocked == cells_by_world(roomy, roomy.free_space().blocked)


def test_a_cleared_grid_equals_a_new_one() -> None:
    used, new = Grid(CONFIG, 0.2), Grid(CONFIG, 0.2)
    used.add(Pose(3.0, 9.0), scan_of([2.0, 4.0]))
    used.clear()
    assert used.hits.size == 0 and used.free_space().blocked.size == 0
    for grid in (used, new):
        grid.add(Pose(0.0, 0.0), scan_of_room(Pose()))
    assert used.origin == new.origin and np.array_equal(used.hits, new.hits)
    assert np.array_equal(used.free_space().blocked, new.free_space().blocked)


def test_a_snapshot_is_read_only_and_does_not_change_later() -> None:
    grid = Grid(CONFIG, 0.2)
    grid.add(Pose(), scan_of([2.0]))
    space = grid.free_space()
    before = space.blocked.copy()
    with pytest.raises(ValueError, match="read-only"):
        space.blocked[0, 0] = True
    grid.hits[:] = 99
    grid.obstacles[:] = True
    grid.add(Pose(0.0, 0.0, 1.0), scan_of([2.0]))
    assert np.array_equal(space.blocked, before) and grid.hits.max() == 1


def test_growth_beyond_the_memory_limit_is_refused_and_leaves_the_grid_unchanged() -> None:
    grid = Grid(GridConfig(cell_m=0.01), 0.2)
    grid.add(Pose(), scan_of([2.0]))
    before = grid.hits
    with pytest.raises(ValueError, match="allowed: at most 1,000,000,000 cells"):
        grid.add(Pose(), scan_of([1e6], max_range=1e7))
    with pytest.raises(ValueError, match="allowed: at most 100,000,000 cells"):
        grid.add(Pose(), scan_of([4e4], max_range=1e7))
    with pytest.raises(ValueError, match="allowed: at most 1,000,000,000 cells"):
        grid.add(Pose(1e30, 0.0), scan_of([2.0]))
    with pytest.raises(ValueError, match="allowed: at most"):
        grid.free_space((1e6, 1e6))
    assert np.array_equal(grid.hits, before)


def random_space(rng: np.random.Generator, density: float = 0.2) -> FreeSpace:
    blocked = rng.random((12, 15)) < density
    return FreeSpace(blocked, np.zeros_like(blocked), (-0.7, 0.3), 0.1)


@pytest.mark.parametrize("seed", range(40))
def test_a_line_is_free_exactly_when_dense_samples_of_it_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    space = random_space(rng)
    for _ in range(30):
        a, b = rng.uniform((-1.2, -0.2), (1.3, 2.0), (2, 2))
        samples = a + np.linspace(0.0, 1.0, 20_001)[:, None] * (b - a)
        cols, rows = np.floor((samples - space.origin) / space.cell_m).astype(int).T
        inside = (rows >= 0) & (rows < 12) & (cols >= 0) & (cols < 15)
        assert space.line_is_free(a, b) == (not space.blocked[rows[inside], cols[inside]].any())
        assert space.line_is_free(a, b) == space.line_is_free(b, a)


def test_the_cost_of_a_path_is_the_integral_over_the_cells_that_it_crosses() -> None:
    rng = np.random.default_rng(3)
    cost = rng.uniform(1.0, 9.0, (12, 15)).astype(np.float32)
    space = FreeSpace(np.zeros(cost.shape, bool), np.ones(cost.shape, bool), (-0.7, 0.3), 0.1, cost)
    path, expected = rng.uniform((-0.65, 0.35), (0.75, 1.45), (4, 2)), 0.0
    for a, b in itertools.pairwise(path):
        samples = a + (np.arange(20_000)[:, None] + 0.5) / 20_000 * (b - a)
        cols, rows = np.floor((samples - space.origin) / space.cell_m).astype(int).T
        expected += math.dist(a, b) * cost[rows, cols].mean()
    assert space.path_cost(path) == pytest.approx(expected, rel=0.05)  # middles of pieces of half a cell


@pytest.mark.parametrize("seed", range(20))
def test_the_nearest_free_place_is_the_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    space = random_space(rng, 0.9)
    for _ in range(10):
        point, within = rng.uniform((-1.0, 0.0), (1.1, 1.8)), rng.uniform(0.0, 0.6)
        found = space.nearest_free(point, within)
        if not space.is_blocked(point):
            assert np.array_equal(found, point)
            continue
        around = [space.centre(r, c) for r in range(-8, 21) for c in range(-8, 24)]
        distances = [np.linalg.norm(c - point) for c in around if not space.is_blocked(c)]
        if min(distances) <= within:
            assert found is not None and not space.is_blocked(found)
            assert np.linalg.norm(found - point) == pytest.approx(min(distances), abs=1e-12)
        else:
            assert found is None
    assert space.nearest_free(space.centre(6, 7), 100.0) is not None


def test_a_space_extended_to_cover_points_keeps_its_cells_where_they_were() -> None:
    rng = np.random.default_rng(3)
    space = random_space(rng)
    wide = space.covering((3.04, -2.0), (-5.0, 0.9))
    assert wide.contains((3.04, -2.0)) and wide.contains((-5.0, 0.9))
    assert wide.blocked.sum() == space.blocked.sum()
    for row, col in np.argwhere(space.blocked):
        assert wide.is_blocked(space.centre(int(row), int(col)))
    assert space.covering(space.centre(2, 3)) is space and space.covering() is space
    empty = Grid(CONFIG, 0.2).free_space((1e5, 1e5), (1e5 + 3.0, 1e5))
    assert empty.contains((1e5, 1e5)) and empty.blocked.size < 1000 and not empty.blocked.any()


def test_those_who_stand_block_the_ways_around_them_until_they_stand_elsewhere() -> None:
    radius_m, body_m, at = 0.23, 0.17, Pose(0.7, -0.4, 0.6)
    grid, empty = (Grid(CONFIG, radius_m) for _ in range(2))
    for one in (grid, empty):
        one.add(at, scan_of_room(at))
    places = [np.array([[-1.3, 0.4], [0.6, 1.1]]), np.array([[1.2, -0.9]])]
    for standing in places:
        grid.block_bodies(at, standing, body_m)
    (x, y), free, space = (at @ places[1])[0], empty.free_space(), grid.free_space()
    half_diagonal_m = math.sqrt(0.5) * CONFIG.cell_m  # of the cells that each of the two discs touches, and of its own
    for row, col in np.ndindex(free.blocked.shape):
        centre = free.centre(row, col)
        distance_m = math.hypot(centre[0] - x, centre[1] - y)
        if distance_m <= radius_m + body_m:
            assert space.is_blocked(centre)
        elif distance_m > radius_m + body_m + 3.0 * half_diagonal_m:
            assert space.is_blocked(centre) == free.is_blocked(centre)
    assert np.array_equal(grid.obstacles, empty.obstacles)
    grid.block_bodies(at, np.zeros((0, 2)), body_m)
    again = grid.free_space()
    assert all(again.is_blocked(free.centre(*cell)) == free.blocked[cell] for cell in np.ndindex(free.blocked.shape))


@pytest.mark.parametrize("between", [124, 125, 126, 253])
def test_a_scan_counts_however_many_scans_elsewhere_came_before_it(between: int) -> None:
    grid = Grid(CONFIG, 0.2)
    here, away = Pose(0.33, -0.21, 0.7), Pose(60.3, 41.7, -1.1)
    first = scan_of_room(here, max_range=4.0)
    box = grid.add(here, first)
    hits, passes = grid.part("hits", box), grid.part("passes", box)
    for _ in range(between):
        grid.add(away, first)
    grid.add(here, first)
    assert np.array_equal(grid.part("hits", box), 2 * hits) and np.array_equal(grid.part("passes", box), 2 * passes)


def test_more_hits_than_a_byte_holds_are_counted() -> None:
    grid, pose = Grid(CONFIG.replaced(max_hits=301), 0.2), Pose(0.33, -0.21, 0.7)
    for _ in range(310):
        grid.add(pose, scan_of_room(pose, max_range=4.0))
    assert grid.hits.max() == 301 and grid.passes.max() == 310

"""What a map view keeps up to date is what it would draw from scratch."""

import numpy as np
import pytest
from scipy import ndimage
from test_gridsearch import plain_costs

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.navigation.frontier import close_gaps, close_unseen_gaps
from sixthsense.navigation.gridsearch import far_from
from sixthsense.navigation.guard import BUFFER_M
from sixthsense.navigation.map_view import MapView
from sixthsense.navigation.regions import frontier_cells, spread
from sixthsense.navigation.tour import TileWays
from sixthsense.slam.mapping.grid import Grid

REGION = (-2.0, -1.5, 2.5, 1.0)
RADIUS_M = 0.2
CONFIG = preset("default", explore={"margin_m": 0.3})
MASKS = "seen", "free", "obstacles", "opaque", "wanted", "blocked", "passable", "edge", "reached", "occupied", "unseen"


def random_scan(rng: np.random.Generator) -> Scan:
    ranges = rng.choice([0.8, 2.0, 2.2, np.inf], 18).repeat(10).astype(np.float32)
    return Scan(ranges, np.float32(-np.pi), np.float32(2.0 * np.pi / 180), 2.5)


def see(grid: Grid, rng: np.random.Generator) -> None:
    pose = Pose(*rng.uniform((-1.5, -1.0, -3.0), (1.5, 1.0, 3.0)))
    grid.add(pose, random_scan(rng), np.zeros((0, 2, 2)))


@pytest.mark.parametrize("seed", range(6))
def test_a_view_that_follows_a_map_is_the_view_of_the_map_as_it_is(seed: int) -> None:
    rng, grid = np.random.default_rng(seed), Grid(CONFIG.grid, RADIUS_M)
    view, attempts, compared = MapView(REGION, RADIUS_M, CONFIG), [], 0
    for k in range(40):
        if k == 30:
            grid.clear()
        for _ in range(int(rng.integers(1, 4))):
            see(grid, rng)
        view.update(grid)
        if k % 5 == 4:
            view.widen(not view.is_wide)
        if k % 3 == 0:
            continue  # nobody chooses a view
        fresh = MapView(REGION, RADIUS_M, CONFIG)
        fresh.widen(view.is_wide)
        fresh.update(grid)
        fresh.passable[:] = view.passable  # what was open
        fresh.redraw(fresh.frame)
        for cells in attempts:
            fresh._attempts[tuple(cells.T - np.array(fresh.first)[:, None])] += 1
        passable = np.argwhere(view.passable)
        if len(passable) == 0:
            continue
        here = tuple(passable[rng.integers(len(passable))].tolist())
        for each in (view, fresh):
            each.draw_views(here)
        for name in MASKS:
            assert np.array_equal(getattr(view, name), getattr(fresh, name)), name
        assert np.array_equal(view.reached, np.isfinite(plain_costs(view.passable, np.array(view.blocked), *here)))
        assert np.array_equal(view.tile_ways._links, fresh.tile_ways._links)
        if k < 28 and view.wanted.any():
            found = np.argwhere(view.wanted)
            ignored = found[rng.integers(len(found), size=5)]
            view.ignore(np.unique(ignored[:, 0] * view.shape[1] + ignored[:, 1]))
            attempts += [found[:7] + np.array(view.first)] * 2
            for _ in range(2):
                view.count_attempt(attempts[-1])
        compared += 1
    assert compared > 10


def test_the_masks_of_a_view_are_what_they_say() -> None:
    rng, grid = np.random.default_rng(1), Grid(CONFIG.grid, RADIUS_M)
    for _ in range(25):
        see(grid, rng)
    view = MapView(REGION, RADIUS_M, CONFIG)
    view.update(grid)
    view.draw_views(view.cell(np.zeros(2)))
    frame, rows_cols = view.frame, np.indices(view.shape)
    hits, passes, seen = (grid.part(name, frame) for name in ("hits", "passes", "seen"))
    solid = close_gaps(grid.part("obstacles", frame) | ((hits >= 4) & (passes <= 16 * hits)))
    obstacles = close_unseen_gaps(solid, seen, 8)
    known = close_unseen_gaps(seen | obstacles, seen, 3)  # 3 cells between two beams
    unseen, unknown = ~(seen | obstacles), ~known
    assert np.array_equal(view.obstacles, obstacles) and np.array_equal(view.seen, seen)
    assert np.array_equal(view.opaque, ndimage.binary_dilation(obstacles, np.ones((5, 5), dtype=np.bool_)))
    assert np.array_equal(view.free, seen & ~obstacles) and np.array_equal(view.filled, known & ~obstacles)
    assert np.array_equal(view.edge, np.argwhere(frontier_cells(seen & ~obstacles, unknown)))
    y, x = (rows_cols + np.array(view.first)[:, None, None] + 0.5) * view.cell_m
    x0, y0, x1, y1 = REGION
    in_region = (x > x0) & (x < x1) & (y > y0) & (y < y1)
    assert np.array_equal(view.unseen, unseen & in_region)
    inside = np.nonzero(((x > x0) & (x < x1) & (y > y0) & (y < y1)).any(axis=1))[0]
    across = np.nonzero(((x > x0) & (x < x1) & (y > y0) & (y < y1)).any(axis=0))[0]
    bounds = inside[0], inside[-1] + 1, across[0], across[-1] + 1
    assert np.array_equal(view.wanted, spread(unknown & in_region, unknown, 3, bounds))
    outside = (x < x0 - 0.3) | (x > x1 + 0.3) | (y < y0 - 0.3) | (y > y1 + 0.3)
    assert np.array_equal(view.blocked, grid.near_returns(frame, RADIUS_M + 0.035) | far_from(seen, 4) | outside)
    assert np.array_equal(view.tight, grid.inflated(frame, BUFFER_M - CONFIG.grid.clearance_m))
    assert np.array_equal(view.passable, seen & ~view.blocked)
    cells = np.argwhere(known | unknown)[7::13] + np.array(view.first)
    assert view.unknown_share(cells) == pytest.approx(np.mean(unknown.ravel()[7::13]), abs=1e-12)
    between = np.argwhere(known & unseen) + np.array(view.first)
    assert len(between) > 9 and view.unknown_share(between) == 0.0


@pytest.mark.parametrize("end", [(0.625, 0.575), (-0.475, 0.525), (0.43, -0.21)])
def test_where_the_robot_has_been_no_step_leads_across_a_corner_alone(end: tuple[float, float]) -> None:
    rng, grid = np.random.default_rng(3), Grid(CONFIG.grid, RADIUS_M)
    for _ in range(9):
        see(grid, rng)
    view = MapView(REGION, RADIUS_M, CONFIG)
    view.update(grid)
    begin = np.array([0.075, 0.025])  # a diagonal from here passes corners of cells
    for place in (begin, np.array(end)):
        view.moved(place)
    labels, parts = ndimage.label(view._driven)
    assert parts == 1 and labels[view.cell(begin)] == labels[view.cell(np.array(end))] == 1
    assert not (view.blocked & view._driven & (view._stops < 2) & view.seen).any()


def test_changes_are_told_where_obstacles_wanted_and_reached_cells_differ() -> None:
    rng, grid = np.random.default_rng(2), Grid(CONFIG.grid, RADIUS_M)
    view = MapView(REGION, RADIUS_M, CONFIG)
    before = np.zeros((3, 0, 0), dtype=np.bool_)
    told = 0
    for _ in range(30):
        see(grid, rng)
        view.update(grid)
        view.draw_views(view.cell(np.zeros(2)))
        found = np.flatnonzero(view.wanted)[:: int(rng.integers(20, 200))]
        changed = view.ignore(found)
        now = np.array([view.obstacles, view.wanted, view.reached])
        if now.shape == before.shape:
            differs = (now != before).any(axis=0).reshape(changed.shape[0], 8, -1, 8).any(axis=(1, 3))
            assert not (differs & ~changed).any()
            told += np.count_nonzero(~changed)
        before = now
    assert told > 0


def test_cells_that_are_ignored_are_those_of_the_last_choice_alone() -> None:
    rng, grid = np.random.default_rng(4), Grid(CONFIG.grid, RADIUS_M)
    for _ in range(9):
        see(grid, rng)
    view = MapView(REGION, RADIUS_M, CONFIG)
    view.update(grid)
    view.draw_views(view.cell(np.zeros(2)))
    wanted = view.wanted.copy()
    first, second = np.flatnonzero(wanted)[3::7], np.flatnonzero(wanted)[5::11]
    view.ignore(first)
    view.ignore(second)
    assert np.array_equal(np.flatnonzero(view.wanted), np.setdiff1d(np.flatnonzero(wanted), second))
    view.heed()
    assert np.array_equal(view.wanted, wanted)


def test_ignored_cells_that_have_been_seen_since_are_not_wanted_again() -> None:
    rng, grid = np.random.default_rng(8), Grid(CONFIG.grid, RADIUS_M)
    view = MapView(REGION, RADIUS_M, CONFIG)
    was_seen = 0
    for _ in range(9):
        see(grid, rng)
        view.update(grid)
        before = view.wanted.copy()
        view.draw_views(view.cell(np.zeros(2)))
        if before.shape == view.wanted.shape:
            was_seen += np.count_nonzero(before & ~view.wanted)
        wanted = view.wanted.copy()
        view.ignore(np.flatnonzero(wanted)[::3])
        view.ignore(np.flatnonzero(wanted)[1::5])
        view.heed()
        assert np.array_equal(view.wanted, wanted)
        view.ignore(np.flatnonzero(wanted)[::2])
    assert was_seen > 0


def test_spaces_with_a_margin_are_those_of_the_grid_within_the_limits() -> None:
    from sixthsense.slam.mapping.freespace import Ellipse

    rng, grid = np.random.default_rng(3), Grid(CONFIG.grid, RADIUS_M)
    for _ in range(4):
        see(grid, rng)
    view = MapView((-9.0, -9.0, 9.0, 9.0), RADIUS_M, CONFIG)
    view.update(grid)
    ends = np.array([[-0.6, 0.2], [0.9, -0.3]])
    near = Ellipse(*ends, 2.4)
    space, whole = view.free_space(0.1 + view.spare_m, ends, near), grid.free_space(margin_m=0.1, within=near)
    rows, cols = np.indices(space.blocked.shape)
    for row, col in zip(rows.ravel().tolist(), cols.ravel().tolist(), strict=True):
        centre = space.centre(row, col)
        if not view._barred[view.cell(centre)]:
            assert space.blocked[row, col] == whole.is_blocked(centre)
    assert not space.blocked.all()


def test_tile_ways_that_follow_a_map_are_those_of_the_map() -> None:
    rng, ways = np.random.default_rng(0), TileWays(6)
    passable = rng.random((128, 192)) < 0.8
    for _ in range(20):
        row, col, changed = int(rng.integers(120)), int(rng.integers(180)), np.zeros((16, 24), dtype=np.bool_)
        passable[row : row + 8, col : col + 8] = rng.random((8, 8))[: 128 - row, : 192 - col] < 0.6
        changed[row // 8 : row // 8 + 2, col // 8 : col // 8 + 2] = True
        ways.update(passable, changed)
        fresh = TileWays(6)
        fresh.update(passable)
        assert np.array_equal(ways._links, fresh._links)

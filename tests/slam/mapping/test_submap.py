"""A grid composed of submaps."""

import numpy as np
import pytest
from scanned import box, look

from sixthsense.config import GridConfig, LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.evidence import Cells, EvidenceRules
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import SCANS_PER_SUBMAP, Mapper
from sixthsense.slam.mapping.submap import Submap, add_submap
from sixthsense.slam.mapping.tiles import TILE, Tiles

LASER = LaserConfig(beams=120)
ROOM = box(-3, -2, 6, 4)
NO_WALLS = np.zeros((0, 2, 2))
RULES = EvidenceRules(min_hits=2, max_hits=10, passes_per_hit=4.0)


def seen(row: np.ndarray) -> Scan:
    return look(Pose.from_array(row), ROOM, LASER)


def poses(count: int) -> np.ndarray:
    return np.array([[1.5 * np.sin(0.2 * k), 0.8 * np.cos(0.3 * k), 0.25 * k] for k in range(count)])


def drawn(rows: np.ndarray, config: GridConfig | None = None) -> Grid:
    grid = Grid(config or GridConfig(), 0.2)
    for row in rows:
        grid.add(Pose.from_array(row), seen(row), NO_WALLS)
    return grid


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
    return Submap.of(cells, hits, rng.integers(0, 30, count).astype(np.int32), rng.random(count) < 0.8)


def test_the_kernel_adds_a_submap_as_the_plain_reference_does() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        tiles, box = Tiles(), Box(-5, 7, 15, 37)
        tiles.cover(box)
        tiles.allocate(tiles.lacking(np.ones(tiles.index.shape, dtype=np.bool_)))
        fast = Cells.empty(tiles.index.size * TILE * TILE)
        plain = Cells(*(cells.reshape(20, 30) for cells in Cells.empty(600)))
        for _ in range(6):
            submap = random_submap(rng)
            add_submap(fast, tiles.index, tiles.places(submap.cells), submap, RULES)
            plain_add(plain, (-5, 7), submap, RULES)
        for name in ("hits", "passes", "seen"):
            assert np.array_equal(tiles.part(getattr(fast, name), box), getattr(plain, name))


@pytest.mark.parametrize("config", [GridConfig(), GridConfig(min_hits=2, passes_per_hit=0.5)])
def test_a_grid_composed_of_one_submap_is_the_grid_it_was_taken_from(config: GridConfig) -> None:
    grid, composed = drawn(poses(12), config), Grid(config, 0.2)
    composed.compose([grid.submap()])
    for name in ("hits", "passes", "seen", "obstacles"):
        there, here = np.argwhere(getattr(grid, name)), np.argwhere(getattr(composed, name))
        shift = np.round(np.subtract(grid.origin, composed.origin)[::-1] / config.cell_m).astype(int)
        assert np.array_equal(there + shift, here)
        assert np.array_equal(getattr(grid, name)[tuple(there.T)], getattr(composed, name)[tuple(here.T)])


def test_a_static_room_is_the_same_in_submaps_as_scan_by_scan() -> None:
    whole, composed = drawn(poses(40)), Grid(GridConfig(), 0.2)
    composed.compose([drawn(poses(40)[k : k + 10]).submap() for k in range(0, 40, 10)])
    for name in ("obstacles", "seen"):
        assert getattr(composed, name).sum() == pytest.approx(getattr(whole, name).sum(), rel=0.02)


def test_only_submaps_with_a_moved_scan_are_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    count = 3 * SCANS_PER_SUBMAP + 4
    mapper, added, add = Mapper(GridConfig(), 0.2), [], Grid.add
    monkeypatch.setattr(Grid, "add", lambda self, pose, *rest: (added.append(pose), add(self, pose, *rest))[1])
    rows = poses(count + 2)
    for k in range(count):
        mapper.add(rows[: k + 1].copy, seen(rows[k]), NO_WALLS)
        assert mapper.grid.seen.any()
    assert len(added) == count and mapper.rebuilds == 0
    moved = rows.copy()
    for k, (scan, drawn_again) in enumerate(((5, 3), (SCANS_PER_SUBMAP + 1, 1))):
        added.clear()
        moved[scan, 0] += 0.04
        mapper.add(moved[: count + 1 + k].copy, seen(moved[count + k]), NO_WALLS)
        assert mapper.grid.seen.any()
        assert mapper.rebuilds == k + 1
        assert len(added) == drawn_again * SCANS_PER_SUBMAP + 5 + k  # with the scans that are in no submap yet
    shift = np.abs(mapper._drawn_at - moved[: len(mapper._drawn_at)])
    assert shift.max() == 0.0
    assert mapper.grid.obstacles.sum() == pytest.approx(drawn(moved[: count + 2]).obstacles.sum(), rel=0.1)


@pytest.mark.parametrize("seed", range(6))
def test_tiles_composed_anew_are_as_if_all_were(seed: int) -> None:
    """Submaps that move by turns, some of them far: evidence, obstacles and inflation, cell for cell."""
    rng, count = np.random.default_rng(seed), 8
    config = GridConfig(min_hits=2, passes_per_hit=3.0)
    rows = poses(5 * count) + np.array([1.5 * (seed % 2), 0.0, 0.0]) * np.arange(5 * count)[:, None]
    submaps = [drawn(rows[5 * k : 5 * k + 5], config).submap() for k in range(count)]
    partly, whole = Grid(config, 0.2), Grid(config, 0.2)
    partly.compose(submaps)
    masks = partly.free_space()
    for _ in range(4):
        before = list(submaps)
        moved = rng.choice(count, 2, replace=False).tolist()
        for k in moved:
            shift = rng.normal(0.0, 1.0, 3) * (3.0, 3.0, 0.5)
            submaps[k] = drawn(rows[5 * k : 5 * k + 5] + shift, config).submap()
        partly.recompose(submaps, [s.box for k in moved for s in (before[k], submaps[k])])
        whole.compose(submaps)
        box = Box(*partly._box)
        for name in ("hits", "passes", "cover", "seen", "obstacles"):
            assert np.array_equal(partly.part(name, box), whole.part(name, box)), name
        masks = partly.free_space()  # those of the time before are brought up to date
        assert np.array_equal(masks.blocked, partly.part("cover", box) > 0)
        assert np.array_equal(masks.seen, partly.seen)


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
        mapper.add(rows[: k + 1].copy, scan, NO_WALLS)
        assert mapper.grid.seen.any()
    moved = rows.copy()
    moved[3, 1] += 0.1
    mapper.add(moved[: count + 1].copy, scan, NO_WALLS)
    assert mapper.grid.seen.any() and mapper.rebuilds == 1
    assert len(given) == 1 and 1 <= given[0] <= 3
    again = Mapper(GridConfig(), 0.2)
    for k in range(count + 1):
        again.add(moved[: k + 1].copy, scan, NO_WALLS)
        assert again.grid.seen.any()
    for name in ("seen", "obstacles"):
        assert np.array_equal(getattr(mapper.grid, name), getattr(again.grid, name))

"""Free space, discs, gaps and boxes against plain references, for general places, margins and sizes of cells."""

import itertools
import math

import numpy as np
import pytest

from sixthsense.config import GridConfig, LaserConfig
from sixthsense.config.errors import InputError
from sixthsense.config.sections import LaserNoise
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.changes import TILE, Box, cell_box, grown_box
from sixthsense.slam.mapping.evidence import EvidenceRules
from sixthsense.slam.mapping.grid import Grid, disc
from sixthsense.slam.mapping.mapper import Mapper
from sixthsense.slam.mapping.straight_gaps import straight_gaps
from sixthsense.slam.mapping.submap import Submap

CELL = 0.07
CONFIG = GridConfig(cell_m=CELL, clearance_m=0.04)
LASER = LaserConfig(beams=25, fov=4.4, max_range=2.0, mount=(0.1, -0.05, 0.3))


def looked(rng):
    """A grid of some scans with returns at random ranges."""
    grid = Grid(CONFIG, 0.11)
    for _ in range(3):
        grid.add(Pose(*rng.uniform(-1, 1, 2), rng.uniform(-3, 3)), scattered(rng))
    return grid


def scattered(rng):
    return Scan.from_config(rng.uniform(0.3, 2.4, LASER.beams), LASER)


@pytest.mark.parametrize("radius", [0.0, 0.4, 2.3, 5.51])
def test_discs_cover_the_cells_that_they_touch(radius):
    found = set(map(tuple, disc(radius).tolist()))
    for row in range(-8, 9):
        for col in range(-8, 9):
            gap = max(abs(row) - 0.5, 0.0), max(abs(col) - 0.5, 0.0)
            assert ((row, col) in found) == (math.hypot(*gap) <= radius)


def test_a_grid_made_of_counts_goes_on_as_the_one_they_were_of():
    rng = np.random.default_rng(5)
    grid = looked(rng)
    other = Grid.from_counts(CONFIG, 0.11, grid.origin, grid.hits, grid.passes, grid.seen)
    pose, scan = Pose(0.3, -0.2, 1.1), scattered(rng)
    for one in (grid, other):
        one.add(pose, scan)
    box = grid.box
    for name in ("hits", "passes", "seen", "obstacles"):
        assert np.array_equal(grid.part(name, box), other.part(name, box))


def test_old_evidence_is_that_of_three_scans_with_the_same_obstacles_and_free_cells():
    cells, hits = np.array([[2, 3], [2, 4], [-1, 7], [5, 5]]), np.array([20, 2, 9, 0], np.int32)
    passes = np.array([40, 3, 30, 6], np.int32)
    found = Submap(cells, hits, passes, np.ones(4, bool), np.zeros((4, 3), np.int16)).weakened(
        EvidenceRules(1, 40, 2.5)
    )
    assert found.hits.tolist() == [3, 2, 3, 0]
    assert found.passes.tolist() == [6, 3, 8, 1]  # two per hit; as it was; free, by one more than 7; free
    assert not found.seen.any() and found.box == Box(-1, 3, 6, 8)


def test_places_are_free_if_all_cells_around_them_are_seen_and_none_is_an_obstacle():
    rng = np.random.default_rng(7)
    mapper = Mapper(CONFIG, 0.11)
    mapper.add(0, lambda: np.array([[0.2, -0.4, 0.8]]), scattered(rng))
    grid, points = mapper.grid, rng.uniform(-0.9, 0.9, (300, 2))
    is_free = mapper.are_free(points, 0.02)
    known = grid.seen & ~grid.obstacles
    top, left = grid.box[:2]
    for point, free in zip(points, is_free, strict=True):
        row, col = np.floor(point[::-1] / CELL)
        down, across = np.ogrid[top : top + known.shape[0], left : left + known.shape[1]]
        gap = np.hypot(np.maximum(abs(down - row) - 0.5, 0.0), np.maximum(abs(across - col) - 0.5, 0.0))
        around = gap <= 0.02 / CELL + 1.0
        assert free == bool(known[around].all())
    assert 4 < is_free.sum() < 296


def test_a_box_that_must_grow_grows_by_a_tile_more():
    box = Box(-100, 20, 900, 220)
    assert grown_box(box, np.array([-90.0, 30.0]), np.array([900.0, 220.0])) == box
    assert grown_box(box, np.array([-90.0, 10.0]), np.array([800.0, 200.0])) == Box(-100, 10 - TILE, 900, 220)
    assert grown_box(box, np.array([-90.0, 30.0]), np.array([1100.0, 230.0])) == Box(-100, 20, 1100 + TILE, 230 + TILE)
    with pytest.raises(InputError, match=r"within 2\^48 of the origin"):
        cell_box(np.array([2.0**48 - 8.0, 3.0]), np.array([2.0**48 + 8.0, 9.0]))
    begun = grown_box(Box(0, 0, 0, 0), np.array([3.0, 5.0]), np.array([40.0, 30.0]))
    assert begun == Box(3 - TILE, 5 - TILE, 40 + TILE, 30 + TILE)


@pytest.mark.parametrize("sigmas, closed", [((0.01, 0.0), False), ((0.001, 0.004), True)])
def test_a_return_is_of_one_wall_with_its_neighbours_within_three_sigmas(sigmas, closed):
    alpha, distance, spacing = 0.9, 1.3, 2.0 * math.pi / 40
    bearings = spacing * np.array([-1.0, 0.0, 1.0]) + (-math.pi + spacing if closed else -0.3)
    alpha += bearings[1]

    def middle(a, b, c, turn):
        """By how much the middle return lies beyond the line through its neighbours, in reciprocal range."""
        (x0, y0), (x1, y1) = (np.array([math.cos(t), math.sin(t)]) * r for r, t in
                              ((a, bearings[0] + turn[0]), (c, bearings[2] + turn[2])))  # fmt: skip
        t = bearings[1] + turn[1]
        return 1.0 / b - (math.cos(t) * (y1 - y0) - math.sin(t) * (x1 - x0)) / (x0 * y1 - y0 * x1)

    ranges = distance / np.cos(bearings - alpha)
    variance = 0.0
    for step in 1e-6 * np.eye(3):
        variance += (
            sigmas[0] * (middle(*(ranges + step), np.zeros(3)) - middle(*(ranges - step), np.zeros(3))) / 2e-6
        ) ** 2
        variance += (sigmas[1] * (middle(*ranges, step) - middle(*ranges, -step)) / 2e-6) ** 2
    for beyond, count in ((2.9, 2), (3.1, 0), (-2.9, 2), (-3.1, 0)):
        seen = ranges.copy()
        seen[1] = 1.0 / (1.0 / ranges[1] + beyond * math.sqrt(variance))
        whole = np.full(40 if closed else 3, np.inf, np.float32)
        whole[:3] = seen
        scan = Scan(whole, np.float32(bearings[0]), np.float32(spacing), 9.0, Pose(0.2, 0.1, 0.4))
        scan = scan if not closed else Scan(np.roll(whole, -1), np.float32(bearings[1]), np.float32(spacing), 9.0,
                                            Pose(0.2, 0.1, 0.4))  # fmt: skip
        gaps = straight_gaps(scan, LaserNoise(range_m=sigmas[0], bearing_rad=sigmas[1]), 0.01, 2.0)
        assert len(gaps) == count
        ends = np.array([0.2, 0.1]) + [[r * math.cos(0.4 + b), r * math.sin(0.4 + b)]
                                       for r, b in zip(seen, bearings, strict=True)]  # fmt: skip
        for gap in gaps:
            assert any(gap == pytest.approx(ends[k : k + 2], abs=1e-5) for k in (0, 1))
        if count:
            noise = LaserNoise(range_m=sigmas[0], bearing_rad=sigmas[1])
            length = [math.dist(*pair) for pair in itertools.pairwise(ends)]
            assert len(straight_gaps(scan, noise, max(length) - 1e-6, 2.0)) == 1
            for radius in np.linspace(0.02, 0.6, 30):
                assert len(straight_gaps(scan, noise, 0.01, radius)) == sum(m < 2.0 * radius for m in length)


def test_a_long_gap_along_the_beams_is_closed_where_the_wall_goes_on_at_both_ends() -> None:
    bearings = 0.02 * np.arange(6)
    ranges = (0.5 / np.sin(0.3 - bearings)).astype(np.float32)  # a wall half a metre beside, ahead from 1.7 to 2.5 m
    noise, radius = LaserNoise(range_m=0.01, bearing_rad=0.0), 0.06
    points = ranges[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
    length, across = np.linalg.norm(np.diff(points, axis=0), axis=1), ranges[:-1] * math.sin(0.02)
    assert (length > 2.0 * radius).all() and (across < radius).all()
    scan = Scan(ranges, np.float32(0.0), np.float32(0.02), 9.0)
    np.testing.assert_allclose(straight_gaps(scan, noise, 0.01, radius)[:, 0], points[1:4], atol=1e-5)
    assert not len(straight_gaps(scan, noise, 0.01, float(across.min())))
